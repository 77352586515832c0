"""Functions that change or keep their arguments, raise, solve, or are no functions (rows C8 to C15)."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.studies.acceptance.asked import SECONDS, Asked
from hhtbench.studies.acceptance.callbacks import FUNCTIONS, PLACES
from hhtbench.studies.acceptance.rows import Finding, every, row
from hhtbench.studies.acceptance.scenes import Q0, V0, apart, ends, plane, problem, refuses, same


class Planned(Exception):
    """Raised by a function of a system on purpose."""


def spoiling(which: int) -> Callable[..., Any]:
    """A force that changes q, 0, or v, 1, in place."""

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
        f"{'qv'[k]}": refuses(partial(asked.solve, problem(plane(force=spoiling(k)), Q0, V0), rtol=1e-4), "read-only")
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


@row(
    "C14",
    "noise of 1e-6 in f, then of 1e-9 in g, at rtol 1e-8, at most 1e5 steps",
    "step_too_small that names the function, or max_steps, < 5 s",
    long=True,
)
def noise(asked: Asked) -> Finding:
    """The time that the row allows itself is no end of the solver's; only HHT is asked for the name."""
    random, faults, slowest = np.random.default_rng(3), {}, 0.0
    noisy: dict[str, Any] = {
        "force": lambda t, q, v: np.array([0.0, -9.81 * (1 + 1e-6 * random.standard_normal())]),
        "constraint": lambda t, q: np.array([(q @ q - 1.0) / 2.0 + 1e-9 * random.standard_normal()]),
    }
    for name, function in noisy.items():
        began = time.perf_counter()
        system = plane(**{name: function}, constraint_time_derivative=lambda t, q: np.zeros(1))
        found = asked.solve(problem(system, Q0, V0), rtol=1e-8, max_num_steps=100_000)
        slowest = max(slowest, time.perf_counter() - began)
        words = (f"Calls of {name} with",) if asked.is_hht else ()
        faults[name] = ends(found, hb.Status.step_too_small, hb.Status.max_steps, words=words)
    return every(faults, f"slowest {slowest:.2g} s", in_time=slowest < 5.0)


@row("C15", "f depends on the count of its calls, at most 1e5 steps", "ends by itself", long=True)
def no_function(asked: Asked) -> Finding:
    """Every second value is larger by a tenth; the study's own deadline is no end of the solver's."""
    count = [0]

    def force(t: float, q: Any, v: Any) -> Any:
        count[0] += 1
        return np.array([0.0, -9.81 * (1 + 0.1 * (count[0] % 2))])

    bounded = hb.Status.success, hb.Status.step_too_small, hb.Status.newton_failed, hb.Status.max_steps, hb.Status.unreliable
    began = time.perf_counter()
    found = asked.solve(problem(plane(force=force), Q0, V0), rtol=1e-4, max_num_steps=100_000)
    seconds = time.perf_counter() - began
    fault = ends(found, *bounded)
    return Finding(
        measured=f"{fault or found.status.label} after {seconds:.2g} s, {found.counters.steps_accepted} steps",
        failing=("ends by itself",) if fault else (),
        holds=not fault,
        in_time=seconds < SECONDS,
    )
