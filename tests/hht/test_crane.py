"""README's crane, which starts at rest in equilibrium and is pushed then, against Lagrange's equations."""

from __future__ import annotations

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from solvers.hht import HHT

MASS, LOAD, ROPE, GRAVITY = 20.0, 5.0, 4.0, 9.81
ALPHA, END = -0.05, 10.0
Q0 = np.array([0.0, 0.0, -ROPE])


class Crane(hb.System):
    """A trolley on a rail, pushed to and fro, with a load on a rope: q = (trolley x, load x, load y)."""

    def mass_matrix(self, t, q):
        return jnp.diag(jnp.array([MASS, LOAD, LOAD]))

    def force(self, t, q, v):
        return jnp.stack([50.0 * jnp.sin(t) - 10.0 * v[0], 0.0, -GRAVITY * LOAD])

    def constraint(self, t, q):
        return jnp.stack([((q[1] - q[0]) ** 2 + q[2] ** 2 - ROPE**2) / 2])


def solved(**request):
    solution = HHT(Crane(), alpha=ALPHA).solve((0.0, END), Q0, np.zeros(3), **request)
    assert solution.success
    return solution


@cache
def exact():
    """q at the end, from Lagrange's equations of the trolley's place and the rope's angle."""

    def rate(t, y):
        _, angle, u, w = y
        sin, cos = np.sin(angle), np.cos(angle)
        matrix = [[MASS + LOAD, LOAD * ROPE * cos], [cos, ROPE]]
        force = [50 * np.sin(t) - 10 * u + LOAD * ROPE * w**2 * sin, -GRAVITY * sin]
        return [u, w, *np.linalg.solve(matrix, force)]

    x, angle = solve_ivp(rate, (0.0, END), np.zeros(4), "DOP853", rtol=1e-12, atol=1e-12).y[:2, -1]
    return np.array([x, x + ROPE * np.sin(angle), -ROPE * np.cos(angle)])


def test_the_error_falls_with_the_square_of_the_step_and_is_7_5_mm_at_a_tenth_of_a_second():
    errors = [abs(solved(step=h).q[-1] - exact()).max() for h in (0.1, 0.05, 0.025)]
    assert errors[0] == pytest.approx(7.5e-3, rel=0.02)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.05)
    assert np.log2(errors[1] / errors[2]) == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("rtol", [1e-2, 1e-3, 1e-4])
def test_the_error_under_error_control_is_proportional_to_the_tolerance(rtol):
    """3.6 times it at 1e-2, 4.3 and 4.4 times it below."""
    assert abs(solved(rtol=rtol, atol=rtol).q[-1] - exact()).max() == pytest.approx(4.0 * rtol, rel=0.12)
