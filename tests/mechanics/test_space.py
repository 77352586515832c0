"""Bodies and joints in space take lists of bodies, points and masses, as those in the plane do."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.mechanics import space

Q = jnp.array([0.3, -0.2, 0.7, 0.5, 0.5, -0.1, 0.7, 1.1, 0.4, -1.3, 0.9, 0.1, 0.3, -0.3])
V = jnp.sin(jnp.arange(14.0))
FIRST, SECOND = [0, 1], [-1, 0]
A, B = [[1.0, 0.0, 0.2], [0.0, -1.0, 0.0]], [[0.0, 0.0, 0.3], [0.5, 0.0, 0.0]]
ACROSS, AXIS = [[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]] * 2, [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]
M, J, J0, GRAVITY = [2.0, 3.0], [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]], [1.0, 1.5], [0.0, 0.0, -9.81]


@pytest.mark.parametrize(
    ("function", "lists"),
    [
        (space.points_on, (FIRST, A)),
        (space.spherical_rows, (FIRST, SECOND, A, B)),
        (space.perpendicular_rows, (FIRST, SECOND, ACROSS, AXIS)),
        (space.revolute_rows, (FIRST, SECOND, A, B, ACROSS, AXIS)),
    ],
)
def test_joints_take_lists_of_bodies_and_of_points(function, lists):
    at = space.placed_with_ground(Q)
    np.testing.assert_array_equal(function(at, *lists), function(at, *map(np.array, lists)))


@pytest.mark.parametrize(
    ("function", "state", "lists"),
    [
        (space.mass_of_bodies, (Q,), (M, J, J0)),
        (space.force_on_bodies, (Q, V), (M, J, GRAVITY)),
        (space.energy_of_bodies, (Q, V), (M, J, GRAVITY)),
        (space.moment_of_momentum, (Q, V), (M, J)),
    ],
)
def test_bodies_take_lists_of_masses_and_moments(function, state, lists):
    np.testing.assert_array_equal(function(*state, *lists), function(*state, *map(np.array, lists)))
