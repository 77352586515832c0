"""Cables against closed solutions (catenary, string, bar, cantilever), splines of SciPy, and what no frame may change."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from hhtbench.mechanics import cables, forces
from tests.lowering.xla import values
from tests.sample import slow

both = pytest.mark.parametrize("d", [2, 3])
LENGTH, MASS = 0.3, 1.7  # of an element [m], of a metre [kg]


def straight(n, d, whole, stretch=1.0):
    """Nodes (n + 1, 2, d) of a straight cable along x."""
    nodes = np.zeros((n + 1, 2, d))
    nodes[:, 0, 0], nodes[:, 1, 0] = np.linspace(0.0, stretch * whole, n + 1), stretch
    return nodes


def bent(d, n=3):
    """Nodes (n + 1, 2, d) of a cable bent and stretched at random."""
    return straight(n, d, n * LENGTH) + 0.15 * np.random.default_rng(4).standard_normal((n + 1, 2, d))


def law(EA, EI, c, length, d):
    return forces.spring_damper(cables.section(EA, EI, length, d), cables.section(c, 0.0, length, d), 0.0)


def force(q, v, d, length, EA=50.0, EI=0.4, c=0.0):
    return forces.force_of(lambda q: cables.strains(q.reshape(-1, 2, d), length), law(EA, EI, c, length, d), q, v)


def turned(nodes, d):
    """The same nodes in a turned frame, and the rotation (d, d)."""
    frame = (
        Rotation.from_rotvec([0.4, -1.1, 0.7]).as_matrix() if d == 3 else Rotation.from_euler("z", 0.9).as_matrix()[:2, :2]
    )
    return nodes @ frame.T, frame


@both
def test_positions_slopes_and_strains_are_those_of_a_cubic_spline(d):
    nodes, at = bent(d), np.array([0.0, 0.3, 1.0])
    spline = CubicHermiteSpline(LENGTH * np.arange(4), nodes[:, 0], nodes[:, 1])
    parts = [lambda q, i=i: cables.derivative_at(q, LENGTH, at, i) for i in range(3)]
    *found, strains = values([*parts, lambda q: cables.strains(q, LENGTH)], nodes)
    for order, value in enumerate(found):
        np.testing.assert_allclose(value[1, 1], spline(1.3 * LENGTH, order), rtol=1e-12)
    x = LENGTH * (1 + (1 + 1 / np.sqrt(3)) / 2)  # the second point of Gauss in the second element
    slope, bend = np.pad(spline(x, 1), (0, 3 - d)), np.pad(spline(x, 2), (0, 3 - d))
    curvature = np.linalg.norm(np.cross(slope, bend)) / (slope @ slope)
    np.testing.assert_allclose(np.linalg.norm(strains[1, -d:]), curvature, rtol=1e-12)
    np.testing.assert_allclose(
        strains[1, :3], np.linalg.norm(spline(LENGTH * np.array([1, 1.5, 2]), 1), axis=1) - 1, rtol=1e-12
    )


@both
def test_strains_vanish_in_a_turned_straight_cable_and_force_turns_with_the_frame(d):
    moved, frame = turned(straight(3, d, 3 * LENGTH), d)
    parts = lambda q: cables.strains(q, LENGTH), lambda q, v: force(q, v, d, LENGTH, c=3.0)
    moved[:, 0] += 5.0
    np.testing.assert_allclose(values([parts[0]], moved)[0], 0.0, atol=2e-13)  # 8 eps of 5 m over (0.3 m)^2
    nodes, rates = bent(d), np.random.default_rng(5).standard_normal((4, 2, d))
    (here,) = values([parts[1]], nodes.ravel(), rates.ravel())
    (there,) = values([parts[1]], (nodes @ frame.T).ravel(), (rates @ frame.T).ravel())
    np.testing.assert_allclose(there.reshape(-1, d), here.reshape(-1, d) @ frame.T, atol=1e-12 * np.abs(here).max())


@both
def test_force_of_the_strains_is_minus_the_gradient_of_their_energy(d):
    section = cables.section(50.0, 0.4, LENGTH, d)

    def energy(q):
        return jnp.sum(section * cables.strains(q.reshape(-1, 2, d), LENGTH) ** 2) / 2

    q, e = bent(d).ravel(), 1e-5
    (found,) = values([lambda q: force(q, 0 * q, d, LENGTH)], q)
    shifted = q + np.concatenate([e * np.eye(q.size), -e * np.eye(q.size)])
    (energies,) = values([jax.vmap(energy)], shifted)
    slope = (energies[: q.size] - energies[q.size :]) / (2 * e)
    np.testing.assert_allclose(found, -slope, atol=1e-8 * np.abs(found).max())  # e^2 and eps / e, each about 1e-10


@both
def test_forces_of_elements_have_neither_sum_nor_moment_and_dampers_take_energy(d):
    q, v = bent(d).ravel(), np.random.default_rng(6).standard_normal(8 * d)
    inner, damper = values(
        [lambda q, v: force(q, v, d, LENGTH, c=3.0), lambda q, v: force(q, v, d, LENGTH, EA=0.0, EI=0.0, c=3.0)], q, v
    )
    size = np.abs(inner).sum()
    for axis in np.eye(d):
        assert abs(cables.uniform(3, axis) @ inner) < 1e-13 * size
    parts, arms = (np.pad(x.reshape(-1, d), ((0, 0), (0, 3 - d))) for x in (inner, q))
    assert np.abs(np.cross(arms, parts).sum(axis=0)).max() < 1e-13 * size
    assert damper @ v < -1e-3
    spin = np.zeros((d, d))
    spin[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    (rigid,) = values([lambda q, v: force(q, v, d, LENGTH, EA=0.0, EI=0.0, c=3.0)], q, (q.reshape(-1, d) @ spin.T).ravel())
    np.testing.assert_allclose(rigid, 0.0, atol=1e-14)


@both
def test_mass_matrix_gives_the_kinetic_energy_of_the_spline_and_the_weight(d):
    rates = np.random.default_rng(7).standard_normal((4, 2, d))
    mass = np.asarray(cables.mass_matrix(3, d, MASS, LENGTH))
    speed = CubicHermiteSpline(LENGTH * np.arange(4), rates[:, 0], rates[:, 1])
    x, w = np.polynomial.legendre.leggauss(6)
    points = LENGTH * (np.arange(3)[:, None] + (x + 1) / 2)
    energy = MASS / 2 * np.sum(w * LENGTH / 2 * np.sum(speed(points) ** 2, axis=-1))
    np.testing.assert_allclose(rates.ravel() @ mass @ rates.ravel() / 2, energy, rtol=1e-13)
    up = np.asarray(cables.uniform(3, np.eye(d)[1]))
    np.testing.assert_allclose(up @ mass @ up, MASS * 3 * LENGTH, rtol=1e-13)


def frequencies(d, n, stretch, free, axis, EA, EI):
    """Lowest two frequencies [rad/s] along ``axis`` of a straight cable of 1 m with the nodal values ``free`` (2 n + 2,)."""
    q = straight(n, d, 1.0, stretch).ravel()
    (slope,) = values([jax.jacfwd(lambda q: force(q, 0 * q, d, 1.0 / n, EA, EI))], q)
    mass = np.asarray(cables.mass_matrix(n, d, MASS, 1.0 / n))
    rows = d * free + axis
    return np.sqrt(eigh(-slope[np.ix_(rows, rows)], mass[np.ix_(rows, rows)], eigvals_only=True))[:2]


CANTILEVER = np.array([1.87510406871196, 4.69409113297418])  # roots of cos(x) cosh(x) = -1
MODES = {  # stretch, clamped nodal values, axis, EA, EI, exact
    "cantilever": (1.0, [0, 1], 1, 1e4, 2.0, CANTILEVER**2 * np.sqrt(2.0 / MASS)),
    "string": (1.1, [0, -2], 1, 100.0, 0.0, np.array([1, 2]) * np.pi * np.sqrt(100 * 0.1 / 1.1 / MASS)),
    "bar": (1.0, [0], 0, 100.0, 0.0, np.array([1, 3]) * np.pi / 2 * np.sqrt(100 / MASS)),
}


@pytest.mark.parametrize(("kind", "d"), [slow("cantilever", 2), ("cantilever", 3), ("string", 3), ("bar", 2)])
def test_frequencies_of_cantilever_string_and_bar_converge_with_order_four(kind, d):
    """Closed: Euler's cantilever; a string of tension N and mass per stretched length; a bar fixed at one end."""
    stretch, held, axis, EA, EI, exact = MODES[kind]
    errors = []
    for n in (8, 16):
        free = np.delete(np.arange(2 * n + 2), held)
        errors.append(frequencies(d, n, stretch, free, axis, EA, EI) / exact - 1)
    assert np.all(np.abs(errors[1]) < [1e-6, 2e-5])
    np.testing.assert_allclose(np.log2(errors[0] / errors[1]), 4.0, atol=0.15)


def catenary(n, EA, H=2.0, V=-3.0, weight=5.0):
    """Nodes (n + 1, 2, 2) of an elastic cable of 1 m under its weight per length, tension (H, V) at its start.

    M. Irvine, Cable Structures, MIT Press 1981, section 1.4.
    """
    s = np.linspace(0.0, 1.0, n + 1)
    up = V + weight * s
    tension = np.hypot(H, up)
    x = H * s / EA + H / weight * (np.arcsinh(up / H) - np.arcsinh(V / H))
    y = s / EA * (V + weight * s / 2) + (tension - tension[0]) / weight
    slope = (1 / tension + 1 / EA)[:, None] * np.stack([np.full(n + 1, H), up], axis=1)
    return np.stack([np.stack([x, y], axis=1), slope], axis=1), weight


@pytest.mark.parametrize(("EA", "d"), [(50.0, 3), slow(1e6, 2)])
def test_a_hanging_cable_takes_the_form_of_the_elastic_catenary_with_order_four(EA, d):
    errors = []
    for n in (8, 16):
        plane, weight = catenary(n, EA)
        exact = np.pad(plane, ((0, 0), (0, 0), (0, d - 2))).ravel()
        load = cables.mass_matrix(n, d, 1.0, 1.0 / n) @ cables.uniform(n, -weight * np.eye(d)[1])
        free, q = np.delete(np.arange(exact.size), [*range(d), *range(2 * d * n, 2 * d * n + d)]), exact.copy()

        @jax.jit
        def balance(q, n=n, load=load):
            residual = lambda q: load + force(q, 0 * q, d, 1.0 / n, EA=EA, EI=0.0)  # noqa: E731
            return residual(q), jax.jacfwd(residual)(q)

        for _ in range(12):
            residual, slope = (np.asarray(x) for x in balance(q))
            q[free] -= np.linalg.solve(slope[np.ix_(free, free)], residual[free])
        assert np.abs(residual[free]).max() < 1e-15 * n**2 * EA + 1e-12
        errors.append(np.abs((q - exact).reshape(-1, 2, d)[:, 0]).max())
    assert errors[1] < 2e-5
    assert np.log2(errors[0] / errors[1]) > 3.5


def test_cords_pull_like_springs_where_tight_not_at_all_where_slack_and_keep_their_energy():
    k, c, free, width = 300.0, 7.0, 0.8, 1e-3
    lengths, rates = free + np.array([-0.2, -5e-4, 0.0, 3e-4, 0.2]), np.array([-3.0, 2.0, 1.0, -0.5, 4.0])
    cord = cables.cord(k, c, free, width)
    pull, still, energy, share = values(
        [
            cord,
            lambda x, u: cord(x, 0 * u),
            lambda x, u: jax.vmap(jax.grad(lambda x: cables.cord_energy(x, k, free, width)))(x),
            lambda x, u: jax.vmap(jax.grad(lambda x: cord(x, 0.0)))(x) / k,
        ],
        lengths,
        rates,
    )
    np.testing.assert_allclose(still, energy, rtol=1e-9)
    np.testing.assert_allclose(pull - still, c * share * rates, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(pull[-1], k * 0.2 + c * 4.0, rtol=1e-4)  # width^2 / (4 s^2)
    np.testing.assert_allclose(still[2], k * width / 2, rtol=1e-12)
    assert 0 < still[0] < 2e-6 * k
    assert abs(pull[0]) < 1e-3
