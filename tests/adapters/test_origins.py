"""Far from the origin of time every solver ends right, or says that times do not resolve the motion."""

from dataclasses import replace

import numpy as np
import pytest

from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from hhtbench.solution.times import unresolved
from tests.adapters.scenes import EVERY, TSIT5, errors, problem
from tests.performance.time_origins import SOLVERS, rows

UNIX = 2.0**30  # [s]: times are 2.4e-7 s apart
QUICK = [name for name in SOLVERS if name != "hht(reaction=midpoint)"]


@pytest.mark.parametrize("solver", QUICK)
def test_no_success_is_further_off_than_its_tolerance_and_its_times_allow(solver):
    """The figure of ``python -m tests.performance.time_origins`` at one tolerance."""
    found = {row.t0: row for row in rows((solver,), (1e-6,))}
    assert not [row for row in found.values() if row.broken]
    assert {row.status for row in found.values()} <= {"success", "time_resolution"}
    for t0 in (1e3, 1e6, 1e9):
        assert found[t0].status == "success", "at such times every solver can work"
        assert found[t0].error == pytest.approx(found[0.0].error, rel=0.2, abs=1e-9)


@EVERY
def test_a_library_makes_the_same_steps_from_every_origin(solver):
    """Its clock starts at 0; only the times of the rows are rounded, and none comes twice."""
    near, far = (solver.solve(replace(problem(), t_span=(t0, t0 + 1.0)), Request(rtol=1e-6)) for t0 in (0.0, UNIX))
    assert near.success
    assert far.success, far.message
    assert near.counters.steps_accepted == far.counters.steps_accepted
    assert near.counters.residual_evaluations == far.counters.residual_evaluations
    assert np.all(np.diff(far.t) > 0)
    assert far.t[-1] == UNIX + 1.0
    assert np.array_equal(near.q[-1], far.q[-1])


@EVERY
@pytest.mark.parametrize("span", [(1.0, 2.0), (2.0, 1.0)])
def test_forces_and_rows_are_in_the_time_of_the_problem(solver, span):
    """The circle grows with the problem's time, not with the library's."""
    times = np.linspace(*span, 5)
    solution = solver.solve(problem("rheonomic", t_span=span), Request(rtol=1e-8, t_eval=times))
    assert solution.success
    assert np.array_equal(solution.t, times)
    assert max(errors(solution, problem("rheonomic").exact)[:2]) < 1e-5


def test_a_library_that_makes_more_steps_than_there_are_times_is_refused():
    solution = TSIT5.solve(replace(problem(), t_span=(1e15, 1e15 + 1.0)), Request(rtol=1e-9))
    assert solution.status is Status.time_resolution
    assert "more than there are times" in solution.message
    assert "shift the time origin" in solution.message


@pytest.mark.parametrize(
    ("span", "steps", "elapsed", "resolved"),
    [
        ((0.0, 1.0), 10_000, None, True),
        ((0.0, 1.0), 10_000, 1.0, True),
        ((0.0, 1.0), 10_000, 1.0 + 1e-5, False),  # a clock that loses time
        ((1e9, 1e9 + 1.0), 1000, 1.0, True),
        ((1e9, 1e9 + 1.0), 1000, None, False),  # half a spacing a step is 6e-5 s
        ((1e9 + 1.0, 1e9), 1000, -1.0, True),
        ((1e15, 1e15 + 2.0), 1, None, False),  # SUNDIALS takes the end as reached at once
        ((1e15, 1e15 + 2.0), 16, 2.0, True),
        ((1e15, 1e15 + 2.0), 20, 2.0, False),
        ((1.0, 1.0), 0, None, True),
        ((1.0, np.nextafter(1.0, 0.0)), 1, -np.spacing(0.5), True),
    ],
)
def test_times_resolve_steps_whose_lengths_add_up_to_the_interval(span, steps, elapsed, resolved):
    assert (unresolved(span, steps, 1e-6, elapsed) == "") is resolved
