"""What is seen of a problem before anybody solves it, against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.advice.features import probe
from hhtbench.lowering.equations import POWER_STEPS


def oscillator(k, c=0.0, t_end=2 * math.pi):
    """m y'' = -k y - c y' of unit mass beside a slow one."""
    stiffness, damping = np.array([k, 1.0]), np.array([c, 0.0])
    system = hb.NumpySystem(force=lambda t, q, v: -stiffness * q - damping * v)
    return hb.Problem(name="pair", system=system, t_span=(0.0, t_end), q0=[0.0, 1.0], v0=[0.0, 0.0])


def test_turns_of_the_fastest_mode_are_its_circular_frequency_over_two_pi():
    found = probe(oscillator(1e4)).features
    assert 10**found.fastest == pytest.approx(100.0, rel=1e-3)
    assert 10**found.pace == pytest.approx(1.0)
    assert found.stiffness == pytest.approx(100.0, rel=1e-3)
    assert found.damping < 1e-3


def test_a_mode_that_decays_has_damping_one():
    found = probe(oscillator(1.0, c=500.0)).features
    assert 10**found.fastest == pytest.approx(500.0, rel=1e-2)
    assert found.damping == pytest.approx(1.0, abs=1e-6)


def test_twice_the_span_has_twice_the_turns():
    one, two = (probe(oscillator(1e4, t_end=t)).features for t in (3.0, 6.0))
    assert 10 ** (two.fastest - one.fastest) == pytest.approx(2.0)
    assert two.stiffness == pytest.approx(one.stiffness)


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
    assert 3 < found.evaluations <= POWER_STEPS + 3  # a mode that does not move ends it


def test_a_problem_without_accelerations_has_no_features():
    system = hb.NumpySystem(force=lambda t, q, v: np.array([np.nan]))
    with pytest.raises(hb.ProblemError, match="p has no features"):
        probe(hb.Problem(name="p", system=system, t_span=(0.0, 1.0), q0=[0.0], v0=[0.0]))
