"""The Solution of every solver: rows with multipliers from the acceleration level, or the rows before an exception."""

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
AGAIN = 20  # rows, one after the other, that are looked at again where many at once have missed them
MARGIN = 1e3  # times what the rows that are held are off, or roundoff: so much the rows that are left out may be
DATA = 10.0  # times what the start is off: lengths may be given with few digits
LOOKED_AT = 40  # ends of steps, beside the rows, at which rows that are left out are looked at
ADVICE = (
    "it is only nearly dependent, the rank is another one there, or a step has led to another branch of the rows that are "
    "held. Leave those rows out of the system where they always follow from the others; else start where the rank is that "
    "of the motion."
)
Rows = tuple[Vector, Matrix, Matrix]  # t (k,), q and v (k, n)
RecoverMany = Callable[[], Any]  # puts the multipliers of easy rows in their place and returns which (k,)


class OwnMultipliers(NamedTuple):
    """A solver's own multipliers of its rows, which pick the root and stand where none are recovered; NaN: none."""

    lam: Matrix  #: (k, m)
    mu: Matrix  #: (k, p)
    first: tuple[Vector, Vector]  #: what picks the root in the rows before the first that has its own
    every: str  #: what they are, in words
    rest: str  #: the same of those after a row
    some: str  #: and of some


class Recovered(NamedTuple):
    """Multipliers (k, m) and (k, p) of the acceleration level; fewer rows where it is not finite.  ``note`` says so."""

    lam: Matrix
    mu: Matrix
    note: str = ""
    instead: Status | None = None  #: of a success, where rows are missing or not recovered


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
    """The Solution with ``rows``, as far as the acceleration level is finite there, and what the solver has ``carried``.

    ``recover_many`` is the solver's own code for multipliers of rows.  ``note`` ends the message; ``more`` are other fields,
    and ``_read(name)`` gives those that are made when read.  It has none of them where a redundant constraint costs rows.
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
    """``message``, and ``note`` if there is one as another sentence behind it."""
    return f"{message.removesuffix('.')}. {note}" if message and note else message or note


def _noted(end: Failure, found: Recovered) -> Failure:
    """How a run has ended, after its rows were checked."""
    replaced = (Status.success, Status.event) if found.instead is Status.redundant_constraints else (Status.success,)
    if found.instead is not None and end.status in replaced:
        return Failure(found.instead, found.note)
    return Failure(end.status, sentences(end.message, found.note))


def recover_multipliers(run: Solving, rows: Rows, own: OwnMultipliers, recover_many: RecoverMany | None) -> Recovered:
    """The multipliers of ``rows`` by (H16), looked for near the solver's ``own`` or those of the row before.

    Where the level is singular, or the time budget has ended, the solver's own stay, with a note; rows end before a time
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
    """Which rows (k,) have multipliers in ``own``: by code of full matrices or, where many rows pay for it, of entries."""
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
    """The same by the entries of a large KKT matrix, where there is machine code for them."""
    from solvers.kernel.compiled import shipped
    from solvers.kernel.kkt import kkt_of

    entries = kkt_of(dynamics)
    return None if entries is None else shipped("recover").following(entries.memory(dynamics))


def _one_by_one(run: Solving, rows: Rows, own: OwnMultipliers, done: Any) -> Recovered:
    """The multipliers of those ``rows`` that are not ``done``, which it notes where it finds them.

    Until ``AGAIN`` in a row are missed: the same iteration, from the same guesses, may have missed them together already.
    """
    (times, q, v), lam, mu, guess = rows, own.lam, own.mu, own.first
    if np.count_nonzero(done) == done.size:
        return Recovered(lam, mu)
    none: tuple[Any, Any] = np.isnan(lam).any(axis=1), np.isnan(mu).any(axis=1)
    missed = 0
    for i in np.flatnonzero(~done).tolist():
        if missed == AGAIN:
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
    """The acceleration level at one output time; a value that is not finite is tried once more."""
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
    """Multipliers of all constraints as far as some were ``found``, of least norm where redundant ones are left out.

    Where the time budget ends before, zeros stand for the redundant ones in the rest.  Rows end before a time, one of theirs
    or of some ``steps``, where a constraint that was left out is violated: a step has led to another branch of the others,
    or the rank is another one.  The note tells how well those constraints are held.
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
        data = min(data, DATA * worst)  # of the first place: later ones are off by more
        if i < count:
            from hhtbench.lowering.dynamics.rank import minimum_norm  # few constraints are redundant

            lam[i], mu[i] = np.split(minimum_norm(at.rows, np.concatenate([lam[i], mu[i]]), redundant), [m])
            done += 1
    text = f"Rows {list(redundant)} of [g; k] depend on the others and were left out"
    return Recovered(lam, mu, f"{text}; they hold to {worst:.1e} of their size." if order.size else f"{text}.")


def _with_steps(rows: Rows, steps: Any) -> tuple[Rows, Any]:
    """``rows`` and after them ends of some ``steps`` up to the last of them; and their order in time."""
    t = rows[0]
    if steps is None or not t.size:
        return rows, np.arange(t.size)
    ends = steps.t
    ahead = np.sign(ends[-1] - ends[0])
    some = np.unique(np.linspace(0, ends.size - 1, LOOKED_AT).astype(int))
    some = some[ahead * (ends[some] - t[-1]) < 0.0]
    both = [np.concatenate([x, y[some]]) for x, y in zip(rows, (ends, steps.q, steps.v), strict=True)]
    return (both[0], both[1], both[2]), np.argsort(ahead * both[0], kind="stable")


def _off_level(at: Levels, sizes: tuple[float, float]) -> Vector:
    """(m + p,) by how much of its size each constraint is off its levels; ``sizes`` of q and v."""
    position, off = at.scaled_position(sizes[0]), at.scaled_velocity(sizes[1]).copy()
    off[: position.size] = np.maximum(position, off[: position.size])
    return off


def _lost(off: Vector, redundant: tuple[int, ...], m: int, data: float) -> str:
    """Which of the ``redundant`` rows, ``off`` (m + p,) by parts of their size, is violated, as a sentence.

    ``data``: by how much they may be, as they are given with so many digits.
    """
    out = np.isin(np.arange(off.size), redundant)
    worst = int(np.argmax(np.where(out, off, -1.0)))
    if off[worst] <= max(data, MARGIN * max(EPS, float(np.max(off, where=~out, initial=0.0)))):
        return ""
    name = f"g[{worst}]" if worst < m else f"k[{worst - m}]"
    return f"{name} is off by {off[worst]:.2g} of its size"


def solved(solve: Callable[[], Solution], left_over: Callable[[Failure], Solution]) -> Solution:
    """``solve()``; what is raised in it carries ``.partial_solution``, what is ``left_over``."""
    try:
        return solve()
    except BaseException as error:
        status = Status.interrupted if isinstance(error, KeyboardInterrupt) else Status.user_exception
        left = left_over(Failure(status, f"{type(error).__name__}: {error}."))
        BaseException.__setattr__(error, "partial_solution", left)  # also where the class is frozen
        raise


def unrecovered(run: Solving, end: Failure, rows: Rows, own: OwnMultipliers, **more: Any) -> Solution:
    """The Solution with a solver's ``own`` multipliers: after an exception no function of the system is called.

    ``more`` as in :func:`solution_of`.
    """
    (t, q, v), (lam, mu), counters = rows, padded(run.dynamics, own.lam, own.mu), run.work.counters()
    ending = {"status": end.status, "message": f"{end.message} The multipliers are {own.every}.", "counters": counters}
    return Solution.of({"t": t, "q": q, "v": v, "lam": lam, "mu": mu, "_read": {}.get, **ending, **more})


def empty_solution(n: int, end: Failure, counters: Counters) -> Solution:
    """A Solution without rows: nothing was integrated."""
    none, rows = np.zeros((0, 0)), np.zeros((0, n))
    status, message = end.status, end.message
    return Solution(t=np.zeros(0), q=rows, v=rows, lam=none, mu=none, status=status, message=message, counters=counters)
