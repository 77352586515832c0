"""Constraints whose rows have units far apart: a row is met however small it is beside the others."""

import numpy as np
import pytest

from hhtbench import NumpySystem
from solvers.hht import HHT


def blade_beside_rods(length):
    """Two points on rods in any unit of ``length``, the second of which moves along a blade; a start, and k_v of q."""
    across = np.array([[0.0, 2.0], [-2.0, 0.0]]) / length

    def row(q):
        return np.concatenate([np.zeros(2), np.array([0.3, 0.7]) + across @ q[:2]])

    def rods(q):
        return np.stack([np.concatenate([q[:2], np.zeros(2)]), np.concatenate([q[:2] - q[2:], q[2:] - q[:2]])])

    q0 = length * np.array([0.5, -1.1, 0.1, -0.3])
    held = np.stack([*rods(q0) / length, row(q0)])
    v0 = length * (np.eye(4) - np.linalg.pinv(held) @ held) @ np.array([-2.0, 0.6, -0.2, -0.3])
    system = NumpySystem(
        force=lambda t, q, v: length * np.array([3.0, -9.0, 3.0, -9.0]),
        constraint=lambda t, q: rods(q) @ q - rods(q0) @ q0,
        constraint_jacobian=lambda t, q: 2.0 * rods(q),
        constraint_acceleration=lambda t, q, v: 2.0 * rods(v) @ v,
        velocity_constraint=lambda t, q, v: row(q)[None] @ v,
        velocity_constraint_jacobian=lambda t, q, v: row(q)[None],
    )
    return system, q0, v0, row


@pytest.mark.parametrize("kind", ["dense", "band", "sparse"])
@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_rows_of_any_unit_are_held_alike(kind, engine):
    """LU of unscaled rows leaves 1e-4 of the blade's, SuperLU all of it: short steps ask for long increments."""
    system, q0, v0, row = blade_beside_rods(1e30)
    solution = HHT(system, alpha=-0.3, linsolver=kind, engine=engine).solve((0.0, 4e-13), q0, v0, steps=4)
    assert solution.success, solution.message
    for q, v in zip(solution.q, solution.v, strict=True):
        assert abs(row(q) @ v) <= 1e-13 * (np.abs(row(q)) @ np.abs(v))
