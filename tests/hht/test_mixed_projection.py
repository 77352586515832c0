"""Velocity constraints hold no position: large systems with constraints of both kinds are moved as small ones are."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb


class Circles(hb.System):
    """Points on circles whose height is z = sin t, which a velocity constraint says together with what holds already."""

    share: object = hb.parameter(0.1)

    def force(self, t, q, v):
        return jnp.zeros_like(q.reshape(-1, 3)).at[:, 1].set(-9.81).ravel()

    def constraint(self, t, q):
        x = q.reshape(-1, 3)
        return x[:, 0] ** 2 + x[:, 1] ** 2 - 1

    def velocity_constraint(self, t, q, v):
        x, u = q.reshape(-1, 3), v.reshape(-1, 3)
        return x[:, 0] * u[:, 0] + x[:, 1] * u[:, 1] + self.share * (u[:, 2] - jnp.cos(t))


@pytest.mark.parametrize("count", [2, 9])
def test_heights_of_few_and_of_many_points_are_as_right(count):
    angle = np.linspace(0.3, 1.0, count)
    q0 = np.column_stack([np.sin(angle), -np.cos(angle), 0 * angle]).ravel()
    v0 = np.tile([0.0, 0.0, 1.0], count)
    circles = hb.Problem(name="circles", system=Circles(), t_span=(0.0, 2.0), q0=q0, v0=v0)
    found = hb.solve(circles, "projected", rtol=1e-3, t_eval=np.linspace(0.0, 2.0, 21))
    assert found.success
    np.testing.assert_allclose(found.q[:, 2::3], np.sin(found.t)[:, None] * np.ones(count), atol=1e-9)


def test_a_pattern_that_holds_at_the_start_alone_is_refused():
    def force(t, q, v):
        return -q + np.roll(q * (q - 1.0), 1)  # no coupling has a slope of zero but where q is a half

    q0, n = np.full(4, 0.5), 4
    system = hb.NumpySystem(
        force=force, sparsity={"force_q": np.eye(n, dtype=bool), "force_v": np.zeros((n, n), dtype=bool)}
    )
    frozen = hb.Problem(name="frozen", system=system, t_span=(0.0, 1.0), q0=q0, v0=np.zeros(n))
    with pytest.raises(hb.ProblemError, match="sparsity\\['force_q'\\] lacks entries"):
        hb.solve(frozen, "hht", steps=10)
