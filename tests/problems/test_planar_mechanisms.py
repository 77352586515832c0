"""Planar scenes put together by names against the equations of the same bodies written by hand."""

import importlib

import numpy as np
import pytest

import hhtbench as hb
from tests.problems.cases import CHANGED
from tests.problems.mechanics import Mechanics, compiled, consistent_state
from tests.problems.planar_by_hand import SCENES
from tests.sample import slow

scenes = pytest.mark.parametrize(("name", "parameters"), [(name, x) for name in SCENES for x in ({}, CHANGED[name])])


def held(system, t, q, v):
    """Accelerations, and what the joints exert on the bodies."""
    known = Mechanics(compiled(system))
    vdot, lam, mu = known.accelerations(t, q, v)
    return vdot, known.reaction(t, q, v, lam, mu)


@scenes
def test_bodies_move_and_are_held_as_in_equations_by_hand(make, name, parameters):
    """Accelerations and reactions at random states to 1e-10 of the largest."""
    problem = make(name, **parameters)
    both = problem.system, SCENES[name](**parameters)
    for seed in range(2):
        state = consistent_state(problem, Mechanics(compiled(problem.system)), seed)
        for found, expected in zip(*(held(one, *state) for one in both), strict=True):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("name", [x if x == "four_bars" else slow(x) for x in SCENES])
def test_motion_is_that_of_the_equations_by_hand(make, name):
    """Positions and velocities after 50 steps of HHT over 0.05 s, to 1e-10 of their scales."""
    problem = make(name)
    written = hb.Problem(name="written", system=SCENES[name](), t_span=problem.t_span, q0=problem.q0, v0=problem.v0)
    found, expected = (hb.solve(one, "hht", t_span=(0.0, 0.05), steps=50) for one in (problem, written))
    np.testing.assert_allclose((found.q[-1] - expected.q[-1]) / problem.scales.q, 0.0, rtol=0, atol=1e-10)
    np.testing.assert_allclose((found.v[-1] - expected.v[-1]) / problem.scales.v, 0.0, rtol=0, atol=1e-10)


def mechanism_of(name, **parameters):
    return importlib.import_module(f"problems.{name}").mechanism(**parameters)


def test_forces_of_joints_by_name_move_a_coupler_as_newton_says(make):
    m, solution = mechanism_of("four_bars"), hb.solve(make("four_bars"), "hht", t_span=(0.0, 0.5), rtol=1e-6)
    total = sum(m.of(solution, name).force(on="coupler 1") for name in ("left 1", "right 1")) + np.array([0.0, -9.81])
    np.testing.assert_allclose(total, m.of(solution, "coupler 1").acceleration(), atol=1e-12 * np.abs(total).max())
    np.testing.assert_allclose(m.of(solution, "O0").force(on="crank 0"), -solution.lam[:, :2], atol=1e-12)


def test_a_bushing_by_name_is_stretched_as_is_observed(make):
    problem = make("bushing_chain")
    m, solution = mechanism_of("bushing_chain"), hb.solve(problem, "hht", t_span=(0.0, 0.05), steps=20)
    apart = np.linalg.norm(m.of(solution, "bushing 1").measure()[-1, :2])
    assert apart > 1e-8
    np.testing.assert_allclose(problem.observables["stretch"](0.05, solution.q[-1], None, None), apart, rtol=1e-6)


def test_flats_push_the_cam_by_name_as_is_observed_and_its_motor_gives_the_power(make):
    problem = make("cam_follower")
    m, solution = mechanism_of("cam_follower"), hb.solve(problem, "hht", t_span=(0.0, 0.05), rtol=1e-5)
    pushes = np.stack([m.of(solution, flat).tension() for flat in ("upper", "lower")], axis=1)
    seen = [problem.observables["push"](t, q, v, None) for t, q, v in zip(solution.t, solution.q, solution.v, strict=True)]
    assert np.max(seen) > 50.0
    np.testing.assert_allclose(-pushes, seen, rtol=1e-12)
    np.testing.assert_allclose(m.of(solution, "drive").power(), -40.0 * solution.lam[:, 4], rtol=1e-6)
    np.testing.assert_allclose(m.of(solution, "bearing").angle(), 40.0 * solution.t, atol=1e-12)


@pytest.mark.long
def test_the_largest_push_on_the_wheels_by_name_is_the_one_that_is_observed(make):
    problem = make("band_track", n_wrap=3, n_free=1)
    m, solution = mechanism_of("band_track", n_wrap=3, n_free=1), hb.solve(problem, "hht", t_span=(0.0, 0.05), steps=50)
    last = 0.05, solution.q[-1], solution.v[-1], solution.lam[-1]
    pushes = [-m.of(solution, f"shoe {i}, {wheel}").tension()[-1] for i in range(8) for wheel in ("driven", "braked")]
    np.testing.assert_allclose(max(pushes), problem.observables["largest_push"](*last), rtol=1e-12)
    np.testing.assert_allclose(m.of(solution, "brake").tension()[-1], 5.0 * problem.observables["wheel_speeds"](*last)[1])
