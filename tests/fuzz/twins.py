"""What another run of the same motion must show: in other units, another frame, backward, by other code."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np

from hhtbench import Solution
from hhtbench.conformance.subject import expect
from hhtbench.protocol.events import Event
from tests.fuzz.oracles import TOLERANCES, clear, on_levels, sizes
from tests.fuzz.runs import Found, Setting

SAME = 1e-12  # of the largest: another order of the same operations, for a few steps
CLOSE = 1e-8  # the same over a run, whose motion carries roundoff on
FEW = 6  # steps of what runs as plain Python
FACTOR = 1000.0  # of rows of constraints
UNITS = (1e3, 1e-2, 60.0)  # a millimetre, a hundred kilograms, ...
RADIANS = 12.0  # of a run: over more, roundoff may be carried on too far


def compared(setting: Setting) -> None:
    """The case's twin, where it says something about the case; what it shows is an AssertionError."""
    s, twin, way = setting.base.solution, setting.case.twin, setting.case.way
    if s is None or not s.success or s.t.size < 4 or way.watch or not setting.judge.sound:
        return
    smooth = setting.must_succeed and way.turns <= RADIANS and clear(setting, s)  # roundoff stays small on the way
    if twin in ALIKE or (twin in CARRIED and smooth):
        (ALIKE | CARRIED)[twin](setting, s)


def end(s: Solution):
    """q and v (n,) of the last row."""
    return s.q[-1], s.v[-1]


def apart(sizes, one, other) -> float:
    """The larger distance of q and of v, over the sizes of the motion."""
    return float(max(np.abs(x - y).max() / size for x, y, size in zip(one, other, sizes, strict=True)))


def arrived(found: Found, what: str) -> Solution:
    """The solution of a run that must succeed."""
    message = found.raised if found.solution is None else found.solution.message
    expect(found.status == "success", f"{what}: ends with {found.status}: {message}")
    return found.solution


def agrees(setting: Setting, what: str, s: Solution, found: Found, back=lambda q, v: (q, v)) -> None:
    """That ``found``, its last row taken ``back``, is the run; under error control it may take other steps."""
    other, way = arrived(found, what), setting.case.way
    off = apart(sizes(setting, s), end(s), back(*end(other)))
    allowed = CLOSE if way.steps else TOLERANCES * way.rtol * max(1.0, way.turns)
    expect(off <= allowed, f"{what}: the end is {off:.1e} away, over {allowed:.1e}")


def elsewhere(setting: Setting, s: Solution) -> None:
    """In another frame and in other units, with rows of constraints times a factor, those of rods in turn divided by it."""
    (length, _, time), dim = UNITS, setting.made.shape.dim
    turn, cos, sin = np.eye(dim), np.cos(0.7), np.sin(0.7)
    turn[:2, :2] = [[cos, -sin], [sin, cos]]
    by = {"scale": FACTOR ** (-1.0) ** np.arange(len(setting.made.shape.rods)), "blade_scale": FACTOR}
    made = setting.made.but(lambda name, x, unit: (x @ turn.T if unit.vector else x) * by.get(name, 1.0)).in_units(*UNITS)
    back = lambda x: (x.reshape(-1, dim) @ turn).ravel() / length  # noqa: E731
    other = Setting(replace(setting.case, made=made), setting.solver, setting.length * time)
    agrees(setting, "another frame and units", s, other.run(), lambda q, v: (back(q), back(v) * time))


def algebra(setting: Setting, s: Solution) -> None:
    """Full and sparse matrices: a few steps and the run."""
    first = setting.run(max_num_steps=FEW).solution
    for kind in ("dense", "sparse"):
        agrees(setting, f"linsolver={kind!r}", s, setting.run(options={"linsolver": kind}))
        other = setting.run(options={"linsolver": kind}, max_num_steps=FEW).solution
        off = apart(sizes(setting, s), end(first), end(other))
        expect(off <= SAME, f"linsolver={kind!r}: {first.t.size - 1} steps are {off:.1e} away")


def backward(setting: Setting, s: Solution) -> None:
    """Forward and back at alpha = 0: the step is symmetric but for rows of velocities."""
    way, what = setting.case.way, "forward and back at alpha = 0"
    if way.options["alpha"] == 0.0 and not way.ratios and setting.made.shape.blade is None:
        there = arrived(setting.run(options={"start": "f0"}), what)
        place, ends = (there.q[-1], there.v[-1]), setting.span[::-1]
        back = arrived(setting.run(options={"start": "f0"}, span=ends, start=place), what)
        off = apart(sizes(setting, s), end(back), setting.start)
        expect(off <= 10 * CLOSE, f"{what}: the start is {off:.1e} away")


def order(setting: Setting, s: Solution) -> None:
    """Errors fall by four as steps are halved."""
    way = setting.case.way
    if not way.declares or way.ratios:
        return
    found = [arrived(setting.run(steps=way.steps * 2**i, max_evaluations=None), "halved steps") for i in range(4)]
    first, second, third = (apart(sizes(setting, s), end(a), end(b)) for a, b in pairwise(found))
    coarse = way.turns / way.steps
    changes = f"halving steps of {coarse:.2g} rad changes the end by {first:.1e}, {second:.1e}, {third:.1e}"
    falls = third <= 1e-9 or coarse > 0.2 or second <= 0.4 * first or third <= 0.4 * second
    expect(falls, f"{changes}: not of order two")
    expect(third <= 30 * coarse**2 / 16 * max(1.0, way.turns**2), changes)


def rows(setting: Setting, s: Solution) -> None:
    """Output at given times changes no step, has every row, and each is the dense output put onto the constraints."""
    t0, t1 = setting.span
    times = np.unique(np.linspace(t0, t1, 7))[:: 1 if t1 >= t0 else -1]
    other = arrived(setting.run(t_eval=times), "rows at times")
    expect(np.array_equal(other.t, times), f"rows at times: {other.t.size} rows to {other.t[-1:]}, of {times.size}")
    expect(np.array_equal(other.q[-1], s.q[-1]), "rows at times: the end is another one")
    if setting.must_succeed and setting.case.way.declares:
        on_levels(setting, other)


def budget(setting: Setting, s: Solution) -> None:
    """A run that is cut short is the beginning of the whole one, and names its budget."""
    half = (s.t.size - 1) // 2
    ends = {"max_num_steps": (half, ["max_steps"]), "max_evaluations": (3 * half, ["evaluation_budget", "success"])}
    for name, (most, allowed) in ends.items():
        found = setting.run(**{name: most})
        expect(found.status in allowed, f"{name}={most}: ends with {found.status}")
        short = found.solution
        expect(np.array_equal(short.q, s.q[: short.t.size]), f"{name}={most}: its rows are not the first of the whole run")
        expect(name != "max_num_steps" or short.t.size == half + 1, f"{name}={most}: {short.t.size - 1} steps")


def watched(setting: Setting, s: Solution) -> None:
    """An event that is only recorded changes no step, and every change of sign at the rows is found."""
    level = float(np.median(s.q[:, 0]))
    other = arrived(setting.run(events=[Event(lambda t, q, v: q[0] - level, name="passes")]), "an event")
    same = np.array_equal(other.q, s.q) and np.array_equal(other.v, s.v)
    expect(same, f"a recorded event changes the run: {other.t.size} rows of {s.t.size}")
    size, rows = setting.judge.sizes[0], s.q[:, 0] - level
    moved = rows[np.abs(rows) > 1e-12 * size]  # a coordinate at rest changes its sign by roundoff
    signs, values = np.sign(moved), np.abs(other.q_events[0][:, 0] - level)
    changes, off = int(np.sum(signs[1:] * signs[:-1] < 0)), values.max(initial=0.0)
    seen = values.size >= changes and off <= 1e-2 * size
    expect(seen, f"{values.size} events for {changes} changes of sign, off by {off:.1e}")


def python(setting: Setting, s: Solution) -> None:
    """The loop as plain Python: the same bits for a few steps."""
    first, other = (setting.run(options=x, max_num_steps=FEW).solution for x in ({}, {"engine": "python"}))
    same = all(np.array_equal(getattr(first, name), getattr(other, name)) for name in ("t", "q", "v"))
    expect(same and first.status is other.status, f"engine='python': other bits, {other.t.size} rows of {first.t.size}")


def callables(setting: Setting, s: Solution) -> None:
    """Machine code with exact derivatives beside functions in Python with declared ones."""
    agrees(setting, "functions in Python", s, setting.run(system=setting.callables))


CARRIED = {twin.__name__: twin for twin in (elsewhere, algebra, backward, order, callables)}  # of smooth motions
ALIKE = {twin.__name__: twin for twin in (rows, budget, watched, python)}
