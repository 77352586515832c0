"""The flyball governor against its four degrees of freedom."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.problems.mechanics import compiled


@jax.jit
def governor_from_angles(z):
    """Coordinates (28,) of the governor from z = (s, shaft angle, arm angles); centre of an arm at 5.15/5.3 m."""
    s, phi, *alphas = z
    bodies = [[0.0, 0.0, 0.5, jnp.cos(phi / 2), 0.0, 0.0, jnp.sin(phi / 2)]]
    bodies.append([0.0, 0.0, s, *bodies[0][3:]])
    for alpha, turn in zip(alphas, (0.0, jnp.pi), strict=True):
        reach, half = 0.05 + 5.15 / 5.3 * jnp.cos(alpha), (phi + turn) / 2
        c, d = jnp.cos(alpha / 2), jnp.sin(alpha / 2)
        x = [reach * jnp.cos(phi + turn), reach * jnp.sin(phi + turn), 1.0 - 5.15 / 5.3 * jnp.sin(alpha)]
        bodies.append([*x, c * jnp.cos(half), -d * jnp.sin(half), d * jnp.cos(half), c * jnp.sin(half)])
    return jnp.array(bodies).ravel()


@jax.jit
def reduced_acceleration(z, zdot):
    """z'' of the governor's four angles and heights by Lagrange's equations, written without quaternions."""

    def lengths(z):
        mid = jnp.stack([0.5 * jnp.cos(z[2:]), 1.0 - 0.5 * jnp.sin(z[2:]) - z[0]])  # the offsets 0.05 of both ends cancel
        return jnp.sqrt(jnp.sum(mid**2, axis=0))

    def lagrangian(z, zdot):
        a, adot, turn = z[2:], zdot[2:], zdot[1]
        thin = 0.3 * 0.01**2 / 12  # across a rod; points of it and the ball at distance u from the hinge:
        across = 0.3 * (0.05**2 + 0.05 * jnp.cos(a) + jnp.cos(a) ** 2 / 3) + 5.0 * (0.05 + jnp.cos(a)) ** 2
        spin = jnp.sum(across + thin * (1 + jnp.sin(a) ** 2)) + 0.3 * 0.01**2 / 6 + 3.0 * 0.1**2 / 6
        kinetic = 3.0 * zdot[0] ** 2 / 2 + spin * turn**2 / 2 + jnp.sum((0.1 + 5.0 + thin) * adot**2) / 2
        height = 3.0 * z[0] - jnp.sum((0.15 + 5.0) * jnp.sin(a))
        return kinetic - 9.81 * height - jnp.sum(8e5 * (lengths(z) - 0.5) ** 2) / 2

    rate, back = jax.jvp(lengths, (z,), (zdot,))[1], jax.vjp(lengths, z)[1]
    momentum_rate = jax.jvp(lambda x: jax.grad(lagrangian, 1)(x, zdot), (z,), (zdot,))[1]
    force = jax.grad(lagrangian)(z, zdot) - back(4e4 * rate)[0] - momentum_rate
    return jnp.linalg.solve(jax.hessian(lagrangian, 1)(z, zdot), force)


def test_governor_moves_as_its_four_degrees_of_freedom(make, mechanics):
    problem, random = make("flyball_governor"), np.random.default_rng(7)
    start = np.array([0.5, 0.0, np.pi / 6, np.pi / 6])
    np.testing.assert_allclose(governor_from_angles(start), problem.q0, atol=1e-15)
    for z, zdot in [(start, np.array([0, 2 * np.pi, 0, 0])), (start + 0.3 * random.random(4), random.standard_normal(4))]:
        q, v = jax.jvp(governor_from_angles, (z,), (zdot,))
        second = reduced_acceleration(z, zdot)
        along = lambda s, z=z, zdot=zdot, a=second: governor_from_angles(z + s * zdot + s**2 * a / 2)  # noqa: E731
        expected = jax.jvp(lambda s, f=along: jax.jvp(f, (s,), (1.0,))[1], (0.0,), (1.0,))[1]
        vdot, _, _ = mechanics(compiled(problem.system)).accelerations(0.0, np.asarray(q), np.asarray(v), redundant=True)
        np.testing.assert_allclose(vdot, expected, rtol=0, atol=1e-10 * np.abs(expected).max())


def test_governor_is_as_stiff_as_the_source_says():
    """-8117, -1450, -20.3, -20.1, +-7.35i at the start (IFToMM library, A05)."""
    start = np.array([0.5, 0.0, np.pi / 6, np.pi / 6, 0.0, 2 * np.pi, 0.0, 0.0])
    motion = jax.jit(jax.jacfwd(lambda y: jnp.concatenate([y[4:], reduced_acceleration(y[:4], y[4:])])))
    values = np.linalg.eigvals(np.asarray(motion(start)))
    for stated in (-8117, -1450, -20.3, -20.1, 7.35j, -7.35j):
        assert np.min(np.abs(values - stated)) < 1e-2 * abs(stated)


def test_governor_reports_height_angles_and_rate_of_any_state(make):
    """Against the minimal coordinates of a moved state; the shaft's angle without whole turns."""
    problem = make("flyball_governor")
    z, zdot = np.array([0.4, 8.0, 0.3, 0.7]), np.array([1.0, -2.0, 0.5, 0.1])
    q, v = map(np.asarray, jax.jvp(governor_from_angles, (z,), (zdot,)))
    found = {name: observable(0.0, q, v, np.zeros(24)) for name, observable in problem.observables.items()}
    expected = {"slider_height": 0.4, "arm_angle": 0.3, "shaft_angle": 8.0 - 2 * np.pi, "shaft_rate": -2.0}
    assert found == pytest.approx(expected, abs=1e-14)
