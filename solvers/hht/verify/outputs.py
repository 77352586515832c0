"""``hhtbench verify outputs``: rows at output times and at events hold both levels of the constraints, as steps do.

Over all problems on their validated spans and tolerances from 1e-2 to 1e-6: what is left of the constraints, what the
interpolant leaves, and what putting the rows there does to their error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench import list_problems, load_problem
from hhtbench.arguments import Matrix, Vector
from hhtbench.evidence import Evidence, Row
from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.protocol import Problem
from hhtbench.reference.plan import registered_plans, validated_spec
from solvers.hht.events.event import Event
from solvers.hht.solver import HHT
from solvers.hht.verify.control import MAX_SECONDS, TOLERANCES, known_motion, weighted_error
from solvers.hht.verify.measure import guesses, solved
from solvers.hht.verify.study import Progress, shown_row, verify

MET = 1e-12  # scaled violation of either level
GROWTH = 0.01  # of an error, at most
FLOOR = 1e-11  # errors below it are roundoff and limits of references
ROWS = 101  # beside the times at which the motion is known
SAMPLED = 200  # ends of steps that are looked at


@dataclass(frozen=True)
class Output:
    """What one run handed over."""

    rows: float  #: largest scaled violation of either level, of rows between steps
    events: float  #: at events
    steps: float  #: at the ends of steps, which nothing moves; at most SAMPLED of them
    interpolated: float  #: of the dense output at the same output times
    growth: float | None  #: of the error by putting rows onto the constraints, relative; None where it is roundoff


def output(problem: Problem, tolerance: float) -> Output:
    """Of ``problem`` at ``rtol`` = ``tolerance``, with rows at the known times and between, and events at every middle."""
    times, known = known_motion(problem)
    asked = np.union1d(times, np.linspace(*problem.t_span, ROWS))
    hht = HHT(problem.system, events=[_passes(problem, known)])
    request = {"rtol": tolerance, "atol": tolerance * _typical(problem), "max_seconds": MAX_SECONDS, **guesses(problem)}
    start = problem.t_span, problem.q0, problem.v0
    found = solved(problem.name, hht, *start, t_eval=asked, **request)
    steps = found if found.interpolant is not None else solved(problem.name, hht, *start, **request)  # they were too many
    levels = ConstraintLevels(derive(problem.system, problem.t_span[0], problem.q0, problem.v0), full=True)
    ends: Any = steps.interpolant
    some = np.unique(np.linspace(0, ends.t.size - 1, SAMPLED).astype(int))
    between = ~np.isin(asked, ends.t)
    plain, at = steps(asked), np.searchsorted(asked, times)
    errors = [weighted_error(problem, np.hstack([x.q[at], x.v[at]]), known) for x in (plain, found)]
    return Output(
        rows=violation(problem, levels, found.t[between], found.q[between], found.v[between]),
        events=violation(problem, levels, found.t_events[0], found.q_events[0], found.v_events[0]),
        steps=violation(problem, levels, ends.t[some], ends.q[some], ends.v[some]),
        interpolated=violation(problem, levels, asked, plain.q, plain.v),
        growth=errors[1] / errors[0] - 1.0 if errors[0] > FLOOR else None,
    )


def violation(problem: Problem, levels: ConstraintLevels, t: Vector, q: Matrix, v: Matrix) -> float:
    """The largest scaled violation of either level at the rows q, v (k, n) at ``t`` (k,)."""
    worst = 0.0
    for time, *state in zip(t, q, v, strict=True):
        at = levels.at(float(time), *state)
        both = np.concatenate([at.scaled_position(problem.scales.q), at.scaled_velocity(problem.scales.v)])
        worst = max(worst, float(np.max(both)))
    return worst


def _typical(problem: Problem) -> Vector:
    """Sizes of q and v, (2n,)."""
    n = problem.q0.size
    return np.concatenate([np.broadcast_to(np.asarray(x, dtype=float), n) for x in (problem.scales.q, problem.scales.v)])


def _passes(problem: Problem, known: Matrix) -> Event:
    """Recorded where the coordinate that moves most passes the middle of its range."""
    n = problem.q0.size
    low, high = known[:, :n].min(axis=0), known[:, :n].max(axis=0)
    moved = (high - low) / np.broadcast_to(problem.scales.q, n)
    most = int(np.argmax(moved))
    middle = float(0.5 * (low[most] + high[most]))
    return Event(lambda t, q, v: q[most] - middle, name="middle")


def outputs(spec: str, tolerances: Sequence[float] = TOLERANCES) -> list[Row]:
    """Rows of one problem: what is left of the constraints, and how much the errors have grown."""
    problem = load_problem(spec)
    dynamics = derive(problem.system, problem.t_span[0], problem.q0, problem.v0)
    if not dynamics.structure.constrained:
        return [shown_row(f"levels/{spec}", f"{spec}: constraints at rows and events", "it has none")]
    found = [output(problem, tolerance) for tolerance in tolerances]
    left = [max(one.rows, one.events) for one in found]
    listed = [left, [one.steps for one in found], [one.interpolated for one in found]]
    texts = [", ".join(f"{x:.0e}" for x in numbers) for numbers in listed]
    text = f"{texts[0]}; at ends of steps {texts[1]}; interpolated {texts[2]}"
    claim = f"{spec}: largest scaled violation of both levels at rows between steps and events, {_range(tolerances)}"
    rows = [Row(id=f"levels/{spec}", claim=claim, measured=text, bound=f"< {MET:g}", passed=max(left) < MET)]
    growth = [one.growth for one in found if one.growth is not None]
    claim = f"{spec}: change of the largest error by putting rows there, {_range(tolerances)}"
    text = ", ".join("roundoff" if one.growth is None else f"{one.growth:+.2%}" for one in found)
    passed = all(x <= GROWTH for x in growth)
    return [*rows, Row(id=f"error/{spec}", claim=claim, measured=text, bound=f"<= {GROWTH:.0%}", passed=passed)]


def _range(tolerances: Sequence[float]) -> str:
    return f"rtol {tolerances[0]:g} .. {tolerances[-1]:g}"


def verify_outputs(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Constraints and errors of rows between steps and at events, over all problems and tolerances.

    ``progress`` and ``jobs`` are those of :func:`~solvers.hht.verify.study.verify`.
    """
    plan = registered_plans()
    studies: list[Any] = [(outputs, validated_spec(name, plan)) for name in list_problems()]
    return verify("Rows and events between steps on the constraints", studies, progress, jobs)
