"""Small problems whose motion is known, so that what a drawing must hold can be counted."""

import math

import numpy as np
import pytest

from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.system import System


class Rotor(System):
    """A point held by a spring of 1 N/m: it runs a circle."""

    def force(self, t, q, v):
        return -q


def rotor_sketch(q):
    return {"points": np.array([[0.0, 0.0], q]), "lines": np.array([[[0.0, 0.0], q], [[-0.1, 0.0], [0.1, 0.0]]])}


def rotor_sketch_in_space(q):
    lift = lambda x: np.pad(x, [(0, 0)] * (np.ndim(x) - 1) + [(0, 1)])  # noqa: E731
    return {name: lift(x) for name, x in rotor_sketch(q).items()}


@pytest.fixture
def rotor():
    """rotor(**fields): once round in 2 pi s; the second line of the sketch and its first point never move."""

    def make(**fields):
        known = {
            "name": "rotor",
            "system": Rotor(),
            "t_span": (0.0, 20.0),
            "q0": np.array([1.0, 0.0]),
            "v0": np.array([0.0, 1.0]),
            "exact": lambda t: Motion(np.array([math.cos(t), math.sin(t)]), np.array([-math.sin(t), math.cos(t)]), [], []),
            "sketch": rotor_sketch,
            "tags": ("unconstrained",),
        }
        return Problem(**{**known, **fields})

    return make


@pytest.fixture
def in_space():
    return rotor_sketch_in_space
