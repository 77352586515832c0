"""Rows C1 to C15: functions that misbehave by what they return, change, store, raise or call."""

from __future__ import annotations

import gc
from collections.abc import Callable
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Lane
from hhtbench.conformance.rows.judging import Cases, apart, arrives, ends, refuses, row, same, within
from hhtbench.conformance.scenes.rod import FUNCTIONS, PLACES, mutating, plane, spoiled
from hhtbench.conformance.subject import MAX_SECONDS, Subject

STATUS = hb.Status
STOPS = STATUS.nonfinite_callback
WEIGHT = np.array([0.0, -9.81])


@row("C1", "NaN, inf in f, M, g, G at t0", "nonfinite_callback with function and component, < 1 s", seconds=1.0)
def from_the_start(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row C1: functions that are NaN or infinite from their first call on."""
    for name, place in PLACES.items():
        for bad in (np.nan, np.inf):
            found = subject.ask(spoiled(name, bad, lambda t, n: True), **request)
            yield f"{bad} in {name}", ends(found, STOPS, words=(f"{name}{place}",))


@row("C2", "NaN from t = 1 on", "reaches 0.9 <= t < 1, nonfinite_callback, <= 60 rejected steps, < 2 s", seconds=2.0)
def from_one_second_on(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row C2: functions that are NaN from t = 1 on; the last of 401 rows shows how far it came."""
    for name in PLACES:
        for count in (2, 401):
            system = spoiled(name, np.nan, lambda t, n: t >= 1.0)
            found = subject.ask(system, (0.0, 2.0), **request, t_eval=np.linspace(0.0, 2.0, count))
            fault = ends(found, STOPS, words=(name,))
            if not fault and count > 2 and not 0.9 <= found.t[-1] < 1.0:
                fault = f"the last row is at {found.t[-1]:.4g}"
            rejected = found.counters.steps_rejected_newton or 0
            yield f"{name}, {count} rows", fault or within(rejected, 60, "rejected steps")


@row("C3", "one NaN: call 5, call 50", "retried, result right to the tolerance, counted once")
def one_value(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row C3: a single NaN at call 5 or 50; the first calls only determine sizes."""
    right = subject.ask(plane(**FUNCTIONS), (0.0, 0.3), **request)
    for name in PLACES:
        for call in (5, 50):
            found = subject.ask(spoiled(name, np.nan, lambda t, n, call=call: n == call), (0.0, 0.3), **request)
            counted = found.counters.nonfinite_evaluations
            yield f"{name} call {call}", arrives(found) or within(apart(found, right), 1e-4)
            yield f"{name} call {call}, count", "" if counted in (1, None) else f"counted {counted}"


@row("C4", "force undefined outside the true motion", "result, error at most 1e-4")
def undefined_outside(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row C4: a force that is NaN outside a tube of 1e-3 around the true motion."""

    def force(t: float, q: Any, v: Any) -> Any:
        return WEIGHT * (1.0 if abs(q @ q - 1.0) < 1e-3 and q[1] < 0 else np.nan)

    finer = {**request, **({"step": 1e-3} if "step" in request else {})}
    right, found = (subject.ask(plane(**x), (0.0, 1.0), **finer) for x in ({}, {"force": force}))
    yield "", within(apart(found, right), 1e-4)


@row("C5", "NaN only in [1, 1.001]", "an end with its cause where a step lands in it; a step may pass over it")
def short_window(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row C5: a force that is NaN only for t in [1, 1.001], which a step may pass over."""
    short = request if "step" in request else {**request, "rtol": 1e-7}  # for steps to land there
    found = subject.ask(spoiled("force", np.nan, lambda t, n: 1 <= t <= 1.001), (0.0, 1.2), **short)
    landed = "step" in request or bool(np.any((found.t >= 1.0) & (found.t <= 1.001)))
    silent = "a step landed in it, and nothing is said" if found.success and landed else ""
    yield "", ends(found, STOPS, STATUS.success) or silent


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
def wrong_returns(subject: Subject) -> Cases:
    """Yield the cases of row C6: f, g, G, M return a scalar, None, (n, 1), n + 1, text, complex, object.

    A constraint may have any length, so a longer one is none of these.
    """
    for name in FUNCTIONS:
        for case, value in WRONG.items():
            if (name, case) != ("constraint", "longer"):
                system = plane(**{**FUNCTIONS, name: lambda *x, value=value: value})
                yield f"{name} {case}", refuses(partial(subject.ask, system, rtol=1e-4), name)


@row("C7", "f returns float32, whole numbers, list, tuple, JAX array", "accepted, converted: the same bits")
def converted(subject: Subject) -> Cases:
    """Yield the cases of row C7: f returns float32, whole numbers, list, tuple, JAX array.

    A force that each of them holds exactly.
    """
    force = np.array([0.0, -10.0])
    right = subject.ask(plane(force=lambda t, q, v: force), rtol=1e-4)
    kinds: dict[str, Any] = {
        "float32": lambda: force.astype(np.float32),
        "int": lambda: force.astype(int),
        "list": force.tolist,
        "tuple": lambda: tuple(force.tolist()),
        "jax": lambda: jnp.asarray(force),
    }
    for case, kind in kinds.items():
        found = subject.ask(plane(force=lambda t, q, v, kind=kind: kind()), rtol=1e-4)
        yield case, arrives(found) or same(found, right)


@row("C8", "a function that changes q or v in place", "ValueError: arguments are read-only; the solver's state unchanged")
def changes_in_place(subject: Subject) -> Cases:
    """Yield the cases of row C8: a force that writes into q or v, also by setting the writeable flag."""

    def forced(t: float, q: Any, v: Any) -> Any:
        for x in (q, v):
            x.setflags(write=True)
            x[:] = np.nan
        return WEIGHT

    for k in (0, 1):
        yield "qv"[k], refuses(partial(subject.ask, mutating(k), rtol=1e-4), "read-only")
    yield "forced", same(subject.ask(plane(), rtol=1e-4), subject.ask(plane(force=forced), rtol=1e-4))


@row("C9", "one buffer reused for every return; a view of the argument", "bitwise as with fresh arrays")
def buffers(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row C9: one buffer reused for every return, or a view of the argument (SciPy's BDF fails)."""
    kept = {"force": np.empty(2), "constraint": np.empty(1), "constraint_jacobian": np.empty((1, 2))}

    def fill(name: str) -> Callable[..., Any]:
        def function(*arguments: Any) -> Any:
            kept[name][:] = FUNCTIONS[name](*arguments)
            return kept[name]

        return function

    view = plane(force=lambda t, q, v: v, constraint_jacobian=lambda t, q: q[None, :])
    fresh = plane(force=lambda t, q, v: v.copy(), constraint_jacobian=lambda t, q: q[None, :].copy())
    for case, pair in {"buffer": (plane(**{x: fill(x) for x in kept}), plane()), "view": (view, fresh)}.items():
        yield case, same(*(subject.ask(x, **request) for x in pair))


@row("C10", "a function keeps its arguments and reads them after the solve", "values as at the call")
def kept_arguments(subject: Subject) -> Cases:
    """Yield the cases of row C10: a force that stores its arguments; they must be unchanged after the solve."""
    kept: list[Any] = []

    def force(t: float, q: Any, v: Any) -> Any:
        kept.append((q, q.copy(), v, v.copy()))
        return WEIGHT

    subject.ask(plane(force=force), rtol=1e-6)
    gc.collect()
    changed = sum(not (np.array_equal(q, q_then) and np.array_equal(v, v_then)) for q, q_then, v, v_then in kept)
    yield "values", within(changed, 0, "changed arguments:")
    yield "calls", "" if len(kept) >= 100 else f"{len(kept)} calls"


class Planned(Exception):
    """Raised by a function of a system on purpose."""


def _comes_back(subject: Subject, error: BaseException, name: str, since: float, request: dict[str, Any]) -> str:
    """Return the fault in how an exception of a system's function reaches the caller; "" if there is none."""
    try:
        found = subject.ask(spoiled(name, error, lambda t, n: t >= since), **request)
    except type(error) as caught:
        if caught is not error:
            return "another object"
        partial = getattr(caught, "partial_solution", None)
        late = since > 0 and (partial is None or not partial.t.size or partial.t[-1] > since)
        return "without what was integrated" if late else ""
    return ends(found, STATUS.user_exception, words=(type(error).__name__,))


@row("C11", "own exception of f, M, g, G at the first call, at t = 1", "it comes back, with the partial result")
def own_exceptions(subject: Subject, request: dict[str, Any]) -> Cases:
    """Yield the cases of row C11: own exceptions of f, M, g, G at the first call or at t = 1.

    Exceptions of events are tested in tests/hht/test_event_failures.py.
    """
    for name in PLACES:
        for since in (-1.0, 1.0):
            yield f"{name} {since:g}", _comes_back(subject, Planned("own"), name, since, request)


@row("C12", "SystemExit, KeyboardInterrupt, MemoryError, RecursionError, ZeroDivisionError", "the same")
def exits(subject: Subject) -> Cases:
    """Yield the cases of row C12: SystemExit, KeyboardInterrupt and others raised by the force after a second."""
    errors = (SystemExit(3), KeyboardInterrupt(), MemoryError("own"), RecursionError("own"), ZeroDivisionError("own"))
    for error in errors:
        yield type(error).__name__, _comes_back(subject, error, "force", 1.0, {"rtol": 1e-4})


@row("C13", "solve called inside f", "inner and outer right")
def nested(subject: Subject) -> Cases:
    """Yield the cases of row C13: ``solve`` called once inside a force, half-way."""
    inner: list[hb.Solution] = []

    def force(t: float, q: Any, v: Any) -> Any:
        if t > 0.5 and not inner:
            inner.append(subject.ask(plane(), rtol=1e-4))
        return WEIGHT

    alone = subject.ask(plane(), rtol=1e-4)
    yield "outer", same(subject.ask(plane(force=force), rtol=1e-4), alone)
    yield "inner", same(inner[0], alone)


@row("C14", "noise in f, in g, at rtol 1e-8", "step_too_small that names the function, < 5 s", seconds=5.0, lane=Lane.slow)
def noise(subject: Subject) -> Cases:
    """Yield the cases of row C14: random noise in f or g at rtol 1e-8.

    The row's own time limit is no valid end; only HHT must name the function.
    """
    random = np.random.default_rng(3)
    noisy: dict[str, Any] = {
        "force": lambda t, q, v: WEIGHT * (1 + 1e-6 * random.standard_normal()),
        "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2.0 + 1e-9 * random.standard_normal()]),
    }
    for name, function in noisy.items():
        system = plane(**{name: function}, constraint_time_derivative=lambda t, q: np.zeros(1))
        found = subject.ask(system, rtol=1e-8, max_num_steps=100_000)
        words = (f"Calls of {name} with",) if subject.is_hht else ()
        yield name, ends(found, STATUS.step_too_small, STATUS.max_steps, words=words)


BOUNDED = STATUS.success, STATUS.step_too_small, STATUS.newton_failed, STATUS.max_steps, STATUS.unreliable


@row("C15", "f depends on the count of its calls, at most 1e5 steps", "ends by itself", seconds=MAX_SECONDS, lane=Lane.slow)
def no_function(subject: Subject) -> Cases:
    """Yield the case of row C15: a force whose every second value is larger by a tenth."""
    count = [0]

    def force(t: float, q: Any, v: Any) -> Any:
        count[0] += 1
        return WEIGHT * (1 + 0.1 * (count[0] % 2))

    yield "ends by itself", ends(subject.ask(plane(force=force), rtol=1e-4, max_num_steps=100_000), *BOUNDED)
