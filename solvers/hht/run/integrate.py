"""The loop over steps, and what it hands over: rows at output times with recovered multipliers."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import padded
from hhtbench.result import DenseOutput, Solution, Status
from hhtbench.trust import unresolved
from solvers._rows import Recovered, late_note
from solvers._start import Failure, acceleration_at, all_multipliers
from solvers.hht.equations.interpolant import HermiteOutput
from solvers.hht.run.engine import Engine
from solvers.hht.run.history import History
from solvers.hht.run.stepper import EventState, Stepper
from solvers.hht.step.state import State

FIRST, MOST = 512, 65_536  # steps of one call: fewer at first, so that one that is slow can be interrupted
FEW = 20  # the same with a time budget
SLOW = 0.05  # [s] of one call, at most: budgets and the user's interrupt are looked at between
BLOCK = 65_536  # output rows that are interpolated at once: the time budget is looked at between


@dataclass(frozen=True)
class End:
    """How the loop ended."""

    status: Status
    message: str
    state: State


def integrate(stepper: Stepper, state: State, stop: float, history: History, max_num_steps: int | None) -> End:
    """Take steps until ``stop`` [s], a terminal event, a failure or a budget; every accepted step is in ``history``."""
    watch, taken, work = EventState(counts=(0,) * len(stepper.events)), 0, stepper.engine.work
    count = FIRST if work.clock.limit is None else FEW
    while state.t != stop:
        if max_num_steps is not None and taken >= max_num_steps:
            message = f"{taken} steps were taken and t = {state.t:.17g} reached; {Status.max_steps.text}"
            return End(Status.max_steps, message, state)
        room = count if max_num_steps is None else min(count, max_num_steps - taken)
        began = time.perf_counter()
        accepted = stepper.advance(state, watch, stop, history.room(room))
        state, watch, taken = accepted.state, accepted.watch, taken + accepted.made
        history.commit(accepted.made)
        work.clock.kept_back = history.handing_over()
        each = (time.perf_counter() - began) / max(accepted.made, 1)
        count = int(min(8 * count, MOST, max(SLOW / each, 1.0)))
        if accepted.failure is not None:
            return End(accepted.failure.status, accepted.failure.message, state)
        if accepted.occurrences:
            history.note(accepted.occurrences)
            changed = stepper.changed(accepted)
            if isinstance(changed, Failure):
                return End(changed.status, changed.message, state)
            if changed is not state:
                history.restart(changed)
                state, watch = changed, stepper.watch_after(accepted, changed)
            last_words = stepper.terminal(accepted)
            if last_words is not None:
                return End(Status.event, last_words, state)
    return End(Status.success, Status.success.text, state)


def checked(end: End, history: History, rtol: float) -> End:
    """``end``; where it is a success although floating-point times do not resolve the steps, a failure."""
    data, t0 = history.steps_data(), float(history.dense_output().t[0])
    coarse = unresolved((t0, end.state.t), data.h.size, rtol, float(np.sum(data.h)))
    if end.status not in (Status.success, Status.event) or not coarse:
        return end
    return replace(end, status=Status.time_resolution, message=coarse)


def reached(output: HermiteOutput, t_eval: Vector | None) -> Vector:
    """The asked output times within the accepted steps, in either direction of time; None asks for every step."""
    if t_eval is None:
        return output.t
    return t_eval[(t_eval >= output.t.min()) & (t_eval <= output.t.max())]


def rows_within(output: HermiteOutput, times: Vector, work: Work) -> DenseOutput:
    """q and v at ``times`` (k,), or at as many of them as the time budget allows."""
    parts = [output(times[:0])]
    for first in range(0, times.size, BLOCK):
        if work.clock.left() < 0.0:
            break
        parts.append(output(times[first : first + BLOCK]))
    return DenseOutput(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))


def assemble(engine: Engine, history: History, t_eval: Vector | None, end: End, note: str) -> Solution:
    """The Solution: rows at ``t_eval`` (None: at every step) that were reached, multipliers by (H16)."""
    engine.work.only_output_is_left()
    output = history.dense_output()
    times = reached(output, t_eval)
    rows = history.rows() if t_eval is None else rows_within(output, times, engine.work)
    asked, times = times.size, times[: len(rows.q)]
    before = engine.work.counters()
    guess = history.multiplier_guess(None if t_eval is None else times)
    found = recover_multipliers(engine, guess, times, rows.q, rows.v)
    kept = len(found.lam)
    every = times[:kept], rows.q[:kept], rows.v[:kept]
    lam, mu = all_multipliers(engine.dynamics, engine.work, *every, found.lam, found.mu)
    after = engine.work.counters()
    spent = (after.residual_evaluations or 0) - (before.residual_evaluations or 0)
    status, message = end.status, f"{end.message} {found.note}".strip()
    if found.instead is not None and status is Status.success:
        status, message = found.instead, found.note
    if times.size < asked:
        message = f"{message} The time budget ended when {times.size} of {asked} rows were interpolated; no more follow."
        status = Status.deadline if status is Status.success else status
    return Solution(
        t=every[0],
        q=every[1],
        v=every[2],
        lam=lam,
        mu=mu,
        status=status,
        message=f"{message} {note}".strip(),
        counters=replace(after, residual_evaluations=before.residual_evaluations, output_evaluations=spent),
        steps_data=history.steps_data(),
        carried=None if t_eval is not None else stage_values(engine, history, kept),
        interpolant=output,
        **history.events(),
    )


def stage_values(engine: Engine, history: History, count: int) -> Mapping[str, Matrix] | None:
    """Lam1 (k, m) and mu of the midpoint (k, p) at the first ``count`` rows; None without constraints."""
    if not engine.structure.constrained:
        return None
    return dict(
        zip(("lam", "mu"), padded(engine.dynamics, *(x[:count] for x in history.multiplier_guess(None))), strict=True)
    )


def recover_multipliers(engine: Engine, guess: tuple[Matrix, Matrix], times: Vector, q: Matrix, v: Matrix) -> Recovered:
    """The multipliers from the acceleration level, (H16), looked for near ``guess``: (k, m) and (k, p).

    Where that level is singular, or the time budget has ended, the stage values stay, with a note; rows end before a time
    where it is not finite.
    """
    s, lam, mu, undetermined = engine.structure, *guess, []
    if not s.constrained:
        return Recovered(np.zeros((times.size, 0)), np.zeros((times.size, 0)))
    try:
        done = engine.recovered(times, q, v, lam, mu)
    except BudgetSpent:  # nothing more can be compiled
        done = np.zeros(times.size, dtype=bool)
    for i in np.flatnonzero(~done).tolist():
        t = times[i]
        try:
            engine.work.check_time()
            found = acceleration_at(engine.acceleration, engine.dynamics, engine.work, float(t), q[i], v[i], (lam[i], mu[i]))
        except BudgetSpent:
            note = f"{late_note(i, times, engine.work)}; stage values (first order) stand in the rest."
            return Recovered(lam, mu, note, Status.deadline)
        except NonFiniteValue as error:
            note = f"{error}, when the multipliers were recovered."
            return Recovered(lam[:i], mu[:i], note, Status.nonfinite_callback)
        if not found.converged:
            undetermined.append(float(t))
        else:
            lam[i], mu[i] = found.lam, found.mu
    if not undetermined:
        return Recovered(lam, mu)
    note = (
        f"The acceleration level determines no multipliers at {len(undetermined)} times, "
        f"first at t = {undetermined[0]:.17g}; stage values (first order) stand there."
    )
    return Recovered(lam, mu, note)


def unrecovered(engine: Engine, history: History, t_eval: Vector | None, message: str, status: Status) -> Solution:
    """What was accepted before an exception; multipliers are the stage values, since no callback may be called any more."""
    output = history.dense_output()
    times = reached(output, t_eval)
    rows = history.rows() if t_eval is None else output(times)
    lam, mu = padded(engine.dynamics, *history.multiplier_guess(None if t_eval is None else times))
    return Solution(
        t=times,
        q=rows.q,
        v=rows.v,
        lam=lam,
        mu=mu,
        status=status,
        message=f"{message} The multipliers are stage values (first order).",
        counters=engine.work.counters(),
        steps_data=history.steps_data(),
        interpolant=output,
        **history.events(),
    )
