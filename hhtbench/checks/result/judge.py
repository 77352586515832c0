"""Apply all checks to a reported success: its rows, its steps, the constraints, the equations of motion.

Used by campaigns and by ``solution.verify()``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from hhtbench.checks.jumps import Jumps
from hhtbench.checks.phases import phases_of
from hhtbench.checks.result.allowed import allowed_errors
from hhtbench.checks.result.between import bends, stand_out
from hhtbench.checks.result.flow import Equations, NotJudged
from hhtbench.checks.result.levels import CHECKED_ROWS, sizes_of, spread, violated
from hhtbench.checks.result.motion import Follower, Multipliers, Rows, Window
from hhtbench.checks.result.reactions import Row, rows_of, wrong_reactions
from hhtbench.checks.result.success import SAME_TIME, doubt_about, wrong_columns
from hhtbench.checks.result.unknown import unknown_without_reason
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.solution.request import Request
from hhtbench.solution.result import Ends, Solution

MAX_WINDOWS = 60  # in a motion with many jumps; more are sampled at random
DRAWN = 2  # windows that begin at random rows, beside the first row and the last but one
MAX_NAMED = 5  # jumps that a message names
NEAR = 50  # steps at the beginning of a window that are judged beside its output rows


@dataclass(frozen=True)
class Judgement:
    """Objection to a success, and what was checked."""

    doubt: str  #: begins with the name of the check that failed; "" where all is well
    windows: tuple[Window, ...] = ()  #: that were integrated again
    not_judged: str = ""  #: why the equations of motion say nothing, or ""
    jumps: tuple[float, ...] = ()  #: where prescribed velocities jump [s]: the motion is judged piece by piece

    def metrics(self) -> dict[str, Any]:
        """Return ``metrics["trust"]`` of a row."""
        worst = max((window.off / window.bound for window in self.windows), default=None)
        judged = sum(window.judged for window in self.windows)
        found = {"motion": worst, "windows": judged, "not_judged": self.not_judged or None}
        return {**found, "jumps": list(self.jumps)} if self.jumps else found


def judge(problem: Problem, request: Request, solution: Any, *, draw: int = 0) -> Judgement:
    """Apply every check until one fails; a result that is no success is not judged.

    The solver's own steps are judged if ``solution.ends`` holds them.  ``draw`` seeds the choice of rows at which some
    windows begin, so that a solver cannot know them; the same number gives the same rows.
    """
    doubt = doubt_about(problem, request, solution)
    if doubt or not solution.success:
        return Judgement(doubt)
    judged = [_judge_in_phase(*one, request, draw) for one in phases_of(problem, solution)]
    wrong = next((one for one in judged if one.doubt), None)
    if wrong is not None or len(judged) == 1:
        return wrong or judged[0]
    reasons = "; ".join(dict.fromkeys(one.not_judged for one in judged if one.not_judged))
    windows, jumps = (tuple(x for one in judged for x in getattr(one, name)) for name in ("windows", "jumps"))
    return Judgement("", windows, "" if any(window.judged for window in windows) else reasons, jumps)


def _judge_in_phase(problem: Problem, solution: Solution, request: Request, draw: int) -> Judgement:
    """Apply the checks that need the system of a motion."""
    try:
        doubt = wrong_columns(problem, solution) or unknown_without_reason(problem, solution)
        equations = Equations(problem)
        solution = _beside_jumps(problem, solution, equations.jumps)
        every: tuple[Any, ...] = solution, solution.ends
        for rows in filter(None, every):
            doubt = doubt or violated(problem, request, (rows.t, rows.q, rows.v), deep=True)
        return Judgement(doubt) if doubt else _motion(problem, request, solution, equations, draw)
    except NotJudged as reason:
        return Judgement("", not_judged=str(reason))
    except Exception as error:  # noqa: BLE001 - a function of the problem, which has its own check
        return Judgement("", not_judged=f"{type(error).__name__}: {error}")


def _beside_jumps(problem: Problem, solution: Solution, jumps: Jumps) -> Solution:
    """Return ``solution`` without rows and steps at jumps, where interpolants are on neither side; its ends are moved."""
    if not jumps.times.size:
        return solution
    distance = SAME_TIME * abs(problem.t_span[1] - problem.t_span[0])

    def kept(rows: Any, names: tuple[str, ...]) -> dict[str, Any]:
        some = ~jumps.near(rows.t, distance)
        some[[0, -1]] = True
        found = {name: getattr(rows, name)[some] for name in names}
        return found | {"t": jumps.beside(found["t"], found["q"], found["v"], distance)}

    ends = solution.ends
    ends = None if ends is None else Ends(**kept(ends, ("t", "q", "v")))
    return solution.but(ends=ends, **kept(solution, ("t", "q", "v", "lam", "mu")))


def _motion(problem: Problem, request: Request, solution: Solution, equations: Equations, draw: int) -> Judgement:
    """Judge the windows and the multipliers of rows; ``solution`` has no rows at jumps."""
    jumps, size = equations.jumps, sizes_of(problem, solution.q, solution.v)
    at = tuple(jumps.times.tolist())
    follower = Follower(problem, request, equations, size, allowed_errors(problem, request, equations, size))
    starts = _starts(solution, jumps, size, draw)
    some = _at_no_event(solution, sorted({*starts, *spread(solution.t.size).tolist()}))
    rows = [row for row in rows_of(follower, solution, some) if not _follows_a_jump(solution, jumps, row.i)]
    starts += [i for piece in _pieces(np.array([row.t for row in rows]), jumps) for i in _bent(follower, rows[piece], draw)]
    windows = []
    for of_window, multipliers in _windows(problem, solution, jumps, size, starts, draw):
        windows.append(follower.follow(of_window, multipliers))
        if windows[-1].failed:
            return Judgement(_described(windows[-1], request, jumps), tuple(windows), jumps=at)
    found = tuple(windows)
    wrong = wrong_reactions(follower, rows)
    if wrong or any(window.judged for window in found):
        return Judgement(wrong, found, jumps=at)
    reasons = dict.fromkeys(window.unfinished for window in found if window.unfinished)
    blunt = "at what was asked for, the rows are too close to a straight line to tell them from one"
    return Judgement("", found, "; ".join(reasons) or (blunt if found else "no two rows lie between jumps"), at)


def _described(window: Window, request: Request, jumps: Jumps) -> str:
    asked = "its steps" if request.fixed else "its tolerances"
    across = jumps.times[jumps.between(window.start, window.at)]
    times = " and ".join(f"{t:.9g}" for t in across[:MAX_NAMED])
    jump = f" The prescribed velocities jump at t = {times}, where the constraints' impulse acts." if times else ""
    return (
        f"equations of motion: from the row at t = {exact(window.start)} the motion leads elsewhere than to the row at "
        f"t = {exact(window.at)}: they are {window.off:.2g} times as far apart as {asked} let one step be off; "
        f"up to {window.bound:.2g} is believed.{jump}"
    )


def _starts(solution: Solution, jumps: Jumps, size: Vector, draw: int) -> list[int]:
    """Return the output rows at which windows begin: the first, the last but one, some random ones, and outliers."""
    count = solution.t.size
    if count < 2:
        return []
    drawn = np.random.default_rng(draw).integers(0, count - 1, DRAWN).tolist()
    return sorted({0, count - 2, *drawn, *_outlying(solution, jumps, size)})


def _outlying(rows: Solution | Ends, jumps: Jumps, size: Vector) -> list[int]:
    """Return ``rows`` whose change to the next row is an outlier between the same jumps, and the last before jumps."""
    pieces = _pieces(rows.t, jumps)
    found = [piece.stop - 1 for piece in pieces if piece.stop < rows.t.size]
    for piece in pieces:
        found += [piece.start + i for i in stand_out(Rows(rows.t[piece], rows.q[piece], rows.v[piece]), size)]
    return found


def _pieces(t: Vector, jumps: Jumps) -> list[slice]:
    """Split the rows at ``t`` (k,) into slices between neighbouring jumps."""
    if not jumps.times.size:
        return [slice(0, t.size)]
    sign = np.sign(jumps.after[0] - jumps.before[0])
    ends = [0, *np.searchsorted(sign * t, sign * jumps.times).tolist(), t.size]
    return [slice(*pair) for pair in pairwise(ends) if pair[0] < pair[1]]


def _follows_a_jump(solution: Solution, jumps: Jumps, i: int) -> bool:
    """True if row ``i`` is the first after a jump: the multipliers of the step across it are those of the impulse."""
    return i > 0 and bool(jumps.between(solution.t[i - 1], solution.t[i]))


def _at_no_event(solution: Solution, some: list[int]) -> list[int]:
    """Return those rows of ``some`` that are not at an event, which may have changed the state; the last one always."""
    events = np.concatenate([np.zeros(0), *solution.t_events])
    return [i for i in some if i == solution.t.size - 1 or solution.t[i] not in events]


def _bent(follower: Follower, rows: list[Row], draw: int) -> list[int]:
    """Return the rows at which the accelerations, at the rows and between them, fit the states least."""
    if len(rows) < 2:
        return []
    t, size, equations = np.array([row.t for row in rows]), follower.size, follower.equations

    def between(t: Vector, q: Matrix, v: Matrix) -> Matrix:
        found = []
        for row, at, y in zip(rows, t.tolist(), np.concatenate([q, v], axis=1), strict=False):
            equations.begin(1, row.multipliers)
            found.append(equations(at, y)[size.size // 2 :])
        return np.array(found)

    places = max(1, CHECKED_ROWS // t.size)
    parts = (np.arange(places)[:, None] + np.random.default_rng(draw).random((places, t.size - 1))) / places
    y, vdot = np.array([row.y for row in rows]), np.array([row.vdot for row in rows])
    return [rows[i].i for i in bends(t, y, vdot, between, parts, size)]


def _windows(
    problem: Problem, solution: Solution, jumps: Jumps, size: Vector, starts: list[int], draw: int
) -> Iterator[tuple[Rows, Multipliers]]:
    """Yield the rows of a few windows, from the last one on: output rows and steps together, with multipliers to begin
    with.

    They begin at the rows ``starts`` and where steps are outliers; they end at events, which may change the state.
    """
    direction = -1.0 if problem.t_span[1] < problem.t_span[0] else 1.0
    events = np.sort(direction * np.concatenate([np.zeros(0), *solution.t_events]))
    times = {float(solution.t[i]) for i in starts}
    if solution.ends is not None:
        times |= {float(solution.ends.t[k]) for k in _outlying(solution.ends, jumps, size)}
    if len(times) > MAX_WINDOWS:
        times = set(np.random.default_rng(draw).choice(sorted(times), MAX_WINDOWS, replace=False).tolist())
    for start in sorted(times, key=lambda t: -direction * t):
        rows = _rows(solution, start, direction)
        after = events[events >= direction * rows.t[0]]
        kept = direction * rows.t < after[0] if after.size else np.ones(rows.t.size, dtype=bool)
        rows = Rows(*(part[kept] for part in rows))
        if rows.t.size > 1:
            i = max(0, int(np.searchsorted(direction * solution.t, direction * start, "right")) - 1)
            yield rows, Multipliers(solution.lam[i], solution.mu[i])


def _rows(solution: Solution, start: float, direction: float) -> Rows:
    """Return the output rows from ``start`` [s] on, merged with the next steps."""
    i = int(np.searchsorted(direction * solution.t, direction * start, "left"))
    parts = [(solution.t[i:], solution.q[i:], solution.v[i:])]
    if (ends := solution.ends) is not None:
        begin = int(np.searchsorted(direction * ends.t, direction * start, "left"))
        some = slice(begin, begin + NEAR)
        parts.append((ends.t[some], ends.q[some], ends.v[some]))
    t, q, v = (np.concatenate(part) for part in zip(*parts, strict=True))
    order = np.argsort(direction * t, kind="stable")
    return Rows(t[order], q[order], v[order])
