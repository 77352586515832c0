"""What a system's functions return and raise: values that are not finite, of the wrong kind, and exceptions."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol.system import NumpySystem, System, parameter
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.scenes import (
    ALPHAS,
    GRAVITY,
    PENDULUM,
    Q0,
    V0,
    Calls,
    circle,
    pendulum,
    unit_mass,
)

WITH_MASS = {**PENDULUM, "mass_matrix": unit_mass}


def solve(system, **options):
    request = {"step": 0.01, **{k: v for k, v in options.items() if k not in ("span", "alpha")}}
    chosen = {k: v for k, v in options.items() if k == "alpha"}
    return HHT(system, **chosen).solve(options.get("span", (0.0, 0.1)), Q0, V0, **request)


def spoiled(value, bad):
    """``value`` with its last entry replaced."""
    if isinstance(value, tuple):
        return tuple(spoiled(part, bad) for part in value)
    result = np.array(value, dtype=float)
    result[(-1,) * result.ndim] = bad
    return result


def replaced(name, bad, when):
    """The pendulum whose function ``name`` holds ``bad`` where ``when(t, count of calls so far)``."""
    functions, count = dict(WITH_MASS), [0]
    original = functions[name]

    def call(t, *arguments):
        count[0] += 1
        value = original(t, *arguments)
        return spoiled(value, bad) if when(t, count[0]) else value

    return NumpySystem(**{**functions, name: call})


PLACES = {"force": [1], "mass_matrix": [1, 1], "constraint": [0], "constraint_jacobian": [0, 1]}


class Spoiled(System):
    """The pendulum with NaN in the function ``name`` from 0.995 s on."""

    name: str

    def _bad(self, name, t):
        return jnp.where((self.name == name) & (t >= 0.995), jnp.nan, 0.0)

    def force(self, t, q, v):
        return jnp.stack([0.0 * t, -GRAVITY + self._bad("force", t)])

    def mass_matrix(self, t, q):
        return jnp.eye(2).at[1, 1].add(self._bad("mass_matrix", t) + 0.0 * q[0])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0 + self._bad("constraint", t)])

    def constraint_jacobian(self, t, q):
        return q[None, :].at[0, 1].add(self._bad("constraint_jacobian", t))


@pytest.mark.parametrize("name", PLACES)
def test_the_compiled_route_names_function_and_component_in_mid_run(name):
    solution = solve(Spoiled(name), span=(0.0, 2.0))
    assert solution.status is Status.nonfinite_callback
    assert f"{name}{PLACES[name]} = nan" in solution.message
    assert 0.9 <= solution.t[-1] < 1.0
    assert np.isfinite(solution.q).all()


@pytest.mark.parametrize(("name", "alpha"), [(x, ALPHAS[i % 2]) for i, x in enumerate([*PLACES, "force_jacobians"])])
def test_one_value_that_is_not_finite_is_retried_wherever_it_falls(name, alpha):
    calls = Calls()
    baseline = solve(NumpySystem(**calls.wrap(WITH_MASS)), alpha=alpha, span=(0.0, 0.03))
    for k in range(1, calls.count[name] + 1):
        solution = solve(replaced(name, np.nan, lambda t, count, k=k: count == k), alpha=alpha, span=(0.0, 0.03))
        assert solution.success, f"call {k}: {solution.message}"
        assert np.array_equal(solution.t, baseline.t)
        assert np.max(np.abs(solution.q - baseline.q)) < 1e-11, k
        assert np.max(np.abs(solution.v - baseline.v)) < 1e-11, k
        assert np.max(np.abs(solution.lam - baseline.lam)) < 1e-8, k
        found = solution.counters.nonfinite_evaluations
        assert found == 1 or (found == 0 and name.startswith("constraint")), k  # not counted where derivatives are compared


class Drag(System):
    """v' = -45 v^2, not a number above ``limit`` [m/s] after the start."""

    limit: object = parameter(0.47)

    def force(self, t, q, v):
        return jnp.where((t > 0.0) & (v > self.limit), jnp.nan, -45.0 * v**2)


def test_the_damped_iteration_comes_back_from_where_a_force_is_undefined():
    """The first full Newton increment leads from v1 = 0.1 to 0.509, the solution is 0.456."""
    solution = HHT(Drag(), alpha=0.0).solve((0.0, 0.02), [0.0], [1.0], steps=1)
    assert solution.success, solution.message
    v1 = solution.v[-1, 0]
    assert v1 + 0.45 * v1**2 == pytest.approx(0.55, abs=1e-12)  # the trapezoidal rule by hand
    assert solution.counters.steps_rejected_newton == 1


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
