"""An exception of the system's own reaches the caller as it is, with what was integrated (rows C11 to C13)."""

from dataclasses import dataclass

import numpy as np
import pytest

from hhtbench.protocol import NumpySystem, System
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.scenes import PENDULUM, Q0, V0, gravity, pendulum, pendulum_at, same_bits, unit_mass

WITH_MASS = {**PENDULUM, "mass_matrix": unit_mass}


def solve(system, span=(0.0, 0.1), step=0.01):
    return HHT(system).solve(span, Q0, V0, step=step)


class Own(Exception):
    """An exception of the user's."""


@dataclass(frozen=True)
class Frozen(Exception):
    """One that refuses new attributes."""

    code: int = 3


ERRORS = [Own, Frozen, SystemExit, KeyboardInterrupt, MemoryError, RecursionError, ZeroDivisionError, np.linalg.LinAlgError]


def raising(name, error, when):
    functions, count = dict(WITH_MASS), [0]
    original = functions[name]

    def call(t, *arguments):
        count[0] += 1
        if when(t, count[0]):
            raise error
        return original(t, *arguments)

    return NumpySystem(**{**functions, name: call})


@pytest.mark.parametrize("kind", ERRORS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("name", ["force", "force_jacobians", "constraint", "constraint_jacobian", "mass_matrix"])
def test_an_exception_in_mid_run_reaches_the_caller_with_what_was_integrated(kind, name):
    error = kind()
    with pytest.raises(kind) as caught:
        solve(raising(name, error, lambda t, count: t >= 1.0), span=(0.0, 2.0), step=0.02)
    assert caught.value is error
    partial = error.partial_solution
    assert partial.status is (Status.interrupted if kind is KeyboardInterrupt else Status.user_exception)
    assert kind.__name__ in partial.message
    assert 0.9 <= partial.t[-1] < 1.0
    assert partial.counters.steps_accepted == len(partial.t) - 1 == len(partial.steps_data.t)
    q, _ = pendulum_at(partial.t)
    assert np.max(np.abs(partial.q - q)) < 1e-3
    assert np.isfinite(partial.lam).all()


@pytest.mark.parametrize("kind", ERRORS, ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("name", ["force", "constraint", "constraint_jacobian", "mass_matrix"])
def test_an_exception_at_the_first_call_reaches_the_caller(kind, name):
    error = kind()
    with pytest.raises(kind) as caught:
        solve(raising(name, error, lambda t, count: True))
    assert caught.value is error
    assert error.partial_solution.status in (Status.user_exception, Status.interrupted)
    assert len(error.partial_solution.t) == 0


def test_the_solver_works_again_after_an_exception_of_its_system():
    fail = [True]

    def force(t, q, v):
        if fail[0]:
            raise Own
        return gravity(t, q, v)

    solver = HHT(pendulum(force=force))
    with pytest.raises(Own):
        solver.solve((0.0, 0.1), Q0, V0, step=0.01)
    fail[0] = False
    assert same_bits(solver.solve((0.0, 0.1), Q0, V0, step=0.01), solve(pendulum()))


class RaisesWhenTraced(System):
    """A JAX system whose function raises when it is read."""

    def force(self, t, q, v):
        raise Own("while tracing")


def test_an_exception_of_a_jax_function_reaches_the_caller_unchanged():
    with pytest.raises(Own, match="while tracing") as caught:
        solve(RaisesWhenTraced())
    assert caught.value.partial_solution.status is Status.user_exception


def test_a_callback_may_run_another_solver():
    inner_ends = []

    def force(t, q, v):
        inner_ends.append(HHT(pendulum()).solve((0.0, 0.02), Q0, V0, step=0.01).q[-1])
        return gravity(t, q, v)

    outer = solve(pendulum(force=force), span=(0.0, 0.03))
    assert same_bits(outer, solve(pendulum(), span=(0.0, 0.03)))
    assert all(np.array_equal(end, inner_ends[0]) for end in inner_ends)
