"""``solve(..., accuracy=...)``: the error that was asked for, an estimate of it, or the word that it cannot be told."""

from __future__ import annotations

import json
import pickle
import re
from dataclasses import replace
from itertools import pairwise

import jax.numpy as jnp
import numpy as np
import pytest
from click.testing import CliRunner

import hhtbench as hb
from hhtbench.checks.accuracy import MOST_RUNS
from hhtbench.cli.main import main
from hhtbench.solution.result import Status
from tests.sample import slow

SOLVERS = ["hht", "ida(form=ggl)", "cvode", "scipy(method=Radau)", "projected", "generalised_alpha", "rattle"]


def true_errors(problem, found):
    """Largest scaled error at every row, of q and of v."""
    rows = [problem.exact(float(t)) for t in found.t]
    return [
        np.max(np.abs(getattr(found, name) - np.array([getattr(row, name) for row in rows])), axis=1)
        / getattr(problem.scales, name)
        for name in ("q", "v")
    ]


@pytest.fixture(scope="module")
def pendulum():
    return hb.load_problem("simple_pendulum(t_end=3)")  # its motion is known in elliptic functions


@pytest.fixture
def spring():
    """Without constraints, which would give away who is wrong."""

    def exact(t):
        return hb.Motion(np.array([np.cos(t)]), np.array([-np.sin(t)]), np.zeros(0), np.zeros(0))

    system = hb.NumpySystem(force=lambda t, q, v: -q)
    scales = hb.Scales(q=1.0, v=1.0)
    return hb.Problem(name="spring", system=system, t_span=(0.0, 3.0), q0=[1.0], v0=[0.0], exact=exact, scales=scales)


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("accuracy", [1e-2, 1e-4])
def test_the_true_error_is_below_what_was_asked_and_below_its_bound(pendulum, solver, accuracy):
    found = hb.solve(pendulum, solver, accuracy=accuracy)
    assert found.status is Status.success, found.message
    error = max(map(np.max, true_errors(pendulum, found)))
    assert error <= accuracy
    assert error <= 2 * found.error.bound  # an estimate, of solvers whose errors are no smooth function of their tolerance
    assert 1e-3 * accuracy < found.error.bound <= accuracy  # work is not wasted on what nobody asked for
    assert f"{found.error.bound:.2g}" in found.message


def test_every_row_has_an_estimate_of_the_size_of_its_error(pendulum):
    found = hb.solve(pendulum, "hht", accuracy=1e-4)
    assert [x.shape for x in (found.error.q, found.error.v, found.error.lam)] == [found.t.shape] * 3
    for estimate, error in zip((found.error.q, found.error.v), true_errors(pendulum, found), strict=True):
        large = error > 0.5 * error.max()  # where an error passes through zero, so may an estimate at another place
        assert np.all(estimate[large] > 0.8 * error[large])
        assert np.all(estimate[large] < 4 * error[large])
    assert max(found.error.q.max(), found.error.v.max()) == pytest.approx(found.error.bound)


def test_the_extrapolated_answer_is_better_and_on_the_constraints(pendulum):
    found = hb.solve(pendulum, "hht", accuracy=1e-4)
    better = replace(found, q=found.extrapolated.q, v=found.extrapolated.v)
    ours, theirs = (max(map(np.max, true_errors(pendulum, x))) for x in (better, found))
    assert ours < 0.5 * theirs
    assert np.max(np.abs(np.hypot(*better.q.T) - 1.0)) < 1e-14
    assert np.max(np.abs(np.sum(better.q * better.v, axis=1))) < 1e-13
    assert (
        hb.solve(pendulum, "ida", accuracy=1e-2).extrapolated is None
    )  # its errors are no smooth function of its tolerance


def test_no_better_answer_is_offered_where_an_event_changed_the_state():
    wall = hb.Event(lambda t, q, v: q[0] - 0.3, direction=1, change=lambda t, q, v: (q, -0.8 * v), name="wall")
    found = hb.solve(
        "simple_pendulum", accuracy=1e-3, events=[wall], t_span=(0.0, 3.0), q0=[-0.6, -0.8], v0=[0.0, 0.0], t_eval=[0.5, 3.0]
    )
    assert found.success, found.message
    assert found.t_events[0].size
    assert found.extrapolated is None


def test_the_cost_is_that_of_all_runs(pendulum):
    found = hb.solve(pendulum, "hht", accuracy=1e-3)
    singles = [hb.solve(pendulum, "hht", rtol=rtol, t_eval=found.t) for rtol in found.error.settings]
    assert found.counters.residual_evaluations == sum(run.counters.residual_evaluations for run in singles)
    assert found.counters.provenance.startswith(f"sum of {len(singles)} runs")
    np.testing.assert_array_equal(found.q, singles[-1].q)
    apart = [np.max(np.abs(a.q - b.q)) for a, b in pairwise(singles)]
    assert all(difference >= x for difference, x in zip(found.error.differences, apart, strict=True))


class Off:
    """The motion to roundoff, and at its end ``by(rtol)`` beside it."""

    name = "off"

    def __init__(self, by):
        self.by = by

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        found = hb.load_solver("scipy(method=DOP853)").solve(problem, replace(request, rtol=1e-12))
        return replace(found, q=found.q + self.by(request.rtol) * found.t[:, None] / 3)


def noisy(seed):
    noise = np.random.default_rng(seed)
    return Off(lambda rtol: 1e-3 * noise.standard_normal())


def test_a_solver_whose_runs_do_not_contract_is_not_believed(spring):
    found = hb.solve(spring, noisy(1), accuracy=1e-4)
    assert found.status is Status.accuracy_not_shown
    assert found.error.bound is None
    assert np.isnan(found.error.q).all()
    assert "differ by 0.00" in found.message
    assert len(found.error.settings) <= MOST_RUNS


@pytest.mark.parametrize("seeds", [20, slow(40)])
def test_noise_is_seldom_taken_for_convergence(spring, seeds):
    claims = [hb.solve(spring, noisy(seed), accuracy=1e-4).success for seed in range(seeds)]
    assert sum(claims) <= seeds / 5  # ten times what was asked, and three or four runs to see it by


def test_two_runs_that_agree_by_chance_are_not_believed(spring):
    found = hb.solve(spring, Off(lambda rtol: 3e-4 if rtol < 2e-4 else rtol), accuracy=1e-5)
    assert not (found.success and np.max(true_errors(spring, found)) > 3e-5)


def test_one_run_made_again_and_again_tells_nothing(pendulum):
    class Deaf:
        name = "deaf"

        def accepts(self, problem, request):
            return None

        def solve(self, problem, request):
            return hb.load_solver("hht").solve(problem, replace(request, rtol=1e-2))

    assert hb.solve(pendulum, Deaf(), accuracy=1e-4).status is Status.accuracy_not_shown


def test_a_motion_that_every_step_finds_exactly_is_believed():
    system = hb.NumpySystem(force=lambda t, q, v: np.array([-2.0]))  # a quadratic in time
    fall = hb.Problem(name="fall", system=system, t_span=(0.0, 1.0), q0=[1.0], v0=[0.0], scales=hb.Scales(q=1.5))
    for solver in ("rattle", "hht", "projected"):
        found = hb.solve(fall, solver, accuracy=1e-6)
        assert found.success, found.message
        assert found.q[-1, 0] == pytest.approx(0.0, abs=1e-12)
        assert len(found.error.settings) == 3


class Pushed(hb.System):
    """A pendulum that is pushed at t = 5.03 s for about twice ``width`` [s]."""

    width: float = hb.parameter(0.3)

    def force(self, t, q, v):
        return jnp.stack([5.0 * jnp.exp(-(((t - 5.03) / self.width) ** 2)), -9.81])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0])


def pushed(width, t_end=10.0):
    """It hangs at rest until then."""
    return hb.Problem(name="pushed", system=Pushed(width=width), t_span=(0.0, t_end), q0=[0.0, -1.0], v0=[0.0, 0.0])


@pytest.mark.parametrize(
    ("solver", "width"),
    [("hht", 0.3), ("hht", 0.1), ("ida", 0.1), ("cvode(method=adams)", 0.3), ("scipy(method=DOP853)", 0.01)],
)
def test_a_push_that_every_run_steps_over_is_not_promised_away(solver, width):
    found = hb.solve(pushed(width), solver, accuracy=1e-2)
    if solver == "hht":  # its steps can be bounded
        true = hb.solve(pushed(width), "hht(max_step=0.01)", rtol=1e-5, t_eval=found.t)
        assert found.success, found.message
        assert max(np.max(np.abs(found.q - true.q)), np.max(np.abs(found.v - true.v))) <= 1e-2
    else:
        assert found.status is Status.accuracy_not_shown
        assert re.search(r"at t = [45]\.\d+ the acceleration of q\[0\] is", found.message)


def test_what_was_looked_at_between_rows_is_counted():
    found = hb.solve(pushed(0.1), "cvode(method=adams)", accuracy=1e-2)
    looks = int(re.search(r"3 runs and of (\d+) accelerations between their rows", found.counters.provenance)[1])
    assert 200 <= looks < 500
    singles = [hb.solve(pushed(0.1), "cvode(method=adams)", rtol=r, t_eval=found.t) for r in found.error.settings]
    assert found.counters.residual_evaluations == looks + sum(run.counters.residual_evaluations for run in singles)


def test_a_push_is_looked_for_where_the_end_alone_is_asked_for():
    found = hb.solve(pushed(0.3), "cvode(method=adams)", accuracy=1e-2, t_eval=[10.0])
    assert found.status is Status.accuracy_not_shown
    assert found.ends is None


@pytest.mark.parametrize("solver", ["hht", "ida", "cvode(method=adams)", "rattle"])
def test_rest_is_believed(solver):
    found = hb.solve(pushed(0.1, t_end=2.0), solver, accuracy=1e-6)
    assert found.success, found.message
    assert found.error.bound <= 1e-12
    np.testing.assert_allclose(found.q, np.broadcast_to([0.0, -1.0], found.q.shape), atol=1e-12)


def test_the_start_alone_is_known_at_once(pendulum):
    found = hb.solve(pendulum, "hht", accuracy=1e-4, t_eval=[0.0])
    assert found.success
    assert len(found.error.settings) == 3


@pytest.mark.parametrize("accuracy", [1e-9, 1e-12, 1e-13])
def test_beyond_the_tightest_tolerance_of_a_solver_it_is_told_how_far_runs_are_apart(pendulum, accuracy):
    found = hb.solve(pendulum, "hht", accuracy=accuracy)
    assert found.status is Status.accuracy_not_shown
    assert re.search(r"Runs at rtol \S+ and rtol \S+ differ by \d\S*e-\d\d of the scales", found.message)
    assert found.error.bound is None
    assert 0 < found.error.differences[-1] < 1e-4
    assert len(found.t) == 101


def test_the_bound_of_a_solver_from_elsewhere_holds_if_it_solves_the_problem(spring):
    assert "if the solver solves this problem" in hb.solve(spring, Off(lambda rtol: rtol), accuracy=1e-3).message
    assert "if the solver" not in hb.solve(spring, "hht", accuracy=1e-3).message


def test_what_was_known_when_a_budget_was_spent_is_told(pendulum):
    whole = hb.solve(pendulum, "hht", accuracy=1e-4)
    budget = whole.counters.residual_evaluations - 100
    found = hb.solve(pendulum, "hht", accuracy=1e-4, max_evaluations=budget)
    assert found.status is Status.evaluation_budget
    assert "An error of 0.0001 is not shown" in found.message
    assert found.counters.residual_evaluations <= budget
    assert found.error.settings == whole.error.settings[:-1]
    assert found.error.bound is None


def test_a_solver_that_fails_says_how():
    system = hb.NumpySystem(force=lambda t, q, v: np.array([np.nan]))
    broken = hb.Problem(name="broken", system=system, t_span=(0.0, 1.0), q0=[0.0], v0=[0.0])
    assert hb.solve(broken, "hht", accuracy=1e-3).status is Status.nonfinite_callback
    declined = hb.solve("jay_negrut_test1", "cvode", accuracy=1e-3)
    assert declined.status is Status.declined
    assert "linear" in declined.message
    declined = hb.solve("chaplygin_sleigh", "rattle", accuracy=1e-3)
    assert declined.message == "rattle takes position constraints only"


def test_a_problem_without_scales_is_told_so():
    system = hb.NumpySystem(force=lambda t, q, v: -q)
    spring = hb.Problem(name="spring", system=system, t_span=(0.0, 1.0), q0=[1.0], v0=[0.0])
    assert "declares no scales" in hb.solve(spring, "hht", accuracy=1e-3).message
    scaled = replace(spring, scales=hb.Scales(q=2.0))
    assert "declares no scales" not in hb.solve(scaled, "hht", accuracy=1e-3).message


@pytest.mark.parametrize(
    ("request_", "text"),
    [
        ({"accuracy": 1e-16}, "accuracy must lie between 1e-13"),
        ({"accuracy": 2.0}, "accuracy must lie between"),
        ({"accuracy": float("nan")}, "accuracy"),
        ({"accuracy": 1e-3, "rtol": 1e-3}, "accuracy excludes rtol"),
        ({"accuracy": 1e-3, "steps": 10}, "accuracy excludes"),
    ],
)
def test_what_cannot_be_asked_for_is_refused(pendulum, request_, text):
    with pytest.raises(hb.ProblemError, match=text):
        hb.solve(pendulum, "hht", **request_)


def test_a_solution_with_its_estimate_is_pickled(pendulum):
    found = hb.solve(pendulum, "hht", accuracy=1e-2)
    again = pickle.loads(pickle.dumps(found))
    assert again.error.bound == found.error.bound


def test_a_terminal_event_leaves_the_error_unshown():
    stops = hb.Event(lambda t, q, v: t - 0.5, terminal=True)
    solution = hb.solve("simple_pendulum", accuracy=1e-3, events=[stops])
    assert solution.status is hb.Status.accuracy_not_shown
    assert "a terminal event ended the run" in solution.message
    assert abs(solution.t[-1] - 0.5) < 1e-6
    assert solution.error is None


def test_the_command_writes_the_estimate_and_the_known_error_at_the_end(tmp_path):
    file = tmp_path / "s.json"
    result = CliRunner().invoke(main, ["solve", "simple_pendulum(t_end=1)", "--accuracy", "1e-2", "--json", str(file)])
    assert result.exit_code == 0, result.output
    told = json.loads(file.read_text())
    assert told["error"]["asked"] == 1e-2
    assert f"at most {told['error']['bound']:.2g}" in told["message"]
    assert len(told["error"]["q"]) == len(told["error"]["lam"]) == len(told["extrapolated"]["q"]) == len(told["t"])
    assert len(told["error"]["settings"]) == len(told["error"]["differences"]) + 1
    assert told["at_end"]["against"] == "exact solution"
    for name in ("q", "v", "lam"):
        assert f"{told['at_end'][name]['largest']:.3e}" in result.output
    CliRunner().invoke(main, ["solve", "kapitza_pendulum", "--steps", "10", "--json", str(file)])
    assert json.loads(file.read_text())["error"] is None
