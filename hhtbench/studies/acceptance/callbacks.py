"""Functions of the system that misbehave (rows C1 to C15)."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.studies.acceptance.asked import SECONDS, Asked
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


class Planned(Exception):
    """Raised by a function of a system on purpose."""


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
        found = asked.solve(problem(spoiled("force", np.nan, lambda t, n: 1 <= t <= 1.001), Q0, V0, (0.0, 1.2)), **request)
        faults[way] = ends(found, STOPS, hb.Status.success)
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


def _spoil(which: int) -> Callable[..., Any]:
    def force(t: float, *state: Any) -> Any:
        state[which][0] = 7.0
        return np.array([0.0, -9.81])

    return force


@row("C8", "a function that changes q or v in place", "ValueError: arguments are read-only; the solver's state unchanged")
def mutating(asked: Asked) -> Finding:
    """Forced through the flag it does not reach the solver either."""

    def forced(t: float, q: Any, v: Any) -> Any:
        for x in (q, v):
            x.setflags(write=True)
            x[:] = np.nan
        return np.array([0.0, -9.81])

    right, found = (asked.solve(problem(plane(**x), Q0, V0), rtol=1e-4) for x in ({}, {"force": forced}))
    faults = {
        f"{'qv'[k]}": refuses(partial(asked.solve, problem(plane(force=_spoil(k)), Q0, V0), rtol=1e-4), "read-only")
        for k in (0, 1)
    }
    return every(faults | {"forced": "" if same(right, found) else "reaches the solver"})


@row("C9", "one buffer reused for every return; a view of the argument", "bitwise as with fresh arrays")
def buffers(asked: Asked) -> Finding:
    """SciPy's BDF alone is wrong by 4e2 there."""
    shapes = {"force": 2, "constraint": 1, "constraint_jacobian": (1, 2)}
    kept = {name: np.empty(shape) for name, shape in shapes.items()}

    def fill(name: str) -> Callable[..., Any]:
        def function(*arguments: Any) -> Any:
            kept[name][:] = FUNCTIONS[name](*arguments)
            return kept[name]

        return function

    view = plane(force=lambda t, q, v: v, constraint_jacobian=lambda t, q: q[None, :])
    fresh = plane(force=lambda t, q, v: v.copy(), constraint_jacobian=lambda t, q: q[None, :].copy())
    faults = {}
    for way, request in asked.ways().items():
        for case, (one, other) in {"buffer": (plane(**{x: fill(x) for x in kept}), plane()), "view": (view, fresh)}.items():
            a, b = (asked.solve(problem(x, Q0, V0), **request) for x in (one, other))
            faults[f"{case} {way}"] = "" if same(a, b) else f"differs by {apart(a, b):.1e}"
    return every(faults)


@row("C10", "a function keeps its arguments and reads them after the solve", "values as at the call")
def kept_arguments(asked: Asked) -> Finding:
    """After garbage collection."""
    kept: list[Any] = []

    def force(t: float, q: Any, v: Any) -> Any:
        kept.append((q, q.copy(), v, v.copy()))
        return np.array([0.0, -9.81])

    asked.solve(problem(plane(force=force), Q0, V0), rtol=1e-6)
    gc.collect()
    changed = sum(not (np.array_equal(q, q_then) and np.array_equal(v, v_then)) for q, q_then, v, v_then in kept)
    return Finding(measured=f"{changed} of {len(kept)} changed", holds=not changed and len(kept) >= 100)


def raising(error: BaseException, name: str, since: float) -> hb.NumpySystem:
    """The plane pendulum whose function ``name`` raises from the time ``since`` on."""

    def function(t: float, *arguments: Any) -> Any:
        if t >= since:
            raise error
        return FUNCTIONS[name](t, *arguments)

    return plane(**{**FUNCTIONS, name: function})


def _comes_back(asked: Asked, error: BaseException, name: str, since: float, request: dict[str, Any]) -> str:
    try:
        found = asked.solve(problem(raising(error, name, since), Q0, V0), **request)
    except type(error) as caught:
        if caught is not error:
            return "another object"
        partial = getattr(caught, "partial_solution", None)
        late = since > 0 and (partial is None or not partial.t.size or partial.t[-1] > since)
        return "without what was integrated" if late else ""
    known = found.status is hb.Status.user_exception and type(error).__name__ in found.message
    return "" if known else f"swallowed: {found.status.label}"


@row(
    "C11",
    "own exception at the first call, from t = 1 on; in f, M, g, G",
    "the same object reaches the caller, with the partial result",
)
def own_exceptions(asked: Asked) -> Finding:
    """Those of events: tests/hht/test_event_failures.py."""
    cases = [(name, since, way) for name in PLACES for since in (-1.0, 1.0) for way in asked.ways()]
    return every({f"{n} {s:g} {way}": _comes_back(asked, Planned("own"), n, s, asked.ways()[way]) for n, s, way in cases})


@row("C12", "SystemExit, KeyboardInterrupt, MemoryError, RecursionError", "the same")
def exits(asked: Asked) -> Finding:
    """An interrupt may be the status interrupted."""
    errors: list[BaseException] = [SystemExit(3), KeyboardInterrupt(), MemoryError("own"), RecursionError("own")]
    return every({type(x).__name__: _comes_back(asked, x, "force", 1.0, {"rtol": 1e-4}) for x in errors})


@row("C13", "solve called inside f", "inner and outer right")
def nested(asked: Asked) -> Finding:
    """Once, half-way."""
    inner: list[hb.Solution] = []

    def force(t: float, q: Any, v: Any) -> Any:
        if t > 0.5 and not inner:
            inner.append(asked.solve(problem(plane(), Q0, V0), rtol=1e-4))
        return np.array([0.0, -9.81])

    alone = asked.solve(problem(plane(), Q0, V0), rtol=1e-4)
    outer = asked.solve(problem(plane(force=force), Q0, V0), rtol=1e-4)
    return Finding(
        measured=f"outer {apart(outer, alone):.1e}, inner {apart(inner[0], alone):.1e} off",
        holds=same(outer, alone) and same(inner[0], alone),
    )


@row("C14", "noise of 1e-6 in f at rtol 1e-8, at most 1e5 steps", "step_too_small or max_steps, < 5 s", long=True)
def noise(asked: Asked) -> Finding:
    """The time that the row allows itself is no end of the solver's."""
    random = np.random.default_rng(3)
    system = plane(force=lambda t, q, v: np.array([0.0, -9.81 * (1 + 1e-6 * random.standard_normal())]))
    return _ends_in_time(asked, system, 1e-8, 5.0, (hb.Status.step_too_small, hb.Status.max_steps))


@row("C15", "f depends on the count of its calls, at most 1e5 steps", "ends by itself", long=True)
def no_function(asked: Asked) -> Finding:
    """Every second value is larger by a tenth; the study's own deadline is no end of the solver's."""
    count = [0]

    def force(t: float, q: Any, v: Any) -> Any:
        count[0] += 1
        return np.array([0.0, -9.81 * (1 + 0.1 * (count[0] % 2))])

    bounded = hb.Status.success, hb.Status.step_too_small, hb.Status.newton_failed, hb.Status.max_steps, hb.Status.unreliable
    return _ends_in_time(asked, plane(force=force), 1e-4, SECONDS, bounded)


def _ends_in_time(asked: Asked, system: Any, rtol: float, limit: float, statuses: tuple[hb.Status, ...]) -> Finding:
    began = time.perf_counter()
    found = asked.solve(problem(system, Q0, V0), rtol=rtol, max_num_steps=100_000)
    seconds = time.perf_counter() - began
    fault = ends(found, *statuses)
    return Finding(
        measured=f"{fault or found.status.label} after {seconds:.2g} s, {found.counters.steps_accepted} steps",
        failing=("ends by itself",) if fault else (),
        holds=not fault,
        in_time=seconds < limit,
    )
