"""What a scene does not require costs nothing: no calls, no memory; reductions do not change the answer."""

from __future__ import annotations

import gc
import sys
import tracemalloc
from collections import Counter
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering import REDUCTIONS as SWITCHES
from hhtbench.lowering.description import describe
from hhtbench.protocol.system import SIGNATURES, declared
from solvers.kernel import memory as mem

H, SAME = 0.01, 1e-12
Q0, V0 = np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.5, 0.0])


class Spring(hb.System):
    """A unit mass that falls on a spring which stiffens: a force and nothing else."""

    def force(self, t, q, v):
        return jnp.array([0.0, 0.0, -9.81]) - (1.0 + q @ q) * q


class Chain(hb.System):
    """Points on a line between springs that stiffen, the first two of them held on a circle."""

    mass_matrix: Any = hb.parameter(1.0)

    def force(self, t, q, v):
        stretch, end = jnp.diff(q), jnp.zeros(1)
        return jnp.concatenate([stretch, end]) - jnp.concatenate([end, stretch]) - q - q**3

    def constraint(self, t, q):
        return jnp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2.0])


def spring(**functions):
    """The point with further functions of ``(self, t, q, ...)``."""
    return type("Spring", (Spring,), functions)()


FREE = spring()
SPHERE = spring(constraint=lambda self, t, q: jnp.stack([(q @ q - 1.0) / 2.0]))
SKATE = spring(velocity_constraint=lambda self, t, q, v: jnp.stack([v[2] - 0.2 * q[1] * v[0]]))
CONSTANT_MASS = spring(mass_matrix=np.array([[2.0, 0.3, 0.0], [0.3, 1.0, 0.1], [0.0, 0.1, 1.5]]))
VARIABLE_MASS = spring(mass_matrix=lambda self, t, q: jnp.diag(1.0 + 0.3 * q**2))
MEASURED = spring(
    energy=lambda self, t, q, v: v @ v / 2,
    power=lambda self, t, q, v, lam, mu: jnp.zeros(()),
    invariants=lambda self, t, q, v: {"about the vertical": q[0] * v[1] - q[1] * v[0]},
)


def height(t, q, v):
    return q[2] - 100.0


PARTS = {  # without the part, with it, its function, and the sections of the loops' memory that it alone needs
    "g": (FREE, SPHERE, "constraint", (mem.LAM, mem.LEVELS, mem.ROW_SIZES)),
    "k": (FREE, SKATE, "velocity_constraint", (mem.MU, mem.LEVELS, mem.ROW_SIZES)),
    "mass": (CONSTANT_MASS, VARIABLE_MASS, "mass_matrix", (mem.INVERSE_MASS, mem.END_INVERSE_MASS)),
    "events": (FREE, FREE, "event", (mem.EVENT_VALUES, mem.SAMPLE_TIMES, mem.SAMPLE_VALUES)),
}


def counted(system, event=None):
    """Calls by name in three steps of a system of plain functions that declares what ``system`` does."""
    calls = Counter()

    def counting(name, function):
        return lambda *arguments: (calls.update((name,)), np.array(function(*arguments)))[1]

    given = {name: declared(system, name) for name in SIGNATURES}
    functions = {
        name: counting(name, jax.jit(value)) if callable(value) else np.array(value)
        for name, value in given.items()
        if value is not None
    }
    events = None if event is None else [hb.Event(counting("event", event))]
    hht = hb.HHT(hb.NumpySystem(**functions), events=events)
    assert hht.solve((0.0, 3 * H), Q0, V0, steps=3).success
    return calls


def start_of(system):
    """q0, v0 of a point, or of a chain of as many points as its mass matrix has, or sixty."""
    if not isinstance(system, Chain):
        return Q0, V0
    n = len(system.mass_matrix) if np.ndim(system.mass_matrix) else 60
    return np.append(1.0, np.zeros(n - 1)), np.concatenate([[0.0, 0.5], 0.1 * np.cos(np.arange(n - 2))])


def begun(system, event=None, **options):
    hht = hb.HHT(system, events=None if event is None else [hb.Event(event)], **options)
    hht.init_step(0.0, *start_of(system), step=H)
    return hht


@pytest.mark.parametrize("system", [FREE, MEASURED], ids=["force alone", "with what is only measured"])
def test_a_scene_of_a_force_calls_nothing_else(system):
    assert counted(system).keys() == {"force"}


@pytest.mark.parametrize("name", PARTS)
def test_a_part_that_is_there_is_called_and_one_that_is_absent_has_no_place_in_the_memory(name):
    absent, present, function, sections = PARTS[name]
    event = height if name == "events" else None
    assert counted(present, event)[function] > counted(absent)[function]

    def lengths(system, event):
        return [mem.view(begun(system, event)._engine.loops.z, section).size for section in sections]

    assert lengths(absent, None) == [0] * len(sections)
    assert all(lengths(present, event))


def test_of_a_pendulum_no_part_is_called_that_it_has_not():
    assert counted(SPHERE).keys() == {"force", "constraint"}


MASS = np.eye(6) + 0.1 / (1.0 + np.abs(np.subtract.outer(np.arange(6), np.arange(6))))
UNEVEN = H * np.tile([1.2, 0.8], 100)
REDUCTIONS = {  # the option of HHT that does without it: a scene, and lengths of steps
    "without=mass": ({"without": "mass"}, Chain(mass_matrix=MASS), 200),
    "without=reaction": ({"without": "reaction"}, SPHERE, 200),
    "without=zeros": ({"without": "zeros"}, Chain(), 200),
    "linsolver=dense": ({"linsolver": "dense"}, Chain(), UNEVEN),
    "linsolver=dense, few unknowns": ({"linsolver": "dense"}, SPHERE, UNEVEN),
}


@pytest.mark.parametrize("name", REDUCTIONS)
def test_without_a_reduction_the_answer_is_the_same_and_describe_names_the_switch(name):
    option, system, steps = REDUCTIONS[name]
    q0, v0 = start_of(system)
    times = H * (np.arange(200) + 0.5)
    one, other = (hb.HHT(system, **x).solve((0.0, 2.0), q0, v0, steps=steps, t_eval=times) for x in ({}, option))
    for part in ("q", "v", "lam"):
        x, y = getattr(one, part), getattr(other, part)
        assert np.abs(x - y).max(initial=0.0) <= SAME * np.abs(x).max(initial=0.0)
    problem = hb.Problem(name="scene", system=system, t_span=(0.0, 1.0), q0=q0, v0=v0)
    assert any(f"hht({name.partition(',')[0]})" in x.reason for x in describe(problem).statements)


@pytest.mark.parametrize("name", [name for name in REDUCTIONS if name != "without=reaction"])
def test_a_switch_changes_code_or_the_kind_of_matrix(name):
    option, system, _ = REDUCTIONS[name]

    def made(**options):
        engine = begun(system, **options)._engine
        operations = {name: code.operations for name, code in engine.functions._codes.items()}
        return engine.why, operations, engine.functions.analysis.rows.size

    assert made() != made(**option)


def test_every_reduction_that_is_read_off_a_system_is_here():
    assert {option["without"] for option, _, _ in REDUCTIONS.values() if "without" in option} == set(SWITCHES)


def calls_in_python(system, steps, event=None):
    """The least of three runs: what looks at a clock may be called once more."""
    counts = []
    for _ in range(3):
        events = Counter()
        hht = hb.HHT(system, events=None if event is None else [hb.Event(event)])
        before = sys.getprofile()
        sys.setprofile(lambda frame, event, _, events=events: events.update((event,)))
        try:
            hht.solve((0.0, steps * H), Q0, V0, steps=steps, t_eval=[steps * H])
        finally:
            sys.setprofile(before)
        counts.append(events["call"] + events["c_call"])
    return min(counts)


def left_by_steps(system, event=None):
    """Bytes that a step by hand leaves behind."""
    hht = begun(system, event)

    def held(count):
        for _ in range(count):
            assert hht.step() is hb.Status.success
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        first = held(50)
        return (held(400) - first) / 400
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("system", [FREE, SPHERE])
def test_steps_in_machine_code_call_nothing_in_python_and_leave_nothing_behind(system):
    calls_in_python(system, 20)
    assert calls_in_python(system, 40) == calls_in_python(system, 20)
    assert left_by_steps(system) <= 0.5


def test_calls_in_python_and_what_steps_leave_behind_are_seen():
    kept = []

    def hoarding(t, q, v):
        kept.append(np.zeros(8))
        return q[2] - 100.0

    assert calls_in_python(FREE, 40, hoarding) > calls_in_python(FREE, 20, hoarding)
    assert left_by_steps(FREE, hoarding) > 0.5
