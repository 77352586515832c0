"""Scenes put together by names against the equations of the same bodies written by hand."""

import importlib

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.mechanics.multibody.frames import Space
from tests.problems.by_hand import SCENES
from tests.problems.cases import CHANGED, RANKS
from tests.problems.mechanics import Mechanics, compiled, consistent_state
from tests.sample import slow

scenes = pytest.mark.parametrize(("name", "parameters"), [(name, x) for name in SCENES for x in ({}, CHANGED[name])])


def held(problem, system, t, q, v):
    """Accelerations, and, of a scene with joints, all their forces and torques on the bodies."""
    known = Mechanics(compiled(system))
    vdot, lam, mu = known.accelerations(t, q, v, redundant="redundant" in problem.tags)
    joints = Space.forces_of(q, known.reaction(t, q, v, lam, mu)) if problem.system.joints else ()
    return vdot, *map(np.asarray, joints)


@scenes
def test_bodies_move_and_are_held_as_in_equations_by_hand(make, name, parameters):
    """Accelerations, forces and torques at random states to 1e-10 of the largest."""
    problem = make(name, **parameters)
    for seed in range(2):
        state = consistent_state(problem, Mechanics(compiled(problem.system)), seed, RANKS.get(name))
        by_names, by_hand = (held(problem, one, *state) for one in (problem.system, SCENES[name](**parameters)))
        for found, expected in zip(by_names, by_hand, strict=True):
            np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


@pytest.mark.parametrize("name", SCENES)
def test_motion_is_that_of_the_equations_by_hand(make, name):
    """Positions over 0.05 s at a tolerance of 1e-12, to 1e-10; velocities to 1e-10 of their scales."""
    problem = make(name)
    start = {"t_span": (0.0, 0.05), "q0": problem.q0, "v0": problem.v0}
    written = hb.Problem(name="written", system=SCENES[name](), scales=problem.scales, **start)
    found, expected = (hb.solve(one, "projected", rtol=1e-12, **start) for one in (problem, written))
    np.testing.assert_allclose(found.q[-1], expected.q[-1], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.v[-1] / problem.scales.v, expected.v[-1] / problem.scales.v, rtol=0, atol=1e-10)


@pytest.mark.parametrize(
    ("name", "further"),
    [*((x, {}) for x in SCENES if x != "ball_mill"), ("rolling_disk3d_steady", {"j0": 0.0}), slow("heavy_top", {"j0": 0.0})],
)
def test_forces_of_joints_on_the_bodies_are_read_by_name(make, name, further):
    """Their sums at the rows of a solution of the problem against the equations by hand, to 1e-10 of the largest."""
    parameters = CHANGED[name]
    problem, m = make(name, **parameters, **further), importlib.import_module(f"problems.{name}").mechanism(**parameters)
    solution = hb.solve(
        problem, "projected", rtol=1e-8, t_span=(0.0, 0.01), q0=problem.q0, v0=problem.v0, t_eval=[0.0, 0.01]
    )
    written, states = SCENES[name](**parameters), zip(solution.t, solution.q, solution.v, strict=True)
    expected = np.array([held(problem, written, *state)[1] for state in states])
    for i, body in enumerate(m.bodies):
        joints = [joint for joint, made in m.joints.items() if body in (made.first, made.second)]
        found = sum(m.of(solution, joint).force(on=body) for joint in joints)
        np.testing.assert_allclose(found, expected[:, i], rtol=0, atol=1e-10 * np.abs(expected).max())
