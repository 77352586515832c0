"""An exception of the system's own reaches the caller as it is, with what was integrated (rows C11 to C13)."""

import pytest

from hhtbench.protocol import System
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.scenes import Q0, V0


def solve(system, span=(0.0, 0.1), step=0.01):
    return HHT(system).solve(span, Q0, V0, step=step)


class Own(Exception):
    """An exception of the user's."""


class RaisesWhenTraced(System):
    """A JAX system whose function raises when it is read."""

    def force(self, t, q, v):
        raise Own("while tracing")


def test_an_exception_of_a_jax_function_reaches_the_caller_unchanged():
    with pytest.raises(Own, match="while tracing") as caught:
        solve(RaisesWhenTraced())
    assert caught.value.partial_solution.status is Status.user_exception
