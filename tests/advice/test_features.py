"""What is seen of a problem before anybody solves it, against closed forms."""

from __future__ import annotations

import math

import jax
import numpy as np
import pytest
from scipy.linalg import eigh, null_space

import hhtbench as hb
from hhtbench.advice.features import MIN_SHARE, probe
from hhtbench.lowering.rates import POWER_STEPS
from hhtbench.protocol.system import declared


def oscillator(k, c=0.0, t_end=2 * math.pi, fast=0.0):
    """m y'' = -k y - c y' of unit mass, begun with the velocity ``fast``, beside a slow one that begins at 1."""
    stiffness, damping = np.array([k, 1.0]), np.array([c, 0.0])
    system = hb.NumpySystem(force=lambda t, q, v: -stiffness * q - damping * v)
    return hb.Problem(name="pair", system=system, t_span=(0.0, t_end), q0=[0.0, 1.0], v0=[fast, 0.0])


def test_turns_of_the_fastest_vibration_are_its_circular_frequency_over_two_pi():
    found = probe(oscillator(1e4)).features
    assert 10**found.vibration == pytest.approx(100.0, rel=1e-3)
    assert 10**found.pace == pytest.approx(1.0)
    assert found.stiffness == pytest.approx(100.0, rel=1e-3)
    assert found.decay == found.pace, "nothing decays: the slowest that counts is the motion itself"


def test_a_spring_with_a_strong_damper_shows_its_vibration_and_its_decay():
    """y'' = -k y - c y' with c = 5 sqrt(k): a mode ratio would hide the spring behind the damper."""
    found = probe(oscillator(1e4, c=500.0)).features
    assert 10**found.vibration == pytest.approx(100.0, rel=1e-3)
    assert 10**found.decay == pytest.approx(500.0, rel=1e-3)
    assert found.stiffness == pytest.approx(500.0, rel=1e-3)


def test_twice_the_span_has_twice_the_turns():
    one, two = (probe(oscillator(1e4, t_end=t)).features for t in (3.0, 6.0))
    assert 10 ** (two.vibration - one.vibration) == pytest.approx(2.0)
    assert two.stiffness == pytest.approx(one.stiffness)


@pytest.mark.parametrize("fast", [1e-3, 0.3])
def test_the_share_is_the_velocity_with_which_the_fast_vibration_begins(fast):
    """Root of the mean square over two coordinates; the slow one of 1 rad/s counts (1 / 100)^2 of its acceleration."""
    found = probe(oscillator(1e4, fast=fast)).features
    assert 10**found.share == pytest.approx(fast / math.sqrt(2), rel=1e-2)


def test_a_stiff_spring_at_rest_has_no_share_and_a_motion_of_one_spring_is_all_of_it():
    assert 10 ** probe(oscillator(1e6)).features.share == pytest.approx(MIN_SHARE)
    assert probe(hb.load_problem("simple_pendulum")).features.share == 0.0


@pytest.mark.parametrize("spec", ["oscillator_chain", "bushing_chain", "bushing_chain(c=3.5e6)", "spinup_beam(t_end=3)"])
def test_rates_are_those_of_the_linearised_equations(spec):
    """Eigenvalues by SciPy of K and D of M v' = -K q - D v on the null space of the constraints, from derivatives by JAX.

    The bound is that of ten power steps where eigenvalues lie close to the largest one.
    """
    problem = hb.load_problem(spec)
    start = problem.t_span[0], problem.q0, problem.v0
    free = np.eye(problem.q0.size)
    if declared(problem.system, "constraint") is not None:
        free = null_space(np.asarray(jax.jit(jax.jacfwd(problem.system.constraint, 1))(*start[:2])))
    mass = np.asarray(problem.system.mass_matrix)
    mass = free.T @ (mass * np.eye(len(free)) if mass.ndim < 2 else mass) @ free
    slopes = jax.jit(jax.jacfwd(problem.system.force, (1, 2)))(*start)
    stiff, damp = (-free.T @ np.asarray(slope) @ free for slope in slopes)
    found = probe(problem).features
    turns = problem.t_span[1] / (2 * math.pi)
    assert 10**found.vibration == pytest.approx(turns * math.sqrt(eigh(stiff, mass)[0][-1]), rel=0.1)
    assert 10**found.decay == pytest.approx(max(turns * eigh(damp, mass)[0][-1], 10**found.pace), rel=0.1)


def test_a_force_that_wakes_later_gives_the_pace():
    system = hb.NumpySystem(force=lambda t, q, v: np.array([np.sin(t)]))
    found = probe(hb.Problem(name="p", system=system, t_span=(0.0, 10.0), q0=[0.0], v0=[0.0])).features
    assert 10**found.pace > 0.5


@pytest.mark.parametrize(
    ("spec", "known"),
    [
        ("simple_pendulum", {"position": 0.5, "velocity": 0.0, "redundant": 0.0, "variable_mass": 0.0}),
        ("redundant_pendulum", {"position": 1.0, "redundant": 1.0}),
        ("knife_edge", {"position": 0.0, "velocity": 1 / 3}),
        ("andrews", {"position": 6 / 7, "variable_mass": 1.0}),
    ],
)
def test_sizes_and_kinds_are_those_of_the_equations(spec, known):
    found = probe(hb.load_problem(spec))
    assert {name: getattr(found.features, name) for name in known} == pytest.approx(known)
    assert 3 < found.evaluations <= 2 * POWER_STEPS + 5  # a mode that does not move ends it


def test_a_problem_without_accelerations_has_no_features():
    system = hb.NumpySystem(force=lambda t, q, v: np.array([np.nan]))
    with pytest.raises(hb.ProblemError, match="p has no features"):
        probe(hb.Problem(name="p", system=system, t_span=(0.0, 1.0), q0=[0.0], v0=[0.0]))
