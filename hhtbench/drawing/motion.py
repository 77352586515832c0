"""Compute the states for a drawing, over the time that shows the motion."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from hhtbench.api import solve
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution, Status

SAMPLES = 600  # states of a course: 40 a swing where an interval holds 15 swings
SMOOTH_STATES = 120  # states for a smooth path; if a span has fewer, it is solved again
RTOL = 1e-6  # a thousandth of a pixel
BUDGET = 50_000  # evaluations of a default solver: counted, not seconds, so that every machine draws the same
TIGHT = "collocation(form=ggl)"
UNCONSTRAINED = "collocation(form=index1)"
QUICK = "ida(form=ggl)"  # where the budget is used up

TURN = 2.2  # length of a path over its extent: a circle has 2.22, to and fro 2, once across 1
ACROSS = 0.9  # length over extent from which a swing that stands still counts as a whole one
STANDING = 0.2  # speed over the largest, below which a local minimum of the speed counts as a turning point
DIVIDERS = 0.08  # chord length over the path's extent: small fast vibrations do not add to the length
SETTLED = 0.98  # share of all paths after which a motion has come to rest ...
EARLY = 0.5  # ... if it is reached in this part of the interval


@dataclass(frozen=True, kw_only=True)
class Course:
    """States over time."""

    t: Vector  #: (k,) [s]
    q: Matrix  #: (k, n)
    source: str  #: where they come from
    stopped: str = ""  #: why they end before the end that was asked for; "" where they reach it


def find_course(problem: Problem, solver: str | None = None, seconds: float | None = None) -> Course:
    """Compute the states of ``problem`` over the time that shows its motion, or over ``seconds`` [s] from the start.

    They come from the named ``solver``, else from the closed solution, else from the default solvers; if no
    solver makes a step, only the start is returned.

    Raises
    ------
    ProblemError
        ``seconds`` lies outside the interval.
    """
    t0, t1 = problem.t_span
    if seconds is not None:
        if not 0 < seconds <= abs(t1 - t0):
            raise ProblemError(
                f"seconds must be above 0 and at most {abs(t1 - t0):g}, the interval of {problem.name}; got {seconds:g}. "
                "The problem's own t_end makes the interval longer."
            )
        return _course(problem, t0 + np.copysign(seconds, t1 - t0), solver)
    whole = _course(problem, t1, solver)
    end = telling_end(whole.t, trace_points(problem, whole.q))
    kept = int(np.argmin(np.abs(whole.t - end))) + 1
    if kept >= SMOOTH_STATES:
        return replace(whole, t=whole.t[:kept], q=whole.q[:kept])
    return replace(_course(problem, end, solver), stopped=whole.stopped)


def trace_points(problem: Problem, q: Matrix) -> Any:
    """Positions (k, j, d) of the sketch's points, or (k, 2 l, d) of the ends of its lines if it has no points."""
    drawings = [draw_state(problem, row) for row in q]
    return np.array([points if len(points) else lines.reshape(-1, lines.shape[-1]) for points, lines, _ in drawings])


def telling_end(t: Vector, places: Any) -> float:
    """Return the time [s] up to which a motion is shown: about one turn, one swing, or until it comes to rest.

    ``places`` (k, j, d).  The point with the widest path is followed until it stands still on the other side or
    its path is ``TURN`` times as long as it is wide: phases on the way back would hide those on the way there.  Motions
    along a level line, whose phases stand below one another, are shown there and back.  A motion that covers ``SETTLED`` of
    all its paths before ``EARLY`` of the interval ends there.
    """
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    extents = np.linalg.norm(np.ptp(places, axis=0), axis=-1)
    if extents.max() == 0:
        return float(t[-1])
    main = int(np.argmax(extents))
    path = _measure(places[:, main], DIVIDERS * extents[main]) / extents[main]
    level = places.shape[-1] == 2 and np.ptp(places[..., 1], axis=0).max() < 1e-4 * extents[main]
    ends = [_first(path > TURN)] + ([] if level else [_first((path > ACROSS) & _turns_back(steps[:, main]))])
    total = np.cumsum(steps.sum(axis=1))
    settled = _first(total >= SETTLED * total[-1])
    if settled < EARLY * len(t):
        ends.append(settled)
    return float(t[min(*ends, len(t) - 1)])


def _measure(places: Any, opening: float) -> Vector:
    """Return the length of the path up to each of ``places`` (k, d), measured by chords of at least ``opening``."""
    length, foot, lengths = 0.0, places[0], []
    for place in places:
        gap = float(np.linalg.norm(place - foot))
        if gap >= opening:
            length, foot = length + gap, place
        lengths.append(length)
    return np.array(lengths)


def _turns_back(steps: Vector) -> Any:
    """Mark the places at which the path is slowest locally, and slow compared with its fastest step."""
    before, after = np.append(np.inf, steps), np.append(steps, np.inf)
    near = np.minimum(before, after)
    around = np.minimum(np.append(np.inf, near[:-1]), np.append(near[1:], np.inf))
    return (near <= around) & (near < STANDING * steps.max())


def _first(flags: Any) -> int:
    """Return the index of the first True, or the number of flags if there is none."""
    return int(np.argmax(np.append(flags, True)))


def draw_state(problem: Problem, q: Vector) -> tuple[Any, Any, str]:
    """Return points (j, d), lines (l, 2, d) and the note of the sketch at ``q``; in space the third axis points up.

    A sketch in space may name another axis in ``up``: 1 turns its second axis up.  Its ``note`` may state what is not
    drawn to scale.

    Raises
    ------
    ProblemError
        No sketch is declared, or it returns something else.
    """
    if problem.sketch is None:
        raise ProblemError(
            f"{problem.name} declares no sketch, so there is nothing to draw.  Give the Problem a function "
            'sketch(q) -> {"points": (k, d), "lines": (l, 2, d)}, d = 2 or 3: joints, and the ends of straight pieces.'
        )
    drawing = problem.sketch(q)
    try:
        points, lines = (np.asarray(drawing[key], dtype=np.float64) for key in ("points", "lines"))
    except (KeyError, TypeError, ValueError) as error:
        raise ProblemError(f"{problem.name}: sketch(q) must return points and lines; got {drawing!r}.") from error
    d = points.shape[-1] if points.ndim == 2 else 0
    if d not in (2, 3) or lines.shape[1:] != (2, d) or not (np.isfinite(points).all() and np.isfinite(lines).all()):
        raise ProblemError(
            f"{problem.name}: sketch(q) must return finite points (k, d) and lines (l, 2, d), d = 2 or 3; "
            f"got {points.shape} and {lines.shape}."
        )
    turn = int(drawing.get("up", 2)) - 2 if d == 3 else 0
    return np.roll(points, -turn, axis=-1), np.roll(lines, -turn, axis=-1), str(drawing.get("note", ""))


def _course(problem: Problem, end: float, solver: str | None) -> Course:
    """Compute the states from the start to ``end`` [s]."""
    t = np.linspace(problem.t_span[0], end, SAMPLES)
    if solver is None and problem.exact is not None:
        return Course(t=t, q=np.array([problem.exact(float(s)).q for s in t]), source="closed solution")
    name, solution = _solved(replace(problem, t_span=(problem.t_span[0], end)), t, solver)
    if len(solution.t) > 1:
        stopped = "" if solution.success else f"{name} stopped at t = {solution.t[-1]:.4g} s: {solution.status.label}"
        return Course(t=solution.t, q=solution.q, source=f"{name}, rtol {RTOL:g}", stopped=stopped)
    why = f"{name} made no step: {solution.status.label}; only the start is drawn"
    return Course(t=np.array([problem.t_span[0]]), q=problem.q0[None], source="the start", stopped=why)


def _solved(problem: Problem, t: Vector, solver: str | None) -> tuple[str, Solution]:
    """Solve and return the solver's name and solution; a default solver that exhausts its budget is replaced by a faster
    one.

    No other failure is: a less careful solver would draw a wrong motion where the first one stops for mechanical reasons.
    """
    if solver is not None:
        return solver, solve(problem, solver, rtol=RTOL, t_eval=t)
    first = UNCONSTRAINED if "unconstrained" in problem.tags else TIGHT
    solution = solve(problem, first, rtol=RTOL, t_eval=t, max_evaluations=BUDGET)
    if solution.status is not Status.evaluation_budget:
        return first, solution
    return QUICK, solve(problem, QUICK, rtol=RTOL, t_eval=t, max_evaluations=BUDGET)
