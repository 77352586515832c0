"""Build the Solution of every solver: recover multipliers of the rows, or keep the rows before an exception."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from hhtbench.lowering import (
    CONSISTENT,
    Dynamics,
    Levels,
    padded,
    redundant_rows,
    route_of,
    size_of,
    unreduced,
)
from hhtbench.lowering.dynamics.kkt_rows import Acceleration
from hhtbench.protocol.arguments import Matrix, Vector, all_finite
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Counters, Solution, Status
from solvers._finite import explain_nonfinite
from solvers._start import Failure, Solving, of_dynamics, points_of

EPS = float(np.finfo(np.float64).eps)
BLOCK = 256  # rows of the first call of machine code
MAX_MISSED = 20  # consecutive rows without multipliers after which single rows are not retried
MARGIN = 1e3  # redundant rows may be violated by so many times the violation of the others, or roundoff
START_MARGIN = 10.0  # and by so many times their violation at the start: lengths may be given with few digits
CHECKED_STEPS = 40  # ends of steps, in addition to the rows, at which redundant constraints are checked
ADVICE = (
    "it is only nearly dependent, the rank is another one there, or a step has led to another branch of the rows that are "
    "held. Leave those rows out of the system where they always follow from the others; else start where the rank is that "
    "of the motion."
)
Rows = tuple[Vector, Matrix, Matrix]  # t (k,), q and v (k, n)
RecoverMany = Callable[[], Any]  # fills in the multipliers of easy rows and returns a mask (k,) of these


class OwnMultipliers(NamedTuple):
    """A solver's own multipliers: they pick the root, and stand where none can be recovered; NaN if it has none."""

    lam: Matrix  #: (k, m)
    mu: Matrix  #: (k, p)
    first: tuple[Vector, Vector]  #: lam (m,) and mu (p,) that pick the root up to the first row with its own
    every: str  #: text on what they are
    rest: str  #: text where they stand in all later rows
    some: str  #: text where they stand in some rows


class Recovered(NamedTuple):
    """Multipliers (k, m) and (k, p) of the acceleration level, cut where it is not finite; ``note`` says why."""

    lam: Matrix
    mu: Matrix
    note: str = ""
    instead: Status | None = None  #: status that replaces success where rows are missing or not recovered


def solution_of(
    run: Solving,
    end: Failure,
    rows: Rows,
    own: OwnMultipliers,
    recover_many: RecoverMany | None = None,
    note: str = "",
    *,
    carried: Mapping[str, Matrix] | None = None,
    **more: Any,
) -> Solution:
    """The Solution with ``rows``, cut before the first where the acceleration level is not finite.

    ``carried``: the solver's own multipliers.  ``recover_many``: its own code to recover multipliers.  ``note`` is appended
    to the message; ``more`` are further fields, of which ``_read(name)`` gives those computed when read.  None of them are
    kept where a redundant constraint costs rows.
    """
    with run.work.for_output():
        found = whole = recover_multipliers(run, rows, own, recover_many)
        if unreduced(run.dynamics) is not run.dynamics:
            steps = more.get("interpolant") or more.get("_read", {}.get)("interpolant")
            whole = _of_all_constraints(run, rows, found, steps)
    t, q, v = [array[: len(whole.lam)] for array in rows]
    end = _noted(end, found)
    if whole is not found:
        end = _noted(end, whole)
        if len(whole.lam) < len(found.lam):
            more = {}
    if carried is not None:
        more["carried"] = {name: values[: t.size] for name, values in carried.items()}
    note = f"{note} {run.work.clock.note_of_differences()}".strip()
    ending = {"status": end.status, "message": sentences(end.message, note), "counters": run.work.counters()}
    return Solution.of({"t": t, "q": q, "v": v, "lam": whole.lam, "mu": whole.mu, "_read": {}.get, **ending, **more})


def sentences(message: str, note: str) -> str:
    """``message`` followed by ``note`` as another sentence, if there is one."""
    return f"{message.removesuffix('.')}. {note}" if message and note else message or note


def _noted(end: Failure, found: Recovered) -> Failure:
    """``end`` with the status and note of the recovered multipliers."""
    replaced = (Status.success, Status.event) if found.instead is Status.redundant_constraints else (Status.success,)
    if found.instead is not None and end.status in replaced:
        return Failure(found.instead, found.note)
    return Failure(end.status, sentences(end.message, found.note))


def recover_multipliers(run: Solving, rows: Rows, own: OwnMultipliers, recover_many: RecoverMany | None) -> Recovered:
    """Multipliers of ``rows`` by (H16), iterated from the solver's ``own`` or those of the row before.

    Where the level is singular or the time budget has ended, the solver's own stay, with a note; rows are cut before a time
    where it is not finite.
    """
    if not run.dynamics.structure.constrained:
        return Recovered(own.lam, own.mu)
    times = rows[0]
    try:
        done = recover_many() if recover_many else _by_machine_code(run, rows, own)
    except BudgetSpent:  # nothing more can be compiled
        done = np.zeros(times.size, dtype=bool)
    found = _one_by_one(run, rows, own, done)
    note = found.note
    if found.instead is None and np.count_nonzero(done) < done.size:  # in a fifth of the time of all()
        undetermined = times[~done]
        first = f"The acceleration level determines no multipliers at {undetermined.size} times, first at "
        note = f"{first}t = {exact(undetermined[0])}; {own.some}. {note}".strip()
    return found._replace(note=note)


def _by_machine_code(run: Solving, rows: Rows, own: OwnMultipliers) -> Any:
    """Recover multipliers in ``own`` by machine code, of full matrices or (many rows) of entries; mask (k,) of rows done."""
    (times, q, v), lam, mu, dynamics = rows, own.lam, own.mu, run.dynamics
    done = np.zeros(times.size, dtype=bool)
    if route_of(dynamics) == "numpy":
        return done
    from solvers.kernel.blocks import FEW, in_blocks  # plain callables do without the loops

    level = of_dynamics(dynamics).compiled
    if level is None and times.size < FEW:
        return done
    recover = level.recover if level else _by_entries(dynamics)
    if recover is None:
        return done
    packed = np.concatenate([times[:, None], q, v, lam, mu], axis=1)
    going = lambda: run.work.clock.left() >= 0.0  # noqa: E731
    in_blocks(times.size, BLOCK, lambda block: recover(packed[block], done[block]), going)
    found = packed[done, 1 + 2 * q.shape[1] :]
    lam[done], mu[done] = found[:, : lam.shape[1]], found[:, lam.shape[1] :]
    run.work.add("residual_evaluations", int(done.sum()))
    return done


def _by_entries(dynamics: Dynamics) -> Callable[..., Any] | None:
    """Machine code that recovers multipliers by the entries of a large KKT matrix; None if there is none."""
    from solvers.kernel.compiled import shipped
    from solvers.kernel.kkt import kkt_of

    entries = kkt_of(dynamics)
    return None if entries is None else shipped("recover").following(entries.memory(dynamics))


def _one_by_one(run: Solving, rows: Rows, own: OwnMultipliers, done: Any) -> Recovered:
    """Recover the multipliers of ``rows`` not yet ``done``, one by one; marks those found in ``done``.

    Stops after ``MAX_MISSED`` consecutive failures, as the same iteration has failed for these rows before.
    """
    (times, q, v), lam, mu, guess = rows, own.lam, own.mu, own.first
    if np.count_nonzero(done) == done.size:
        return Recovered(lam, mu)
    none: tuple[Any, Any] = np.isnan(lam).any(axis=1), np.isnan(mu).any(axis=1)
    missed = 0
    for i in np.flatnonzero(~done).tolist():
        if missed == MAX_MISSED:
            break
        guess = guess[0] if none[0][i] else lam[i].copy(), guess[1] if none[1][i] else mu[i].copy()
        try:
            run.work.check_time()
            found = _acceleration_at(run, float(times[i]), q[i], v[i], guess)
        except BudgetSpent:
            ended = f"The time budget ended when {i} of {times.size} rows had their multipliers{run.work.clock.passed_in}"
            return Recovered(lam, mu, f"{ended}; {own.rest}.", Status.deadline)
        except NonFiniteValue as error:
            note = f"{error}, when the multipliers were recovered."
            return Recovered(lam[:i], mu[:i], note, Status.nonfinite_callback)
        done[i], missed = found.converged, 0 if found.converged else missed + 1
        if found.converged:
            guess = found.lam, found.mu
        lam[i], mu[i] = guess
    return Recovered(lam, mu)


def _acceleration_at(run: Solving, t: float, q: Vector, v: Vector, guess: tuple[Vector, Vector]) -> Acceleration:
    """Solve the acceleration level at one output time; retried once after a value that is not finite."""
    for last in (False, True):
        try:
            found = of_dynamics(run.dynamics).acceleration.solve(t, q, v, *guess)
            run.work.add("residual_evaluations", points_of(run.dynamics))
            if not (all_finite(found.lam) and all_finite(found.mu)):
                explain_nonfinite(run.dynamics, t, q, v)
            break
        except NonFiniteValue:
            run.work.add("nonfinite_evaluations")
            if last:
                raise
    return found


def _of_all_constraints(run: Solving, rows: Rows, found: Recovered, steps: Any) -> Recovered:
    """Multipliers of all constraints, of least norm where redundant rows were left out, from those ``found`` without them.

    Where the time budget ends, the rest has zeros for redundant rows.  Rows are cut before a time (of a row or some
    ``steps``) where a constraint that was left out is violated: a step has led to another branch, or the rank has changed.
    The note says how well those constraints are satisfied.
    """
    whole, (lam, mu) = unreduced(run.dynamics), padded(run.dynamics, found.lam, found.mu)
    levels, m, redundant = of_dynamics(whole).levels, whole.structure.m, redundant_rows(run.dynamics)
    count, done = len(lam), 0
    (times, q, v), order = _with_steps((rows[0][:count], rows[1][:count], rows[2][:count]), steps)
    sizes, worst, data = (size_of(q), size_of(v)), 0.0, CONSISTENT
    for i in order.tolist():
        t = float(times[i])
        try:
            run.work.check_time()
            at = levels.at(t, q[i], v[i])
        except BudgetSpent:
            ended = f"The time budget ended when {done} of {count} rows were checked for constraints left out as redundant"
            return Recovered(lam, mu, f"{ended}; the multipliers of these are zero in the rest.", Status.deadline)
        off = _off_level(at, sizes)
        if lost := _lost(off, redundant, m, data):
            note = f"At t = {exact(t)} {lost}, left out as redundant at the start: {ADVICE}"
            return Recovered(lam[:done], mu[:done], note, Status.redundant_constraints)
        worst = max(worst, float(off[list(redundant)].max()))
        data = min(data, START_MARGIN * worst)  # data at the first point: later ones are off by more
        if i < count:
            from hhtbench.lowering.dynamics.rank import minimum_norm  # few constraints are redundant

            lam[i], mu[i] = np.split(minimum_norm(at.rows, np.concatenate([lam[i], mu[i]]), redundant), [m])
            done += 1
    text = f"Rows {list(redundant)} of [g; k] depend on the others and were left out"
    return Recovered(lam, mu, f"{text}; they hold to {worst:.1e} of their size." if order.size else f"{text}.")


def _with_steps(rows: Rows, steps: Any) -> tuple[Rows, Any]:
    """``rows`` followed by the ends of some ``steps`` up to their last, and the order in time of all."""
    t = rows[0]
    if steps is None or not t.size:
        return rows, np.arange(t.size)
    ends = steps.t
    ahead = np.sign(ends[-1] - ends[0])
    some = np.unique(np.linspace(0, ends.size - 1, CHECKED_STEPS).astype(int))
    some = some[ahead * (ends[some] - t[-1]) < 0.0]
    both = [np.concatenate([x, y[some]]) for x, y in zip(rows, (ends, steps.q, steps.v), strict=True)]
    return (both[0], both[1], both[2]), np.argsort(ahead * both[0], kind="stable")


def _off_level(at: Levels, sizes: tuple[float, float]) -> Vector:
    """(m + p,) violation of each constraint relative to its size, the larger of both levels; ``sizes`` of q and v."""
    position, off = at.scaled_position(sizes[0]), at.scaled_velocity(sizes[1]).copy()
    off[: position.size] = np.maximum(position, off[: position.size])
    return off


def _lost(off: Vector, redundant: tuple[int, ...], m: int, data: float) -> str:
    """Text naming the ``redundant`` row that is violated, "" if none; ``off`` (m + p,) are relative violations.

    ``data``: violation explained by the digits with which lengths are given.
    """
    out = np.isin(np.arange(off.size), redundant)
    worst = int(np.argmax(np.where(out, off, -1.0)))
    if off[worst] <= max(data, MARGIN * max(EPS, float(np.max(off, where=~out, initial=0.0)))):
        return ""
    name = f"g[{worst}]" if worst < m else f"k[{worst - m}]"
    return f"{name} is off by {off[worst]:.2g} of its size"


def solved(solve: Callable[[], Solution], left_over: Callable[[Failure], Solution]) -> Solution:
    """Call ``solve()``; an exception raised in it gets the attribute ``.partial_solution``, made by ``left_over``."""
    try:
        return solve()
    except BaseException as error:
        status = Status.interrupted if isinstance(error, KeyboardInterrupt) else Status.user_exception
        left = left_over(Failure(status, f"{type(error).__name__}: {error}."))
        BaseException.__setattr__(error, "partial_solution", left)  # also where the class is frozen
        raise


def unrecovered(run: Solving, end: Failure, rows: Rows, own: OwnMultipliers, **more: Any) -> Solution:
    """The Solution after an exception, with the solver's ``own`` multipliers, as no function of the system may be called.

    ``more`` as in :func:`solution_of`.
    """
    (t, q, v), (lam, mu), counters = rows, padded(run.dynamics, own.lam, own.mu), run.work.counters()
    ending = {"status": end.status, "message": f"{end.message} The multipliers are {own.every}.", "counters": counters}
    return Solution.of({"t": t, "q": q, "v": v, "lam": lam, "mu": mu, "_read": {}.get, **ending, **more})


def empty_solution(n: int, end: Failure, counters: Counters) -> Solution:
    """A Solution without rows, for a run that did not start."""
    none, rows = np.zeros((0, 0)), np.zeros((0, n))
    status, message = end.status, end.message
    return Solution(t=np.zeros(0), q=rows, v=rows, lam=none, mu=none, status=status, message=message, counters=counters)
