"""Calls, time and memory of one scene's steps: differences of a longer and a shorter run, so that no start is in them."""

from __future__ import annotations

import gc
import sys
import time
import tracemalloc
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import numpy as np

import hhtbench as hb
from hhtbench.conformance.parts.scenes import H, Scene
from hhtbench.lowering.dynamics.foreign import FUNCTIONS
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import SIGNATURES, NumpySystem, declared

COUNTED = 20  # steps of the shorter of two runs whose calls are counted
TIMED, START = 40_000, 2  # steps of runs that are timed: the latter is hardly more than a start
BY_HAND = 50, 400  # steps by hand before, and those while what stays behind is measured
ENDS = (hb.Status.success, hb.Status.max_steps)  # of runs that are measured


@dataclass(frozen=True)
class Cost:
    """What a scene costs."""

    calls: Mapping[str, float]  #: a step, by name: of functions that are declared and of terms that are derived from them
    once: Mapping[str, float]  #: the same of start and end together
    seconds: float  #: of processor time a step, in machine code
    memory: int  #: bytes of the arrays that the loop works in
    operations: int  #: arithmetic of all functions of a step in machine code
    python: float  #: calls of functions, Python's own too, a step: whatever Python allocates, one of these does
    left: float  #: bytes that a step by hand leaves behind, where no rows are kept


def height(t: Any, q: Any, v: Any) -> Any:
    """Of the event that is looked for, [m]: it is never met, so that what looking costs is measured."""
    return q[2] - 100.0


def run(scene: Scene, steps: int, *, system: Any = None, event: Callable[..., Any] = height, **options: Any) -> hb.Solution:
    """``steps`` steps of the scene.

    Raises
    ------
    ProblemError
        They were not made.
    """
    span, request = scene.request(steps)
    found = scene.integrator(event, system, **options).solve(span, scene.q0, scene.v0, **request)
    if found.status not in ENDS or found.counters.steps_accepted != steps:
        raise ProblemError(f"{type(scene.system).__name__}: {found.status.label}: {found.message}")
    return found


def calls_of(scene: Scene) -> tuple[dict[str, float], dict[str, float]]:
    """Calls by name of a system of plain callables that declares what the scene's does: a step, and of start and end."""
    counted(scene, 2)  # what is called once in a process
    short, long = counted(scene, COUNTED), counted(scene, 2 * COUNTED)
    step = {name: (long[name] - short[name]) / COUNTED for name in long}
    return step, {name: short[name] - COUNTED * step[name] for name in long}


def counted(scene: Scene, steps: int) -> Counter[str]:
    """Calls by name in one run of the scene in plain callables, with those of the terms that are derived from them."""
    calls: Counter[str] = Counter()

    def counting(name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        return lambda *arguments: (calls.update((name,)), function(*arguments))[1]

    functions = {name: counting(name, value) if callable(value) else value for name, value in plain(scene.system).items()}

    def derived(frame: Any, event: str, _: Any) -> None:
        name = frame.f_code.co_name
        if event == "call" and name in FUNCTIONS and name not in functions:
            calls[name] += isinstance(frame.f_locals.get("self"), NumpyDynamics)

    profiled(derived, run, scene, steps, system=NumpySystem(**functions), event=counting("event", height))
    return +calls


def profiled(profile: Any, function: Callable[..., Any], *arguments: Any, **options: Any) -> None:
    """Call ``function`` under a ``profile`` of :func:`sys.setprofile`."""
    before = sys.getprofile()
    sys.setprofile(profile)
    try:
        function(*arguments, **options)
    finally:
        sys.setprofile(before)


def plain(system: hb.System) -> dict[str, Any]:
    """What ``system`` declares, as functions that take and give NumPy's arrays."""

    def called(name: str) -> Callable[..., Any]:
        function = jax.jit(lambda *arguments: getattr(system, name)(*arguments))
        return lambda *arguments: np.array(function(*arguments))

    given = {name: declared(system, name) for name in SIGNATURES}
    return {name: called(name) if callable(value) else np.array(value) for name, value in given.items() if value is not None}


def seconds_of(actions: Mapping[str, Callable[[int], object]], rounds: int) -> dict[str, float]:
    """Processor time [s] a step of every action, which takes a number of steps: from the shortest of each length.

    In turn, so that all see the same machine.
    """
    found: dict[tuple[str, int], list[float]] = defaultdict(list)
    for action in actions.values():
        action(TIMED)
    for _ in range(rounds):
        for name, action in actions.items():
            for steps in (START, TIMED):
                began = time.process_time()
                action(steps)
                found[name, steps].append(time.process_time() - began)
    return {name: (min(found[name, TIMED]) - min(found[name, START])) / (TIMED - START) for name in actions}


def by_hand(scene: Scene) -> Any:
    """HHT at the start of the scene."""
    hht, accuracy = scene.integrator(height), {"rtol": 1e-4} if scene.controlled else {"step": H}
    hht.init_step(0.0, scene.q0, scene.v0, **accuracy)
    return hht


def memory_of(scene: Scene) -> int:
    """Bytes of the arrays that the loop works in."""
    z = by_hand(scene)._engine.loops.z
    return int(z.w.nbytes + z.i.nbytes)


def operations_of(scene: Scene) -> int:
    """Of all functions of a step in machine code."""
    return sum(code.operations for code in by_hand(scene)._engine.functions._codes.values())


def python_of(scene: Scene) -> float:
    """Calls of functions in Python, built-in ones too, by which a longer run in machine code has more a step."""
    return (_calls_in_python(scene, 2 * COUNTED) - _calls_in_python(scene, COUNTED)) / COUNTED


def _calls_in_python(scene: Scene, steps: int) -> int:
    """The least of three runs: what looks at a clock may be called once more."""
    counts = []
    for _ in range(3):
        events: Counter[str] = Counter()
        profiled(lambda frame, event, _, events=events: events.update((event,)), run, scene, steps)
        counts.append(events["call"] + events["c_call"])
    return min(counts)


def left_by(scene: Scene) -> float:
    """Bytes that a step by hand leaves behind."""
    hht, (before, steps) = by_hand(scene), BY_HAND

    def held(count: int) -> int:
        for _ in range(count):
            if (status := hht.step()) is not hb.Status.success:
                raise ProblemError(f"{type(scene.system).__name__}: {status.label}: {hht.message}")
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        first = held(before)
        return (held(steps) - first) / steps
    finally:
        tracemalloc.stop()


def costs_of(scenes: Mapping[str, Scene], rounds: int) -> dict[str, Cost]:
    """Of every scene; their times side by side."""
    seconds = seconds_of({name: partial(run, scene) for name, scene in scenes.items()}, rounds)
    return {
        name: Cost(*calls_of(scene), seconds[name], memory_of(scene), operations_of(scene), python_of(scene), left_by(scene))
        for name, scene in scenes.items()
    }


def own(calls: Mapping[str, float], terms: Collection[str]) -> float:
    """Calls of ``terms`` together."""
    return sum(calls.get(name, 0.0) for name in terms)
