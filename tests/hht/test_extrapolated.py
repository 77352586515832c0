"""Extrapolated multipliers, (H55): vibrations that constraint forces carry are damped, and all else stays as it is."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.conformance.scenes.linkages import DoublePendulum, double_pendulum_angles
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers.hht import HHT
from solvers.hht.equations.coefficients import Coefficients
from tests.hht.event_scenes import impacts, wall
from tests.hht.scenes import JAX_PENDULUM, Q0, V0, pendulum, pendulum_at, tension_at
from tests.sample import slow

ON = {"extrapolate_reaction": True}
MIDDLES = np.concatenate([[0.0], np.arange(0.5, 400.0) / 400.0])  # of 400 steps in a second; the motion begins at 0
STRAIGHT = DoublePendulum.straight(0.5)


def rods(ratio, **options):
    return HHT(DoublePendulum(ratio=ratio), **{**ON, **options})


@pytest.mark.parametrize(("alpha", "left"), [(-0.05, 0.1), (-0.3, 1e-4)])
@pytest.mark.parametrize("pattern", [(1.0,), (1.0, 2.0)], ids=["equal steps", "steps 1:2"])
def test_vibrations_in_steps_far_too_long_are_damped_on_equal_and_on_changing_steps(alpha, left, pattern):
    """A small swing on a rod of 1 m under the gravity omega^2, 200 steps with h omega from 2.1 to 200; b = 1 keeps it."""
    steps, faint = np.resize(pattern, 200) * 0.01, 1e-6

    def end(product, **options):
        system = pendulum(force=lambda t, q, v: np.array([0.0, -((product / 0.01) ** 2)]))
        start = [np.sin(faint), -np.cos(faint)], [0.0, 0.0]
        solution = HHT(system, alpha=alpha, **options).solve((0.0, steps.sum()), *start, steps=steps)
        return np.abs(solution.q[-10:, 0]).max() / faint

    assert max(end(product, **ON) for product in (2.1, 5.0, 20.0, 200.0)) < left
    assert end(5.0, b=1.0) > 0.5


@pytest.mark.parametrize(
    ("ratio", "options", "still"),
    [
        (1e8, {"alpha": -0.1, **ON}, True),
        (1e8, {"alpha": -0.3, "b": 1.0, **ON}, True),
        (1e4, {"alpha": -0.3}, False),
    ],
)
def test_prescribed_steps_leave_no_vibration_where_alpha_is_enough(ratio, options, still):
    """Rods let go straight, 4 s in steps of 0.04 s and 0.01 s: the speed at which they bend, where the motion has 3 m/s."""
    bent = []
    for h in (0.04, 0.01):
        v = HHT(DoublePendulum(ratio=ratio), **options).solve((0.0, 4.0), *STRAIGHT, step=h).v[-1]
        bent.append(np.abs(v[:2] - v[2:] / 2.0).max())
    assert bool(max(bent) < 1e-3) is still


@pytest.mark.parametrize("ratio", [1e6, 1e8])
def test_a_light_body_on_a_taut_rod_costs_no_steps(ratio):
    """Masses 1e6 apart: 34 steps, where b = 0 takes 20,000 and b = 1 3,000; against DOP853 on 1e4, whose motion is that."""
    solution = rods(ratio).solve((0.0, 1.0), *STRAIGHT, rtol=1e-3)
    exact, _ = DoublePendulum.bent(*double_pendulum_angles(0.5, 1e4, 1.0))
    assert solution.success
    assert solution.counters.steps_accepted < 100
    assert np.max(np.abs(solution.q[-1] - exact)) < 5e-3


@pytest.mark.parametrize(
    ("system", "options"),
    [
        *((JAX_PENDULUM, options) for options in ({}, {"reaction": "midpoint"})),
        *((pendulum(), options) for options in ({"b": 1.0}, {"reaction": "predictor"})),
    ],
)
def test_rows_and_stages_have_whole_multipliers(system, options):
    """Those of rows are of the acceleration level, the mean of the stages belongs to the middle of the step."""
    solution = HHT(system, **ON, **options).solve((0.0, 1.0), Q0, V0, steps=400)
    exact, _ = pendulum_at(np.linspace(0.0, 1.0, 401))
    assert np.max(np.abs(solution.q - exact)) < 4e-5
    assert np.max(np.abs(solution.lam[:, 0] - tension_at(solution.q, solution.v))) < 1e-11
    data, middle = solution.steps_data, tension_at(*pendulum_at(MIDDLES))[1:]
    stage = data.lam_end if "midpoint" in options.values() else (data.lam_start + data.lam_end) / 2.0
    assert np.max(np.abs(stage[:, 0] - middle)) < 1e-3


@pytest.mark.parametrize("short", [1e-4, 2e-7, 1e-10])
def test_multipliers_of_steps_far_shorter_than_the_next_disturb_nothing(short):
    """Their rate is that of a jump, and those of 1e-10 s are roundoff over h^2: 20,000 N."""

    def error(steps):
        solution = HHT(JAX_PENDULUM, **ON).solve((0.0, steps.sum()), Q0, V0, steps=steps)
        exact, _ = pendulum_at([0.0, steps.sum()])
        return np.max(np.abs(solution.q[-1] - exact[-1]))

    assert error(np.array([0.02] * 20 + [short] * 3 + [0.02] * 20)) < 1.1 * error(np.full(40, 0.02))


def test_a_blow_begins_with_the_multipliers_after_it():
    """The pendulum comes back from a wall with 0.7 of its speed, and half of its tension: times by its angle's equation."""
    solution = HHT(pendulum(), events=wall(), **ON).solve((0.0, 2.0), Q0, V0, rtol=1e-6)
    times, _ = impacts(3)
    assert solution.success
    np.testing.assert_allclose(solution.t_events[0], times[times < 2.0], atol=2e-5)


@pytest.mark.parametrize("name", ["redundant_pendulum", "andrews", "driven_coordinate", "slider_crank_flexible"])
def test_problems_of_every_kind_move_as_without_it(name):
    """Redundant rows, a mass that varies, a coordinate that is driven, full masses."""
    problem = hb.load_problem(name)
    end = problem.t_span[0] + 0.1 * (problem.t_span[1] - problem.t_span[0])
    found, wanted = (
        hb.solve(problem, hb.load_solver("hht", **options), rtol=1e-5, t_span=(problem.t_span[0], end))
        for options in (ON, {})
    )
    assert found.success
    assert np.max(np.abs(found.q[-1] - wanted.q[-1]) / problem.scales.q) < 1e-3


def test_what_it_does_not_take_is_refused_by_name():
    with pytest.raises(ProblemError, match=r"needs an alpha of -0\.02"):
        rods(1.0, alpha=-0.01)
    for spec, part in (("knife_edge", "velocity_constraint"), ("jay_negrut_test1", "reaction")):
        problem, solver = hb.load_problem(spec), hb.load_solver("hht", **ON)
        with pytest.raises(ProblemError, match=f"declares {part}"):
            HHT(problem.system, **ON)
        assert part in solver.accepts(problem, Request(rtol=1e-4))


@pytest.mark.filterwarnings("ignore:b = ")
@pytest.mark.parametrize(("edge", "alpha"), [(0, -0.1), (1, -1 / 3), slow(0, -1 / 3), slow(1, -0.1)])
def test_b_between_which_multipliers_grow_by_themselves_is_refused_and_no_other(edge, alpha, monkeypatch):
    """A tenth of the interval beside either edge: within 3,000 steps roundoff grows to the motion's size, or not at all."""
    given, edges = ((0.0, 3.0), Q0, V0), Coefficients(alpha=alpha, b=0.0).unstable_b
    aside = 0.1 * (edges[1] - edges[0])
    outside, inside = (edges[edge] + sign * (1 - 2 * edge) * aside for sign in (-1.0, 1.0))
    right = HHT(pendulum(), alpha=alpha, b=outside, **ON).solve(*given, steps=3_000)
    assert right.success
    with pytest.raises(ProblemError, match=r"needs b below .* or above .*; got b = .* Take b = 0, or 1"):
        HHT(pendulum(), alpha=alpha, b=inside, **ON)
    monkeypatch.setattr(Coefficients, "unstable_b", (1.0, 0.0))
    wrong = HHT(pendulum(), alpha=alpha, b=inside, **ON).solve(*given, steps=3_000)
    assert not wrong.success or np.abs(wrong.v[-1] - right.v[-1]).max() > np.abs(right.v).max()


def test_a_mass_whose_inverse_fills_is_refused_with_the_options_that_take_it():
    bar = hb.load_problem("clamped_bar_impact(n_elements=250)")
    with pytest.raises(ProblemError, match='Take b = 1, or without="zeros"'):
        HHT(bar.system, **ON).solve((0.0, 1e-6), bar.q0, bar.v0, steps=2)
    assert HHT(bar.system, without="zeros", **ON).solve((0.0, 1e-6), bar.q0, bar.v0, steps=2).success
    declined = hb.solve(bar, hb.load_solver("hht", **ON), steps=2)
    assert declined.status is Status.declined
    assert 'Take b = 1, or without="zeros"' in declined.message
    assert declined.t.size == 0
