"""Functions of the system that misbehave by what they return (rows C1 to C7)."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.studies.acceptance.asked import Asked
from hhtbench.studies.acceptance.rows import Finding, bounded, every, row
from hhtbench.studies.acceptance.scenes import Q0, V0, apart, ends, plane, problem, refuses, same

FUNCTIONS: dict[str, Callable[..., Any]] = {
    "force": lambda t, q, v: np.array([0.0, -9.81]),
    "mass_matrix": lambda t, q: np.eye(2),
    "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2.0]),
    "constraint_jacobian": lambda t, q: np.array([[q[0], q[1]]]),
}
PLACES = {"force": "[1]", "mass_matrix": "[1, 1]", "constraint": "[0]", "constraint_jacobian": "[0, 1]"}
STOPS = hb.Status.nonfinite_callback


def spoiled(name: str, bad: float, when: Callable[[float, int], bool]) -> hb.NumpySystem:
    """The plane pendulum whose function ``name`` holds ``bad`` where ``when(t, number of the call)``."""
    calls = [0]

    def function(t: float, *arguments: Any) -> Any:
        calls[0] += 1
        value = FUNCTIONS[name](t, *arguments)
        if when(t, calls[0]):
            value[(-1,) * value.ndim] = bad
        return value

    return plane(**{**FUNCTIONS, name: function})


@row("C1", "NaN, inf in f, M, g, G at t0", "nonfinite_callback with function and component, < 1 s")
def from_the_start(asked: Asked) -> Finding:
    """The slowest as well."""
    faults, slowest = {}, 0.0
    for name, place in PLACES.items():
        for bad in (np.nan, np.inf):
            for way, request in asked.ways().items():
                began = time.perf_counter()
                found = asked.solve(problem(spoiled(name, bad, lambda t, n: True), Q0, V0), **request)
                slowest = max(slowest, time.perf_counter() - began)
                faults[f"{bad} in {name} {way}"] = ends(found, STOPS, words=(f"{name}{place}",))
    return every(faults, f"slowest {slowest:.2g} s", in_time=slowest < 1)


@row(
    "C2",
    "NaN from t = 1 on, output at 2 and at 401 times",
    "reaches 0.9 <= t < 1, nonfinite_callback, <= 60 rejected, < 2 s",
)
def from_one_second_on(asked: Asked) -> Finding:
    """The last row of 401 tells how far it came."""
    faults, slowest = {}, 0.0
    for name in PLACES:
        for way, request in asked.ways().items():
            for count in (2, 401):
                began = time.perf_counter()
                given = problem(spoiled(name, np.nan, lambda t, n: t >= 1.0), Q0, V0, (0.0, 2.0))
                found = asked.solve(given, **request, t_eval=np.linspace(0.0, 2.0, count))
                slowest = max(slowest, time.perf_counter() - began)
                fault = ends(found, STOPS, words=(name,))
                if not fault and count > 2 and not 0.9 <= found.t[-1] < 1.0:
                    fault = f"the last row is at {found.t[-1]:.4g}"
                if not fault and (found.counters.steps_rejected_newton or 0) > 60:
                    fault = f"{found.counters.steps_rejected_newton} rejected steps"
                faults[f"{name} {way} {count} rows"] = fault
    return every(faults, f"slowest {slowest:.2g} s", in_time=slowest < 2)


def _at_call(call: int, t: float, count: int) -> bool:
    return count == call


@row("C3", "one NaN: call 5, call 50", "retried, result right to the tolerance, counted once")
def one_value(asked: Asked) -> Finding:
    """The first calls read sizes."""
    faults = {}
    for way, request in asked.ways().items():
        right = asked.solve(problem(plane(**FUNCTIONS), Q0, V0, (0.0, 0.3)), **request)
        for name in PLACES:
            for call in (5, 50):
                found = asked.solve(problem(spoiled(name, np.nan, partial(_at_call, call)), Q0, V0, (0.0, 0.3)), **request)
                difference, counted = apart(found, right), found.counters.nonfinite_evaluations
                fault = "" if found.success else f"{found.status.label}: {found.message[:60]}"
                if not fault and difference > 1e-4:
                    fault = f"off by {difference:.1e}"
                if not fault and counted not in (1, None):
                    fault = f"counted {counted}"
                faults[f"{name} call {call} {way}"] = fault
    return every(faults)


@row("C4", "force undefined outside the true motion", "result, error at most 1e-4")
def undefined_outside(asked: Asked) -> Finding:
    """A tube of 1e-3 about the circle."""

    def force(t: float, q: Any, v: Any) -> Any:
        return np.array([0.0, -9.81 if abs(q @ q - 1.0) < 1e-3 and q[1] < 0 else np.nan])

    worst = 0.0
    for request in asked.ways().values():
        finer = {**request, **({"step": 1e-3} if "step" in request else {})}
        right = asked.solve(problem(plane(), Q0, V0, (0.0, 1.0)), **finer)
        worst = max(worst, apart(asked.solve(problem(plane(force=force), Q0, V0, (0.0, 1.0)), **finer), right))
    return bounded(worst, 1e-4, "off by")


@row("C5", "NaN only in [1, 1.001]", "an end with its cause where a step lands in it; a step may pass over it")
def short_window(asked: Asked) -> Finding:
    """Documented at HHT's class."""
    faults = {}
    for way, request in asked.ways().items():
        short = request if "step" in request else {**request, "rtol": 1e-7}  # for steps to land there
        found = asked.solve(problem(spoiled("force", np.nan, lambda t, n: 1 <= t <= 1.001), Q0, V0, (0.0, 1.2)), **short)
        faults[way] = ends(found, STOPS, hb.Status.success)
        landed = "step" in request or bool(np.any((found.t >= 1.0) & (found.t <= 1.001)))
        if found.success and landed:
            faults[way] = "a step landed in it, and nothing is said"
    return every(faults)


WRONG: dict[str, Any] = {
    "scalar": 1.0,
    "None": None,
    "column": np.zeros((2, 1)),
    "longer": np.zeros(3),
    "text": "ab",
    "complex": np.zeros(2, complex),
    "object": np.array([object(), object()]),
    "masked": np.ma.masked_array([1.0, 2.0], [True, False]),
}


@row("C6", "f, g, G, M return a scalar, None, (n, 1), n + 1, text, complex, object", "refused by name, nothing broadcast")
def wrong_returns(asked: Asked) -> Finding:
    """A constraint may have any length, so a longer one is none of these."""
    faults = {}
    for name in FUNCTIONS:
        for case, value in WRONG.items():
            if (name, case) != ("constraint", "longer"):
                given = problem(plane(**{**FUNCTIONS, name: lambda *x, value=value: value}), Q0, V0)
                faults[f"{name} {case}"] = refuses(partial(asked.solve, given, rtol=1e-4), name)
    return every(faults)


@row("C7", "f returns float32, whole numbers, list, tuple, JAX array", "accepted, converted: the same bits")
def converted(asked: Asked) -> Finding:
    """A force that each of them holds exactly."""
    force, faults = np.array([0.0, -10.0]), {}
    right = asked.solve(problem(plane(force=lambda t, q, v: force), Q0, V0), rtol=1e-4)
    kinds: dict[str, Any] = {
        "float32": lambda: force.astype(np.float32),
        "int": lambda: force.astype(int),
        "list": force.tolist,
        "tuple": lambda: tuple(force.tolist()),
        "jax": lambda: jnp.asarray(force),
    }
    for case, kind in kinds.items():
        found = asked.solve(problem(plane(force=lambda t, q, v, kind=kind: kind()), Q0, V0), rtol=1e-4)
        faults[case] = "" if same(found, right) else ends(found, hb.Status.success) or "other bits"
    return every(faults)
