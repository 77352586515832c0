"""Positions at rest against statics: closed forms and a few lines of NumPy."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import fsolve

import hhtbench as hb

G = 9.81  # m/s^2


class Rods(hb.System):
    """Point masses of ``mass`` [kg] between two supports at (0, 0) and (span, 0), on rods of ``length`` [m] without mass."""

    mass: object = hb.parameter(doc="(k,) [kg]")
    span: object = hb.parameter(4.0, doc="[m]")
    length: object = hb.parameter(1.0, doc="[m]")

    @property
    def mass_matrix(self):
        return jnp.repeat(self.mass, 2)

    def force(self, t, q, v):
        return jnp.stack([0 * self.mass, -G * self.mass], axis=1).ravel()

    def constraint(self, t, q):
        x = jnp.concatenate([jnp.zeros((1, 2)), q.reshape(-1, 2), jnp.stack([self.span, 0.0])[None]])
        return (jnp.sum((x[1:] - x[:-1]) ** 2, axis=1) - self.length**2) / 2


def hanging(masses, span=4.0):
    """Positions (k, 2) [m] and tensions (k + 1,) [N] of the same by statics: one horizontal force in all rods."""

    def slopes(unknown):  # rods as vectors; the vertical force falls by a weight at each mass
        force = np.stack(
            [np.full(masses.size + 1, unknown[0]), unknown[1] + G * np.concatenate([[0], np.cumsum(masses)])], 1
        )
        size = np.linalg.norm(force, axis=1)
        return force / size[:, None], size

    found = fsolve(lambda x: slopes(x)[0].sum(axis=0) - [span, 0], [10.0, -G * masses.sum() / 2], xtol=1e-14)
    rods, tension = slopes(found)
    return np.cumsum(rods, axis=0)[:-1], tension


def rods_problem(masses, system=None):
    across = np.linspace(0, 4, masses.size + 2)[1:-1]
    start = np.stack([across, -0.3 * np.ones(masses.size)], axis=1).ravel()  # the rods do not fit: Newton has to close them
    system = Rods(mass=masses) if system is None else system
    return hb.Problem(name="rods", system=system, t_span=(0, 1), q0=start, v0=0 * start)


def test_a_chain_of_rods_hangs_as_statics_says():
    masses = np.array([1.0, 2.0, 0.5, 4.0, 1.0])
    found, (expected, tension) = hb.equilibrium(rods_problem(masses)), hanging(masses)
    np.testing.assert_allclose(found.q.reshape(-1, 2), expected, atol=1e-11)
    np.testing.assert_allclose(found.lam, tension, rtol=1e-10)  # lam l is the tension
    assert found.stable
    assert found.residual < 1e-9


def test_plain_callables_hang_alike():
    """Derivatives by differences: 1e-9 of the constraint's, so that the position is right to 1e-8."""
    masses = np.array([1.0, 2.0, 0.5, 4.0, 1.0])
    jax_system = Rods(mass=masses)

    def lengths(t, q):
        x = np.concatenate([[[0, 0]], q.reshape(-1, 2), [[4.0, 0.0]]])
        return (np.sum((x[1:] - x[:-1]) ** 2, axis=1) - 1) / 2

    weight = np.asarray(jax_system.force(0.0, np.zeros(10), np.zeros(10)))
    system = hb.NumpySystem(force=lambda t, q, v: weight, mass_matrix=np.repeat(masses, 2), constraint=lengths)
    found = hb.equilibrium(rods_problem(masses, system))
    np.testing.assert_allclose(found.q.reshape(-1, 2), hanging(masses)[0], atol=1e-8)
    frequencies = [hb.modes(rods_problem(masses, one)).frequencies for one in (system, jax_system)]
    np.testing.assert_allclose(*frequencies, rtol=1e-6)
    assert found.stable


class Pendulum(hb.System):
    """A mass of 1 kg on a rod of 2 m, q = (x, y)."""

    def force(self, t, q, v):
        return jnp.array([0.0, -G])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 4.0) / 2])


@pytest.mark.parametrize("q0", [(2.0, 0.0), (1e-6, 2.0), (0.3, 3.0)])
def test_a_pendulum_falls_to_where_it_hangs(q0):
    """From the level, from near the top, and from off the rod."""
    found = hb.equilibrium(hb.Problem(name="pendulum", system=Pendulum(), t_span=(0, 1), q0=q0, v0=(0, 0)))
    np.testing.assert_allclose(found.q, [0.0, -2.0], atol=1e-12)
    np.testing.assert_allclose(found.lam, G / 2)
    assert found.stable


def test_an_equilibrium_that_is_given_is_kept_and_called_unstable():
    problem = hb.Problem(name="pendulum", system=Pendulum(), t_span=(0, 1), q0=(0, -2), v0=(0, 0))
    found = hb.equilibrium(problem, q=(0.0, 2.0))
    np.testing.assert_array_equal(found.q, [0.0, 2.0])
    assert not found.stable
    assert found.iterations == 0


def test_redundant_rows_share_the_load_by_least_norm():
    """``redundant_pendulum`` holds its rod twice, once doubled: shares 1 and 2 of a load of 5."""
    problem = hb.load_problem("redundant_pendulum")
    found = hb.equilibrium(problem)
    rows = np.asarray(problem.system.constraint(0.0, jnp.asarray(found.q)))
    np.testing.assert_allclose(rows, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.lam[1], 2 * found.lam[0])
    np.testing.assert_allclose(found.lam @ [1, 2], G, rtol=1e-12)


class Ball(hb.System):
    """A ball of 3 kg above a floor with the contact force k depth^1.5."""

    mass_matrix = 3.0

    def force(self, t, q, v):
        depth = jnp.maximum(-q, 0.0)
        return 1e4 * jnp.where(depth > 0, jnp.where(depth > 0, depth, 1.0) ** 1.5, 0.0) - 3 * G - 5 * v


def test_a_ball_without_stiffness_falls_onto_the_floor():
    found = hb.equilibrium(hb.Problem(name="ball", system=Ball(), t_span=(0, 1), q0=[2.0], v0=[0.0]))
    np.testing.assert_allclose(found.q, -((3 * G / 1e4) ** (2 / 3)), rtol=1e-11)


class Falling(hb.System):
    """A body that nothing holds."""

    def force(self, t, q, v):
        return -G + 0 * q


def test_what_has_no_equilibrium_says_so():
    with pytest.raises(hb.ProblemError, match=r"^stone: no equilibrium found .* a force of 9\.81 .* nothing holds"):
        hb.equilibrium(hb.Problem(name="stone", system=Falling(), t_span=(0, 1), q0=[1.0], v0=[0.0]))
    with pytest.raises(hb.ProblemError, match=r"constraint row 0 has g_t = -0\.5 at t = 0 s, so it moves parts by time"):
        hb.equilibrium(hb.load_problem("car_axis"))
    with pytest.raises(hb.ProblemError, match=r"^q must have shape \(2,\)"):
        hb.equilibrium(hb.load_problem("simple_pendulum"), q=[1.0])
    with pytest.raises(TypeError, match="expected a Problem; got str"):
        hb.equilibrium("simple_pendulum")


class Broken(hb.System):
    """A force that is not finite below zero, and a second coordinate without mass or stiffness."""

    mass_matrix = jnp.array([1.0, 0.0])

    def force(self, t, q, v):
        return jnp.stack([jnp.sqrt(q[0]) - 0.1, 0 * q[1]])


def test_forces_that_are_not_finite_and_parts_without_mass_are_named():
    broken = hb.Problem(name="broken", system=Broken(), t_span=(0, 1), q0=[-1.0, 0.0], v0=[0.0, 0.0])
    with pytest.raises(hb.ProblemError, match=r"^broken: a force or a reaction is not finite at q = \[-1\.  0\.\]"):
        hb.equilibrium(broken)
    with pytest.raises(hb.ProblemError, match=r"^broken: the mass is singular along a direction"):
        hb.modes(broken, ([0.01, 0.0], [0.0, 0.0]))
    plain = hb.NumpySystem(force=lambda t, q, v: np.array([np.nan]))
    with pytest.raises(hb.ProblemError, match=r"^plain: force\[0\] = nan at t = 0; nothing can be linearised there"):
        hb.equilibrium(hb.Problem(name="plain", system=plain, t_span=(0, 1), q0=[1.0], v0=[0.0]))
