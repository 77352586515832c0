"""What a system's functions may return and change (rows C6 to C8 of the acceptance matrix)."""

import numpy as np
import pytest

from hhtbench.protocol import System
from solvers.hht import HHT
from tests.hht.scenes import Q0, V0, circle, pendulum


def solve(system, span=(0.0, 0.1)):
    return HHT(system).solve(span, Q0, V0, step=0.01)


def test_a_constraint_that_changes_its_length_is_refused():
    growing = pendulum(constraint=lambda t, q: np.resize(circle(t, q), 1 if t < 0.05 else 2))
    with pytest.raises(ValueError, match=r"constraint must return shape \(1,\).*\(2,\)"):
        solve(growing)


@pytest.mark.parametrize("value", [None, 1.0, np.zeros((2, 2)), (np.zeros((2, 2)),), "ab"])
def test_force_jacobians_that_are_no_pair_are_refused(value):
    with pytest.raises((TypeError, ValueError), match=r"force_jacobians.* must return"):
        solve(pendulum(force_jacobians=lambda t, q, v: value))


class Returns(System):
    """A force of the wrong kind, chosen by a static field."""

    value: object

    def force(self, t, q, v):
        return self.value


@pytest.mark.parametrize(
    "value", [None, 1.0, "ab", np.zeros(3), np.zeros((2, 1)), np.zeros(2, complex), (0.0, 0.0)], ids=repr
)
def test_a_jax_force_of_the_wrong_kind_is_refused_by_name(value):
    with pytest.raises((TypeError, ValueError), match="force"):
        solve(Returns(value))
