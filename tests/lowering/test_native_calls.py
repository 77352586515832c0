"""``compile_function`` on the native route: arguments of every kind, threads, and the choice of the route."""

import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import Array, lax

from hhtbench.lowering import compile_function, derive, routes
from hhtbench.lowering.compile.compiled import Compiled
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import NumpySystem, System, parameter

Q, V = np.array([1.0, 2.0]), np.array([0.5, -0.5])
pytestmark = pytest.mark.usefixtures("empty_cache")


class Spring(System):
    k: Array = parameter(2.0, doc="stiffness [N/m]")

    def force(self, t, q, v):
        return -self.k * q + t * v


class Searching(System):
    """Its force is found by an iteration without a known number of turns."""

    def force(self, t, q, v):
        return lax.while_loop(lambda x: jnp.max(jnp.abs(x)) > 0.1, lambda x: 0.5 * x, -q)


def force_of(dynamics, t, q, v):
    return dynamics.force(t, q, v)


def matrix_of(dynamics, q, scale):
    return scale * jnp.outer(q, q)


def spring_force(route=None, system=None):
    return compile_function(force_of, derive(system or Spring(), 0.0, Q, V), route=route)


EXPECTED = -2.0 * Q + 0.25 * V


@pytest.mark.parametrize(
    "arguments",
    [
        (0.25, Q, V),
        (np.float64(0.25), Q, V),
        (np.array(0.25), np.repeat(Q, 2)[::2], V[::-1][::-1]),
        (jnp.asarray(0.25), jnp.asarray(Q), jnp.asarray(V)),
        (0.25, Q.astype(int), V.astype(np.float32)),
        (0.25, Q.astype(">f8"), V),
        (0.25, list(Q), tuple(V)),
    ],
    ids=["plain", "NumPy number", "strided", "JAX", "whole and single", "big-endian", "lists"],
)
def test_arguments_of_every_kind(arguments):
    compiled = spring_force()
    for _ in range(2):
        np.testing.assert_allclose(compiled(*arguments), EXPECTED, rtol=1e-15)
        np.testing.assert_allclose(compiled(0.25, Q, V), EXPECTED, rtol=1e-15)


def test_read_only_arguments_are_fine_and_results_are_fresh():
    compiled, q = spring_force(), Q.copy()
    q.setflags(write=False)
    first = compiled(0.25, q, V)
    kept = first.copy()
    compiled(1.0, 3 * Q, V)
    np.testing.assert_array_equal(first, kept)
    first[:] = 0.0
    np.testing.assert_allclose(compiled(0.25, q, V), EXPECTED, rtol=1e-15)


def test_matrices_and_other_shapes():
    dynamics = derive(Spring(), 0.0, Q, V)
    compiled = compile_function(matrix_of, dynamics)
    np.testing.assert_array_equal(compiled(Q, 2.0), 2 * np.outer(Q, Q))
    three = np.arange(3.0)
    np.testing.assert_array_equal(compiled(three, 2.0), 2 * np.outer(three, three))
    np.testing.assert_array_equal(compiled(Q, 3.0), 3 * np.outer(Q, Q))
    assert {choice.route for choice in routes(dynamics)} == {"native"}


def test_a_wrong_number_of_arguments_is_an_error():
    compiled = spring_force()
    compiled(0.0, Q, V)
    with pytest.raises(TypeError):
        compiled(0.0, Q)
    with pytest.raises(TypeError):
        compiled(0.0, np.ones(3), V)


def test_threads_do_not_share_memory():
    compiled, wrong = spring_force(), []

    def work(scale):
        for _ in range(3000):
            if not np.array_equal(compiled(0.0, scale * Q, V), -2.0 * scale * Q):
                wrong.append(scale)

    threads = [threading.Thread(target=work, args=(2.0**i,)) for i in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert wrong == []


class Raced(Compiled):
    """A function of which another thread calls the code of other shapes whenever this one has chosen its own."""

    _last = property(lambda self: lambda *arguments: None, lambda self, call: None)


def test_a_thread_calls_the_code_of_its_own_shapes_whatever_another_thread_calls(monkeypatch):
    monkeypatch.delattr(Compiled, "_by_xla")
    raced = Raced(force_of, derive(Spring(), 0.0, Q, V), (), None)
    for t in (0.0, 1.0):
        np.testing.assert_array_equal(raced.call(t, Q, V), -2.0 * Q + t * V)


def test_small_systems_take_the_native_route_and_the_record_says_so():
    dynamics = derive(Spring(), 0.0, Q, V)
    compile_function(force_of, dynamics)(0.0, Q, V)
    (choice,) = routes(dynamics)
    assert (choice.function, choice.route) == ("force_of", "native")
    assert choice.operations == 6, "two products and a difference for each coordinate"


def test_an_unknown_primitive_falls_back_with_its_line():
    dynamics = derive(Searching(), 0.0, Q, V)
    value = compile_function(force_of, dynamics)(0.0, Q, V)
    np.testing.assert_allclose(value, -Q / 32)
    (choice,) = routes(dynamics)
    assert choice.route == "xla"
    assert "while" in choice.reason
    assert "test_native_calls.py" in choice.reason


def test_large_systems_are_left_to_xla():
    q = np.ones(300)
    dynamics = derive(Spring(), 0.0, q, q)
    compile_function(force_of, dynamics)(0.0, q, q)
    assert "n + m + p = 300" in routes(dynamics)[0].reason


def test_xla_can_be_asked_for():
    dynamics = derive(Spring(k=7.0), 0.0, Q, V)
    by_xla = compile_function(force_of, dynamics, route="xla")(0.25, Q, V)
    np.testing.assert_allclose(compile_function(force_of, dynamics)(0.25, Q, V), by_xla, rtol=1e-15)
    assert [choice.route for choice in routes(dynamics)] == ["xla", "native"]


def test_plain_callables_are_called_as_they_are():
    dynamics = derive(NumpySystem(force=lambda t, q, v: -q), 0.0, Q, V)
    np.testing.assert_array_equal(compile_function(force_of, dynamics)(0.0, Q, V), -Q)
    assert routes(dynamics)[0].route == "numpy"


def test_complex_arguments_keep_their_imaginary_part():
    value = compile_function(matrix_of, derive(Spring(), 0.0, Q, V))(Q + 1e-30j * V, 1.0)
    np.testing.assert_allclose(value.imag[0, 1] / 1e-30, Q[0] * V[1] + Q[1] * V[0])


@pytest.mark.parametrize("order", ["float first", "int first"])
def test_a_whole_number_is_a_number_like_any_other(order):
    compiled = compile_function(matrix_of, derive(Spring(), 0.0, Q, V))
    scales = (2.0, 2) if order == "float first" else (2, 2.0)
    for scale in scales:
        np.testing.assert_array_equal(compiled(Q, scale), 2 * np.outer(Q, Q))


class Branching(System):
    k: Array = parameter(1.0, doc="stiffness [N/m]")

    def force(self, t, q, v):
        if q[0] > 0:
            return -q
        return q


class ByParameter(System):
    k: Array = parameter(1.0, doc="stiffness [N/m]")

    def force(self, t, q, v):
        return -q if self.k > 0 else q


class OfNumpy(System):
    def force(self, t, q, v):
        return jnp.asarray(np.sin(q))


class Counting(System):
    def force(self, t, q, v):
        return q * sum(range(q[0].astype(int)))


def branching_force(dynamics, t, q, v):
    return dynamics.force(t, q, v) if t > 0 else q


@pytest.mark.parametrize("route", [None, "xla"])
def test_python_control_flow_in_a_function_of_a_dynamics_is_explained(route):
    with pytest.raises(ProblemError, match=r"return dynamics\.force\(t, q, v\) if t > 0 else q"):
        compile_function(branching_force, derive(Spring(), 0.0, Q, V), route=route)(1.0, Q, V)


@pytest.mark.parametrize(
    ("system", "line"),
    [
        (Branching(), "if q[0] > 0:"),
        (ByParameter(), "return -q if self.k > 0 else q"),
        (OfNumpy(), "return jnp.asarray(np.sin(q))"),
        (Counting(), "return q * sum(range(q[0].astype(int)))"),
    ],
    ids=["if", "if on a parameter", "numpy", "range"],
)
@pytest.mark.parametrize("route", [None, "xla"])
def test_python_control_flow_is_explained_with_its_line(system, line, route):
    with pytest.raises(ProblemError) as caught:
        compile_function(force_of, derive(system, 0.0, Q, V), route=route)(0.0, Q, V)
    text = str(caught.value)
    for part in (type(system).__name__, "test_native_calls.py, line ", f"`{line}`", "jnp.where", "lax.cond", "NumpySystem"):
        assert part in text
    assert isinstance(caught.value.__cause__, jax.errors.JAXTypeError | jax.errors.JAXIndexError)


def test_a_function_of_one_dynamics_is_prepared_once():
    dynamics, other = derive(Spring(), 0.0, Q, V), derive(Spring(k=5.0), 0.0, Q, V)
    once = compile_function(force_of, dynamics)
    assert compile_function(force_of, dynamics) is once
    assert compile_function(force_of, dynamics, route="xla") is not once
    values = [compile_function(force_of, each)(0.5, Q, V) for each in (dynamics, other)]
    np.testing.assert_allclose(values, [-k * Q + 0.5 * V for k in (2.0, 5.0)], rtol=1e-15)
