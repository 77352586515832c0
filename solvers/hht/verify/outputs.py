"""``hhtbench verify outputs``: rows at output times and events satisfy both constraint levels, as steps do.

For all problems on their validated spans, at tolerances from 1e-2 to 1e-6: the violation at rows, at ends of steps and of
the interpolant, and the change of the error by projecting the rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hhtbench import list_problems, load_problem
from hhtbench.campaign.reference.plan import registered_plans, validated_spec
from hhtbench.lowering import derive
from hhtbench.protocol.arguments import Matrix
from hhtbench.protocol.events import Event
from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.protocol.problem import Problem
from solvers.hht.solver import HHT
from solvers.hht.verify.control import MAX_SECONDS, TOLERANCES
from solvers.hht.verify.measure import FLOOR, guesses, known_motion, solved, typical_sizes, violations, weighted_error
from solvers.hht.verify.study import Progress, judged_row, shown_row, verify

MAX_VIOLATION = 1e-12  # scaled, of either level
MAX_GROWTH = 0.01  # relative growth of an error by projection
ROWS = 101  # in addition to the times at which the motion is known
MAX_CHECKED = 200  # ends of steps that are checked


class Output(NamedTuple):
    """Largest scaled violations of either level in one run, and the effect of projection on the error."""

    rows: float  #: largest violation at rows between steps, and at events
    steps: float  #: at the ends of steps, which are not projected
    interpolated: float  #: largest violation of the dense output at the same times
    growth: float | None  #: relative change of the error by projecting rows; None where it is roundoff


def output(problem: Problem, tolerance: float) -> Output:
    """Solve ``problem`` at ``rtol`` = ``tolerance`` with rows at the known times and between, and with an event."""
    times, known = known_motion(problem)
    asked = np.union1d(times, np.linspace(*problem.t_span, ROWS))
    hht = HHT(problem.system, events=[_passes(problem, known)])
    atol = tolerance * typical_sizes(problem)
    request = {"rtol": tolerance, "atol": atol, "max_seconds": MAX_SECONDS, **guesses(problem)}
    start = problem.t_span, problem.q0, problem.v0
    found = solved(problem.name, hht, *start, t_eval=asked, **request)
    steps = found if found.interpolant is not None else solved(problem.name, hht, *start, **request)  # they were too many
    ends: Any = steps.interpolant
    some = np.unique(np.linspace(0, ends.t.size - 1, MAX_CHECKED).astype(int))
    between = ~np.isin(asked, ends.t)
    plain, at = steps(asked), np.searchsorted(asked, times)
    errors = [weighted_error(problem, np.hstack([x.q[at], x.v[at]]), known) for x in (plain, found)]
    rows = violations(problem, found.t[between], found.q[between], found.v[between])
    events = violations(problem, found.t_events[0], found.q_events[0], found.v_events[0])
    return Output(
        rows=max(*rows, *events),
        steps=max(violations(problem, ends.t[some], ends.q[some], ends.v[some])),
        interpolated=max(violations(problem, asked, plain.q, plain.v)),
        growth=errors[1] / errors[0] - 1.0 if errors[0] > FLOOR else None,
    )


def _passes(problem: Problem, known: Matrix) -> Event:
    """Event where the coordinate with the largest range passes the middle of it."""
    n = problem.q0.size
    low, high = known[:, :n].min(axis=0), known[:, :n].max(axis=0)
    most = int(np.argmax((high - low) / np.broadcast_to(problem.scales.q, n)))
    middle = float(0.5 * (low[most] + high[most]))
    return Event(lambda t, q, v: q[most] - middle, name="middle")


def outputs(spec: str, tolerances: Sequence[float] = TOLERANCES) -> list[Row]:
    """Rows for one problem: the violations, and the growth of the error."""
    problem = load_problem(spec)
    if not derive(problem.system, problem.t_span[0], problem.q0, problem.v0).structure.constrained:
        return [shown_row(f"levels/{spec}", f"{spec}: constraints at rows and events", "it has none")]
    found = [output(problem, tolerance) for tolerance in tolerances]
    between, ends, plain, growth = zip(*found, strict=True)
    asked = f"rtol {tolerances[0]:g} .. {tolerances[-1]:g}"
    held = f"{spec}: largest scaled violation of both levels at rows between steps and events, {asked}"
    moved = f"{spec}: change of the largest error by moving rows onto the constraints, {asked}"
    measured = f"{_listed(between)}; at ends of steps {_listed(ends)}; interpolated {_listed(plain)}"
    changes = ", ".join("roundoff" if x is None else f"{x:+.2%}" for x in growth)
    small = all(x is None or x <= MAX_GROWTH for x in growth)
    return [
        judged_row(f"levels/{spec}", held, measured, f"< {MAX_VIOLATION:g}", max(between) < MAX_VIOLATION),
        judged_row(f"error/{spec}", moved, changes, f"<= {MAX_GROWTH:.0%}", small),
    ]


def _listed(sizes: Sequence[float]) -> str:
    return ", ".join(f"{size:.0e}" for size in sizes)


def verify_outputs(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Evidence on constraints and errors of rows between steps and at events, for all problems and tolerances."""
    plan = registered_plans()
    studies: list[Any] = [(outputs, validated_spec(name, plan)) for name in list_problems()]
    return verify("Rows and events between steps on the constraints", studies, progress, jobs)
