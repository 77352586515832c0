"""Callables without derivatives in any unit of length: steps of differences have the size of the motion."""

import warnings

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering import derive
from solvers.hht import HHT

SIZES = [1e-9, 1e-6, 1e-3, 1e3, 1e5, 1e9]


def pendulum(length, **declared):
    """Of that ``length``, swinging as one of a metre does, from a place with a coordinate that is zero."""
    system = hb.NumpySystem(
        force=lambda t, q, v: np.array([0.0, -9.81 * length]),
        constraint=lambda t, q: np.array([np.hypot(*q) - length]),
        **declared,
    )
    return system, np.array([length, 0.0])


def end(length, **declared):
    """q over the length after 0.3 s of 20 steps; nothing is to be told of it."""
    system, start = pendulum(length, **declared)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        solution = HHT(system).solve((0.0, 0.3), start, np.zeros(2), steps=20)
    assert solution.success, solution.message
    return solution.q[-1] / length


@pytest.mark.parametrize("length", SIZES)
def test_without_derivatives_a_mechanism_moves_the_same_at_any_size(length):
    np.testing.assert_allclose(end(length), end(1.0), rtol=0, atol=1e-7)


@pytest.mark.parametrize("length", SIZES)
def test_right_derivatives_are_believed_at_any_size(length):
    found = end(
        length,
        constraint_jacobian=lambda t, q: (q / np.hypot(*q))[None],
        constraint_acceleration=lambda t, q, v: np.array([(v @ v - (q @ v) ** 2 / (q @ q)) / np.hypot(*q)]),
    )
    np.testing.assert_allclose(found, end(1.0), rtol=0, atol=1e-7)


def test_small_angles_of_a_mechanism_of_metres_keep_their_steps():
    """They differ by nothing that one radian would be too long for: shorter steps would only add roundoff."""
    system = hb.NumpySystem(force=lambda t, q, v: -9.81 * np.sin(q), constraint=lambda t, q: np.array([q[0] - q[1]]))
    assert derive(system, 0.0, np.full(2, 1e-6), np.zeros(2)).least == 1.0
    assert derive(pendulum(1e-6)[0], 0.0, np.array([1e-6, 0.0]), np.zeros(2)).least == 1e-6
