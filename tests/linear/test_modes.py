"""Frequencies, damping and stability of small motions against closed forms, energies and a few lines of NumPy."""

from __future__ import annotations

import dataclasses
import importlib.util
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import eigh

import hhtbench as hb
from hhtbench.mechanics import Mechanism, space
from problems import bricard, chaplygin_sleigh, rolling_disk3d_steady, spinup_beam

G = 9.81  # m/s^2
SCENES = Path(__file__).parent.parent.parent / "docs/scenes"


class Chain(hb.System):
    """Masses of 2 kg between springs of 50 N/m and dampers, fixed at both ends."""

    damping: object = hb.parameter(0.0, doc="[N s/m]")
    mass_matrix = 2.0

    def force(self, t, q, v):
        pull = lambda x, k: k * jnp.diff(jnp.concatenate([jnp.zeros(1), x, jnp.zeros(1)]), n=2)  # noqa: E731
        return pull(q, 50.0) + pull(v, self.damping)


@pytest.mark.parametrize("damping", [0.0, 3.0, 40.0])
def test_a_chain_of_springs_has_its_closed_frequencies_and_damping(damping):
    """w_i = 2 sqrt(k / m) sin(i pi / (2 n + 2)), damped by c w_i / (2 k); beyond one, two real eigenvalues each."""
    n = 5
    problem = hb.Problem(name="chain", system=Chain(damping), t_span=(0, 1), q0=0.1 * np.arange(n), v0=np.zeros(n))
    found = hb.modes(problem)
    w = 2 * 5 * np.sin(np.arange(1, n + 1) * np.pi / (2 * n + 2))
    ratio = damping * w / 100
    pairs = [np.roots([1, 2 * z * x, x * x]) for z, x in zip(ratio, w, strict=True)]
    expected = np.concatenate([pair if z > 1 else pair[pair.imag >= 0] for z, pair in zip(ratio, pairs, strict=True)])
    np.testing.assert_allclose(np.sort_complex(found.eigenvalues), np.sort_complex(expected), atol=1e-11)
    if damping < 10:
        np.testing.assert_allclose(found.frequencies, w / (2 * np.pi), rtol=1e-12)
        np.testing.assert_allclose(found.damping, ratio, atol=1e-12)
        first = np.sin(np.pi * np.arange(1, n + 1) / (n + 1))
        np.testing.assert_allclose(found.shapes[:, 0], first, atol=1e-11)
    assert found.stable


class Pendulum(hb.System):
    """A mass of 3 kg on a rod of 2 m, q = (x, y): all its stiffness is that of the multiplier."""

    mass_matrix = 3.0

    def force(self, t, q, v):
        return jnp.array([0.0, -3.0 * G])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 4.0) / 2])


class Doubled(Pendulum):
    """Its declared reaction is twice as large as that of the constraint; the motion is the same."""

    def reaction(self, t, q, lam):
        return -2.0 * q * lam


@pytest.mark.parametrize("system", [Pendulum(), Doubled()])
def test_a_pendulum_swings_and_upside_down_falls_with_the_root_of_g_over_l(system):
    problem = hb.Problem(name="pendulum", system=system, t_span=(0, 1), q0=(1, -(3**0.5)), v0=(0, 0))
    found = hb.modes(problem)
    np.testing.assert_allclose(found.frequencies, np.sqrt(G / 2) / (2 * np.pi), rtol=1e-12)
    top = hb.modes(problem, ([0.0, 2.0], [0.0, 0.0]))
    np.testing.assert_allclose(np.sort(top.eigenvalues), np.sqrt(G / 2) * np.array([-1, 1]), rtol=1e-12)
    assert found.stable
    assert not top.stable


def test_a_beam_swings_as_euler_and_bernoulli_say():
    """Clamped and free: (1.87510407 / L)^2 sqrt(EI / rho A); shear, rotary inertia, elements: below 1e-3 with 32."""
    problem = spinup_beam.problem(n_elements=32)
    beam = spinup_beam.BEAM
    expected = (1.87510407 / beam["length"]) ** 2 * np.sqrt(beam["EI"] / beam["rho_A"]) / (2 * np.pi)
    np.testing.assert_allclose(hb.modes(problem).frequencies[0], expected, rtol=1e-3)


def test_a_chain_on_stiff_bushings_has_the_frequencies_of_its_energy():
    """Stiffness 1e9 N/m beside 10 N m: roundoff of 1e-16 of the largest square is 1e-9 of the lowest."""
    spec = importlib.util.spec_from_file_location("bushings", SCENES / "bushings.py")
    scene = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(scene)
    problem = scene.problem(4)
    undamped = eqx.tree_at(lambda system: system.elements["bushing"].damping, problem.system, jnp.zeros(12))
    problem = dataclasses.replace(problem, system=undamped)
    rest = hb.equilibrium(problem)
    hessian = jax.jit(jax.hessian(lambda x: problem.system.energy(0.0, x, 0 * x)))(rest.q)
    expected = np.sqrt(eigh(hessian, np.diag(problem.system.mass_matrix), eigvals_only=True)) / (2 * np.pi)
    found = hb.modes(problem, rest)
    np.testing.assert_allclose(found.frequencies, expected, rtol=1e-7)
    assert found.stable


def along_the_loop(system, q, steps):
    """Way (n,) of the one motion of a mechanism from ``q`` (n,), and its energies [J] at ``steps`` along it."""
    both = jax.jit(lambda x: (system.constraint(0.0, x), jax.jacfwd(lambda y: system.constraint(0.0, y))(x)))
    energy, energies = jax.jit(lambda x: system.energy(0.0, x, 0 * x)), []
    way = np.linalg.svd(both(q)[1])[2][-1]
    for step in steps:
        x = q + step * way
        for _ in range(5):
            g, rows = both(x)
            x = x - np.linalg.pinv(rows, rcond=1e-2) @ g  # the row that depends on others is left out
        energies.append(float(energy(x)))
    return way, energies


def test_bricards_loop_swings_about_its_lowest_position_whatever_the_constant_of_the_quaternions():
    """f^2 from second differences of the potential along the loop, whose rows depend on one another: error h^2 = 1e-6."""
    problem = bricard.problem()
    rest = hb.equilibrium(problem)
    h = 1e-3
    way, potential = along_the_loop(problem.system, rest.q, (-h, 0.0, h))
    mass = way @ np.asarray(problem.system.mass_matrix(0.0, rest.q)) @ way
    expected = np.sqrt((potential[0] - 2 * potential[1] + potential[2]) / h**2 / mass) / (2 * np.pi)
    found = hb.modes(problem, rest)
    np.testing.assert_allclose(found.frequencies, expected, rtol=1e-5)
    system = dataclasses.replace(problem.system, j0=np.full(5, 0.5))
    other = hb.Problem(name="bricard", system=system, t_span=(0, 1), q0=problem.q0, v0=0 * problem.q0)
    np.testing.assert_allclose(hb.modes(other).frequencies, found.frequencies, rtol=1e-10)


def test_a_bar_of_a_mechanism_swings_about_its_hinge():
    """A bar of length 1.2 m about its end: w^2 = 3 g / (2 l); its bearing carries the weight."""
    m = Mechanism()
    m.body("bar", 2.0, (1e-3, 2 * 1.44 / 12, 2 * 1.44 / 12), at=(0.6, 0, 0))
    m.revolute("A", "ground", "bar", at=(0, 0, 0), axis=(0, 1, 0))
    problem = m.problem((0, 1))
    rest = hb.equilibrium(problem)
    np.testing.assert_allclose(rest.q[:3], [0, 0, -0.6], atol=1e-10)
    np.testing.assert_allclose(hb.modes(problem, rest).frequencies, np.sqrt(1.5 * G / 1.2) / (2 * np.pi), rtol=1e-9)


@pytest.mark.parametrize("speed", [0.5, -0.5])
def test_a_sleigh_runs_straight_with_its_skate_behind_and_turns_round_otherwise(speed):
    """w' = -(a u m / (I + m a^2)) w about straight running at u (Bloch 2003, as the problem's own text has it)."""
    problem = chaplygin_sleigh.problem()
    found = hb.modes(problem, (problem.q0, [speed, 0.0, 0.0]))
    expected = -0.2 * speed / (0.1 + 0.2**2)
    np.testing.assert_allclose(found.eigenvalues[found.eigenvalues != 0], expected, rtol=1e-12)
    assert found.eigenvalues.size == 5  # two more of position than of velocity, and the speed
    assert found.stable == (speed > 0)


@pytest.mark.parametrize("theta", [np.pi / 3, 0.45 * np.pi])
def test_a_rolling_disk_wobbles_as_its_reduced_equations_say(theta):
    """Steady circles; Routh 1905: with p = Om sin(theta), s, c = sin, cos(theta), A and C the moments, differentiated here,

    (A + m R^2) theta'' = (A p c / s - (C + m R^2) w) p - m g R c,  A p' = (C w - A p c / s) theta',
    (C + m R^2) w' = m R^2 p theta'.
    """
    problem = rolling_disk3d_steady.problem(theta=theta, Om=3.0)
    steady = rolling_disk3d_steady.Steady(m=1.0, R=0.5, g=G, theta=theta, Om=3.0, j0=0.25 / 3)
    A, C, m, R, (s, c), w = 0.0625, 0.125, 1.0, 0.5, (np.sin(theta), np.cos(theta)), steady.w3
    p, D = 3.0 * s, C + m * R**2
    stiffness = (A * p * (-1 / s**2)) * p + m * G * R * s
    by_p, by_w = 2 * A * p * c / s - D * w, -D * p
    square = (stiffness + by_p * (C * w - A * p * c / s) / A + by_w * m * R**2 * p / D) / (A + m * R**2)
    spin = [[0.0, 0.0, w - 3.0 * c]]
    centre = np.array([steady.w3 * R / 3.0, 0.0, 0.0])  # of the circle: the motion turns about it
    along = lambda q: space.carried(q, -np.cross([0, 0, 3.0], centre), [0, 0, 3.0], spin)  # noqa: E731
    found = hb.modes(problem, (problem.q0, problem.v0), along=along)
    values = found.eigenvalues[found.eigenvalues != 0]
    squares = np.array([square, -9.0])  # a shift of the circle turns with the observer
    np.testing.assert_allclose(np.unique((values**2).round(9)), np.sort(squares), rtol=1e-8)
    assert found.stable == (square < 0)


def test_states_that_are_not_steady_are_refused():
    problem = hb.Problem(name="pendulum", system=Pendulum(), t_span=(0, 1), q0=(0, -2), v0=(0, 0))
    with pytest.raises(hb.ProblemError, match=r"^pendulum: the state is neither an equilibrium nor a steady motion"):
        hb.modes(problem, ([2.0, 0.0], [0.0, 0.0]))
    with pytest.raises(hb.ProblemError, match=r"^pendulum: the state violates a constraint, g\[0\] = 2.5"):
        hb.modes(problem, ([0.0, -3.0], [0.0, 0.0]))
    with pytest.raises(hb.ProblemError, match=r"^along.q. must be the velocity of the state"):
        hb.modes(problem, ([0.0, -2.0], [0.0, 0.0]), along=lambda q: q)
    with pytest.raises(TypeError, match=r"at must be an Equilibrium or a pair \(q, v\); got float"):
        hb.modes(problem, 1.0)
    disk = rolling_disk3d_steady.problem()
    with pytest.raises(hb.ProblemError, match="neither an equilibrium nor a steady motion"):
        hb.modes(disk, (disk.q0, disk.v0))  # along= is missing


class Angle(hb.System):
    """A pendulum by its angle: at the lowest point it has no acceleration, and moves on."""

    def force(self, t, q, v):
        return -G * jnp.sin(q)


def test_a_passing_motion_is_not_steady():
    problem = hb.Problem(name="angle", system=Angle(), t_span=(0, 1), q0=[0.0], v0=[1.0])
    with pytest.raises(hb.ProblemError, match=r"^angle: the motion is not steady: the linearised equations change along it"):
        hb.modes(problem, ([0.0], [1.0]))
