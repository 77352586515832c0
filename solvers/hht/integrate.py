"""The loop over prescribed steps, and what it hands over: rows at output times with recovered multipliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import BudgetSpent, NonFiniteValue, Stop
from hhtbench.request import StepPlan
from hhtbench.result import Solution, Status
from solvers.hht.engine import Failure, HostEngine
from solvers.hht.history import History
from solvers.hht.state import State


@dataclass(frozen=True)
class End:
    """How the loop ended."""

    status: Status
    message: str
    state: State


def integrate(engine: HostEngine, state: State, plan: StepPlan, history: History, max_num_steps: int | None) -> End:
    """Take the steps of ``plan`` until the end, a failure or a budget; every accepted step is in ``history``."""
    for index in range(plan.count):
        if max_num_steps is not None and index >= max_num_steps:
            return End(Status.max_steps, f"{index} steps were taken and t = {state.t:.17g} reached; {Status.max_steps.text}", state)
        h, t1 = plan.length(index), plan.end(index)
        if state.t + h == state.t or t1 == state.t:
            message = f"t = {state.t:.17g} cannot be advanced by h = {h:g}; {Status.time_resolution.text}"
            return End(Status.time_resolution, message, state)
        try:
            engine.work.check_time()
            step = engine.step(state, h, t1)
        except Stop as stop:
            return End(*_stopped(stop, state), state)
        if isinstance(step, Failure):
            return End(step.status, step.message, state)
        history.add(step)
        engine.work.add("steps_accepted")
        state = step.state
    return End(Status.success, Status.success.text, state)


def _stopped(stop: Stop, state: State) -> tuple[Status, str]:
    if isinstance(stop, BudgetSpent):
        status = Status.deadline if stop.budget == "seconds" else Status.evaluation_budget
        return status, f"{stop} at t = {state.t:.17g}; {status.text}"
    return Status.nonfinite_callback, f"{stop}, in the step from t = {state.t:.17g}"


def assemble(engine: HostEngine, history: History, t_eval: Vector | None, end: End, note: str) -> Solution:
    """The Solution: rows at ``t_eval`` (None: at every step) that were reached, multipliers by (H16)."""
    output = history.dense_output()
    times = output.t
    if t_eval is not None:
        direction = -1.0 if output.t[-1] < output.t[0] else 1.0
        times = t_eval[direction * t_eval <= direction * output.t[-1]]
    rows = output(times)
    engine.work.lift_budgets()
    lam, mu, problem = recover_multipliers(engine, history, times, rows.q, rows.v)
    kept = len(lam)
    status, message = (end.status, end.message) if problem is None else (Status.nonfinite_callback, problem)
    return Solution(
        t=times[:kept],
        q=rows.q[:kept],
        v=rows.v[:kept],
        lam=lam,
        mu=mu,
        status=status,
        message=f"{message} {note}".strip(),
        counters=engine.work.counters(),
        steps_data=history.steps_data(),
        interpolant=output,
    )


def recover_multipliers(
    engine: HostEngine, history: History, times: Vector, q: Matrix, v: Matrix
) -> tuple[Matrix, Matrix, str | None]:
    """lam (k, m) and mu (k, p) from the acceleration level, (H16); rows before one that cannot be found, with the reason."""
    s = engine.structure
    lam, mu = np.zeros((times.size, s.m)), np.zeros((times.size, s.p))
    if not s.constrained:
        return lam, mu, None
    lam_guess, mu_guess = history.multiplier_guess(times)
    for i, t in enumerate(times):
        try:
            found = engine.acceleration.solve(float(t), q[i], v[i], lam_guess[i], mu_guess[i])
        except NonFiniteValue as error:
            return lam[:i], mu[:i], f"{error}, when the multipliers were recovered"
        engine.work.add("residual_evaluations", engine.points)
        if not (np.all(np.isfinite(found.lam)) and np.all(np.isfinite(found.mu))):
            return lam[:i], mu[:i], f"the multipliers at t = {t:.17g} are not finite"
        lam[i], mu[i] = found.lam, found.mu
    return lam, mu, None


def unrecovered(engine: HostEngine, history: History, t_eval: Vector | None, message: str, status: Status) -> Solution:
    """What was accepted before an exception; multipliers are the stage values, since no callback may be called any more."""
    output = history.dense_output()
    times = output.t
    if t_eval is not None:
        direction = -1.0 if output.t[-1] < output.t[0] else 1.0
        times = t_eval[direction * t_eval <= direction * output.t[-1]]
    rows = output(times)
    lam, mu = history.multiplier_guess(times)
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
    )
