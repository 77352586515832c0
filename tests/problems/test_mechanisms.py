"""Scenes put together by names against the equations of the same bodies written by hand."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.mechanics.multibody.frames import Space
from tests.problems.by_hand import SCENES
from tests.problems.cases import CHANGED, RANKS
from tests.problems.mechanics import Mechanics, compiled, consistent_state

scenes = pytest.mark.parametrize(("name", "parameters"), [(name, x) for name in SCENES for x in ({}, CHANGED[name])])


def held(problem, system, t, q, v):
    """Accelerations, and forces and torques of all joints on the bodies."""
    known = Mechanics(compiled(system))
    vdot, lam, mu = known.accelerations(t, q, v, redundant="redundant" in problem.tags)
    return vdot, *map(np.asarray, Space.forces_of(q, known.reaction(t, q, v, lam, mu)))


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
    """Positions over 0.05 s at a tolerance of 1e-11, to 1e-10; velocities to 1e-10 of their scales."""
    problem = make(name)
    start = {"t_span": (0.0, 0.05), "q0": problem.q0, "v0": problem.v0}
    written = hb.Problem(name="written", system=SCENES[name](), scales=problem.scales, **start)
    found, expected = (hb.solve(one, "projected", rtol=1e-11, **start) for one in (problem, written))
    np.testing.assert_allclose(found.q[-1], expected.q[-1], rtol=0, atol=1e-10)
    np.testing.assert_allclose(found.v[-1] / problem.scales.v, expected.v[-1] / problem.scales.v, rtol=0, atol=1e-10)
