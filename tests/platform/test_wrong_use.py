"""Mistakes of a first hour: the message names what is wrong and what to write."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb

START = {"t_span": (0.0, 1.0), "q0": [0.0, 0.0], "v0": [0.0, 0.0]}


class Fall(hb.System):
    def force(self, t, q, v):
        return jnp.array([0.0, -9.81])


def problem(system=None, **changes):
    return hb.Problem(**({"name": "fall", "system": system or Fall(), **START} | changes))


class Listed(hb.System):
    def force(self, t, q, v):
        return [0.0, -9.81]


def unannotated():
    class Spring(hb.System):
        k = hb.parameter(3.0)


def other_order():
    class Damped(hb.System):
        def force(self, q, v, t):
            return -v


def assigned():
    class Spring(Fall):
        def __init__(self, k):
            self.k = k

    return Spring(3.0)


def swapped(q, v):
    return np.zeros(2)


@pytest.mark.parametrize(
    ("mistake", "text"),
    [
        (lambda: hb.solve(problem(hb.NumpySystem(force=swapped))), r"force must take the arguments \(t, q, v\), .*\(q, v\)"),
        (lambda: hb.solve(problem(), events=lambda t, q: q[1]), r"events\[0\] must take the arguments \(t, q, v\)"),
        (lambda: hb.solve(problem(scales=hb.Scales(q=[1.0, 2.0, 3.0]))), r"scales.q must be a number or have shape \(2,\)"),
        (lambda: problem(scales={"q": 1.0}), r"scales must be a hhtbench.Scales"),
        (lambda: problem(Fall), r"system must be an object, not the class Fall; write system=Fall\(\)"),
        (lambda: hb.solve(Fall()), r"got the system Fall. It needs a start and an interval"),
        (
            lambda: hb.solve(problem(), "ida", method="bdf"),
            r"An option of a solver is a part of its name: 'hht\(alpha=-0.1\)'",
        ),
        (lambda: hb.solve(problem(Listed())), r"force must return one real array; got list. Make it one by jnp.stack"),
        (lambda: hb.solve(problem(), rtol=1e-4).position, r"a Solution has no 'position'; it has .*\bt, q, v\b"),
        (unannotated, r"Spring: k has no type annotation; write `k: object = hb.parameter\(...\)`"),
        (other_order, r"Damped: force must take the arguments \(t, q, v\), in this order; it is declared with \(q, v, t\)"),
        (lambda: hb.NumpySystem(force=lambda v, q, t: v), r"force must take the arguments \(t, q, v\), .*\(v, q, t\)"),
        (assigned, r"Spring: cannot assign to k: it is no field; write `k: object = hb.parameter\(\)`"),
        (lambda: hb.solve(problem(), rtol="1e-6"), r"got the text '1e-6'. Write numbers without quotes"),
    ],
)
def test_the_message_leads_to_the_mend(mistake, text):
    with pytest.raises((TypeError, ValueError, AttributeError), match=text):
        mistake()


def test_an_exception_of_a_users_function_stays_itself():
    error = TypeError("of the user")

    def raising(t, q, v):
        raise error

    with pytest.raises(TypeError) as caught:
        hb.solve(problem(hb.NumpySystem(force=raising)))
    assert caught.value is error


@pytest.mark.filterwarnings("error")
def test_a_wrong_derivative_is_told_once():
    """No hint to declare the Jacobian that is declared, wrong, and not used."""
    functions = {"force": lambda t, q, v: np.array([0.0, -9.81]), "constraint": lambda t, q: np.array([q @ q / 2 - 0.5])}
    system = hb.NumpySystem(**functions, constraint_jacobian=lambda t, q: -q[None, :])
    with pytest.warns(UserWarning, match="the declared constraint_jacobian disagrees"):
        solution = hb.solve(problem(system, q0=[1.0, 0.0]), rtol=1e-4)
    assert "declare" not in solution.message
