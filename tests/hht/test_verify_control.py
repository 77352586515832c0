"""``hhtbench verify control``: its judgement, from runs made by hand, and one real run."""

import numpy as np
import pytest

from hhtbench.protocol import NumpySystem
from hhtbench.result import Status
from solvers.hht import HHT
from solvers.hht.verify import control
from solvers.hht.verify.chrono import chrono_steps
from solvers.hht.verify.control import TOLERANCES, ControlledRun
from tests.hht.scenes import JAX_PENDULUM, Q0, V0, pendulum_at


def made(spec, factors, status="success", rejected=0):
    errors = [None if f is None else f * tolerance for f, tolerance in zip(factors, TOLERANCES, strict=True)]
    return [
        ControlledRun(spec, tolerance, error, status, accepted=100, rejected=rejected, evaluations=500)
        for tolerance, error in zip(TOLERANCES, errors, strict=True)
    ]


def verdicts(controlled):
    return {row.id: row.passed for row in control.judged(controlled)}


def test_errors_that_follow_the_tolerance_hold_whatever_their_constant():
    found = verdicts({"a": made("a", [40, 40, 40, 40, 40]), "b": made("b", [0.1, 0.2, 0.1, 0.2, 0.1])})
    assert found["ratio/all"]
    assert found["slope/a"]
    assert found["slope/b"]
    assert found["rejected/all"]
    assert found["ratio/a"] is None, "shown, not judged"


def test_errors_that_stay_behind_the_tolerance_fail():
    behind = made("a", [1, 10, 100, 1_000, 10_000])  # the error does not fall at all
    found = verdicts({"a": behind})
    assert found["slope/a"] is False
    assert found["ratio/all"] is False


def test_failed_runs_count_against_the_share_and_rejections_against_theirs():
    found = verdicts({"a": made("a", [1, 1, 1, 1, None], rejected=30)})
    assert found["ratio/all"] is False, "four of five are below nine of ten"
    assert found["rejected/all"] is False
    assert verdicts({"a": made("a", [1, 1, 1, 1, 1e-9])})["ratio/all"], "roundoff is as good as it gets"


def test_the_plot_has_a_curve_for_every_problem_with_errors():
    plot = control.drawn([made("a", [1, 2, 3, 4, 5]), made("b", [None] * 5)])
    assert [curve.label for curve in plot.curves] == ["a"]
    assert plot.slope == 1.0


def test_a_run_measures_error_steps_and_rejections():
    run = control.run("jay_negrut_pendulum", 1e-3, -0.05)
    assert run.status == "success"
    assert 1e-4 < run.error < 1e-2
    assert run.accepted > 50
    assert run.evaluations > run.accepted
    row = control.compared(control.run("jay_negrut_pendulum", 1e-3, -0.05, "chrono"), run)
    assert "error control" in row.measured
    assert row.passed is None


@pytest.mark.parametrize(("error", "passed"), [(5e-3, True), (5.0, False), (None, False)])
def test_stiff_springs_must_keep_the_error_near_the_tolerance(error, passed):
    own = ControlledRun("s", 1e-3, error, "deadline" if error is None else "success", 80, 5, 400)
    assert control.stiff_row([own]).passed is passed


def test_chronos_rule_doubles_after_five_easy_steps_and_looks_at_no_error():
    hht = HHT(JAX_PENDULUM)
    hht.init_step(0.0, Q0, V0, step=1e-4)
    h = np.array([hht.state.h for _ in chrono_steps(hht, 1e-4, 1.0)])
    assert hht.state.t == 1.0
    assert h[:12] == pytest.approx([1e-4] * 5 + [2e-4] * 5 + [4e-4] * 2)
    assert h.max() > 0.02
    q, v = pendulum_at(1.0)
    assert max(np.abs(hht.state.q - q).max(), np.abs(hht.state.v - v).max()) > 1e-4


@pytest.mark.parametrize(
    ("h", "alone", "first"), [(0.4, Status.success, 0.2), (0.6, Status.newton_failed, 0.15)], ids=["hard", "failed"]
)
def test_chronos_rule_halves_where_newton_needs_many_iterations_or_fails(h, alone, first):
    hht = HHT(JAX_PENDULUM)
    hht.init_step(0.0, Q0, V0, step=h)
    begun = hht.state
    assert hht.step(tstop=10.0) is alone
    assert hht.counters.newton_iterations > 6
    hht.restart(begun, step=h)
    assert next(chrono_steps(hht, h, 10.0)) is Status.success
    assert hht.state.h == pytest.approx(first)


def test_chronos_rule_halves_until_times_end_where_no_step_is_left():
    """The force has a value up to 0.5 s only: steps shrink towards it, and the last says why there is none."""
    ends = NumpySystem(force=lambda t, q, v: np.array([1.0 if t < 0.5 else np.nan]))
    hht = HHT(ends)
    hht.init_step(0.0, [0.0], [0.0], step=0.1)
    *taken, last = [(status, hht.state.t) for status in chrono_steps(hht, 0.1, 1.0)]
    assert {status for status, _ in taken} == {Status.success}
    assert last[0] is Status.time_resolution
    assert 0.5 - 1e-12 < last[1] < 0.5
