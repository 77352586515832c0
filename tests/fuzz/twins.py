"""What another run of the same motion must show: in other units, another frame, backward, by other code."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from solvers.hht import HHT, Event
from tests.fuzz.oracles import clear
from tests.fuzz.runs import Setting

SAME = 1e-12  # of the largest: another order of the same operations, for a few steps
CLOSE = 1e-8  # the same over a run, whose motion carries roundoff on
TOLERANCES = 50.0  # error control takes other steps: so many tolerances
FEW = 6  # steps of what runs as plain Python
FACTOR = 1000.0  # of rows of constraints
UNITS = (1e3, 1e-2, 60.0)  # a millimetre, a hundred kilograms, ...
RADIANS = 12.0  # of a run: over more, roundoff may be carried on too far

Twin = Callable[[Setting], Iterator[str]]


def compared(setting: Setting) -> Iterator[str]:
    """The faults that the case's twin shows; nothing where it says nothing about the case."""
    twin = KNOWN.get(setting.case.twin)
    if twin is not None and setting.base.solution is not None:
        yield from twin(setting)


def smooth(setting: Setting) -> bool:
    """Whether roundoff stays small on the way."""
    s, way = setting.base.solution, setting.case.way
    assert s is not None
    return setting.must_succeed and s.success and way.turns <= RADIANS and not way.watch and clear(setting, s)


def sizes(setting: Setting) -> np.ndarray:
    """Of q and v (2n,), the latter the largest of the run."""
    s = setting.base.solution
    assert s is not None
    n, (size_q, size_v) = setting.made.shape.n, setting.judge.sizes
    return np.repeat([max(size_q, np.abs(s.q).max()), max(size_v, np.abs(s.v).max())], n)


def apart(setting: Setting, q, v) -> float:
    """The last row of the run from another, over the sizes of its motion."""
    s = setting.base.solution
    assert s is not None
    there = np.concatenate([s.q[-1] - q, s.v[-1] - v])
    return float((np.abs(there) / sizes(setting)).max())


def allowed(setting: Setting, exactly: float = CLOSE) -> float:
    """How far two runs may be apart: under error control they may take other steps."""
    way = setting.case.way
    return exactly if way.steps else TOLERANCES * way.rtol * max(1.0, way.turns)


def as_the_run(setting: Setting, what: str, found, back=lambda q, v: (q, v), exactly: float = CLOSE) -> Iterator[str]:
    """That ``found``, its last row taken ``back``, is the run."""
    if found.solution is None or not found.solution.success:
        message = found.raised if found.solution is None else found.solution.message
        yield f"{what}: ends with {found.status}, not {setting.base.status}: {str(message)[:200]}"
        return
    off = apart(setting, *back(found.solution.q[-1], found.solution.v[-1]))
    if not off <= allowed(setting, exactly):
        yield f"{what}: the end is {off:.1e} away, over {allowed(setting, exactly):.1e}"


def of_other(setting: Setting, made, time: float = 1.0) -> Setting:
    """The case with another mechanism over the same interval, in units of which ``time`` are one of before."""
    return Setting(replace(setting.case, made=made), setting.solver, setting.length * time)


def units(setting: Setting) -> Iterator[str]:
    """Lengths, masses and times in others."""
    if smooth(setting):
        length, mass, time = UNITS
        other = of_other(setting, setting.made.in_units(length, mass, time), time)
        back = lambda q, v: (q / length, v / (length / time))  # noqa: E731
        yield from as_the_run(setting, "other units", other.run(), back)


def rescaled(setting: Setting) -> Iterator[str]:
    """Rows of the constraints times a factor."""
    if smooth(setting):
        yield from as_the_run(setting, "rows times a factor", of_other(setting, setting.made.rescaled(FACTOR)).run())


def rotated(setting: Setting) -> Iterator[str]:
    """Another frame."""
    if smooth(setting):
        c, s, d = np.cos(0.7), np.sin(0.7), setting.made.shape.dim
        rotation = np.eye(d)
        rotation[:2, :2] = [[c, -s], [s, c]]
        turn = lambda x: (x.reshape(-1, d) @ rotation).ravel()  # noqa: E731
        other = of_other(setting, setting.made.rotated(rotation))
        yield from as_the_run(setting, "another frame", other.run(), lambda q, v: (turn(q), turn(v)))


def algebra(setting: Setting) -> Iterator[str]:
    """Every linear algebra."""
    for kind in ("dense", "band", "sparse"):
        if smooth(setting) and kind != setting.case.way.options.get("linsolver"):
            found = setting.run(options={**setting.case.way.options, "linsolver": kind})
            yield from as_the_run(setting, f"linsolver={kind!r}", found, exactly=CLOSE)


def backward(setting: Setting) -> Iterator[str]:
    """Forward and back at alpha = 0: the step is symmetric but for rows of velocities."""
    way, shape = setting.case.way, setting.made.shape
    plain = way.options["alpha"] == 0.0 and not way.ratios and shape.blade is None
    if smooth(setting) and plain:
        options = {**way.options, "start": "f0"}
        there = setting.run(options=options).solution
        assert there is not None
        ends = setting.span[1], setting.span[0]
        back = setting.run(options=options, span=ends, start=(there.q[-1], there.v[-1])).solution
        if not (there.success and back is not None and back.success):
            yield f"back at alpha = 0: {there.status.label}, {None if back is None else back.message}"
            return
        q, v = setting.start
        off = np.abs(np.concatenate([back.q[-1] - q, back.v[-1] - v])) / sizes(setting)
        if not off.max() <= 10 * CLOSE:
            yield f"forward and back at alpha = 0: the start is {off.max():.1e} away"


def order(setting: Setting) -> Iterator[str]:
    """Errors fall by four as steps are halved."""
    way = setting.case.way
    if not (smooth(setting) and setting.case.way.declares) or way.ratios:
        return
    found = [setting.run(steps=way.steps * 2**i, max_evaluations=None).solution for i in (0, 1, 2, 3)]
    if not all(s is not None and s.success for s in found):
        yield f"halved steps: {[s and s.status.label for s in found]}"
        return
    ends = [np.concatenate([s.q[-1], s.v[-1]]) / sizes(setting) for s in found]
    first, second, third = (float(np.abs(b - a).max()) for a, b in pairwise(ends))
    coarse = way.turns / way.steps
    if third > 1e-9 and coarse <= 0.2 and second > 0.4 * first and third > 0.4 * second:
        yield f"halving steps changes the end by {first:.1e}, {second:.1e}, {third:.1e}: not of order two"
    elif third > 30 * coarse**2 / 16 * max(1.0, way.turns**2):
        yield f"halving steps of {coarse:.2g} rad twice still changes the end by {third:.1e}"


def rows(setting: Setting) -> Iterator[str]:
    """Output at given times changes no step, has every row, and each is the dense output put onto the constraints."""
    s = setting.base.solution
    assert s is not None
    t0, t1 = setting.span
    if not s.t.size or not setting.judge.sound:
        return
    times = np.unique(np.linspace(t0, t1, 7))[:: 1 if t1 >= t0 else -1]
    found = setting.run(t_eval=times)
    other = found.solution
    if other is None:
        yield f"rows at times: raises {found.raised!r}"
        return
    if s.status is not other.status:
        yield f"rows at times: {other.status.label}, not {s.status.label}: {other.message[:200]}"
    reached = times[(times - s.t[-1]) * np.sign(t1 - t0) <= 0.0]
    if not np.array_equal(other.t, reached):
        yield f"rows at times: {other.t.size} rows to {other.t[-1:]}, of {reached.size} times that were reached"
    elif s.success and not setting.events and not np.array_equal(other.q[-1], s.q[-1]):
        yield "rows at times: the end is another one"
    elif setting.must_succeed and s.success and not setting.events and setting.case.way.declares:
        size = float(np.abs(s.v).max())
        worst = max(
            max(setting.judge.off(float(t), q, v, size))
            for t, q, v in zip(other.t[1:], other.q[1:], other.v[1:], strict=True)
        )
        if worst > 2e-9 and "off by" not in other.message:
            yield f"rows at times: {worst:.1e} off the levels"


def budget(setting: Setting) -> Iterator[str]:
    """A run that is cut short is the beginning of the whole one, and names its budget."""
    s = setting.base.solution
    assert s is not None
    if s.status.label not in ("success", "event") or s.t.size < 4 or setting.events:
        return
    half = (s.t.size - 1) // 2
    for name, most, status in (("max_num_steps", half, "max_steps"), ("max_evaluations", 3 * half, "evaluation_budget")):
        found = setting.run(**{name: most})
        short = found.solution
        if short is None:
            yield f"{name}={most}: raises {found.raised!r}"
        elif short.status.label not in (status, "success" if name == "max_evaluations" else status):
            yield f"{name}={most}: ends with {short.status.label}: {short.message[:200]}"
        elif not np.array_equal(short.q, s.q[: short.t.size]):
            yield f"{name}={most}: its rows are not the first of the whole run"
        elif name == "max_num_steps" and short.t.size != half + 1:
            yield f"{name}={most}: {short.t.size - 1} steps"


def watched(setting: Setting) -> Iterator[str]:
    """An event that is only recorded changes no step, and every change of sign at the rows is found."""
    s = setting.base.solution
    assert s is not None
    if not s.success or setting.events or s.t.size < 2 or not setting.judge.sound:
        return
    level = float(np.median(s.q[:, 0]))
    found = setting.run(events=[Event(lambda t, q, v: q[0] - level, name="passes")])
    other = found.solution
    if other is None:
        yield f"an event: raises {found.raised!r}"
        return
    if not (other.status is s.status and np.array_equal(other.q, s.q) and np.array_equal(other.v, s.v)):
        yield f"a recorded event changes the run: {other.status.label}, {other.t.size} rows of {s.t.size}"
        return
    signs = np.sign(s.q[:, 0] - level)
    changes = int(np.sum(signs[1:] * signs[:-1] < 0))
    values = np.abs(other.q_events[0][:, 0] - level)
    if values.size < changes or values.max(initial=0.0) > 1e-2 * setting.judge.sizes[0]:
        yield f"{values.size} events for {changes} changes of sign, off by {values.max(initial=0.0):.1e}"


def by_hand(setting: Setting) -> Iterator[str]:
    """Step by step, over a checkpoint, as in one call: to the bit with equal steps."""
    s, way = setting.base.solution, setting.case.way
    assert s is not None
    if not s.success or setting.events or way.ratios or not way.steps or setting.case.spoil:
        return
    hht = HHT(setting.system, **way.options)
    status = hht.init_step(setting.span[0], *setting.start, step=setting.length / way.steps)
    for i in range(way.steps):
        if status.label != "success":
            yield f"by hand {i} steps end with {status.label}: {hht.message[:200]}"
            return
        if i == way.steps // 2:
            data, hht = hht.checkpoint(), HHT(setting.system, **way.options)
            hht.resume(data)
        status = hht.step()
    if setting.must_succeed and way.turns <= RADIANS and clear(setting, s):
        off = apart(setting, hht.state.q, hht.state.v)
        if not off <= CLOSE:
            yield f"by hand the end is {off:.1e} away"


def python(setting: Setting) -> Iterator[str]:
    """The loop as plain Python: the same bits for a few steps."""
    first = setting.run(max_num_steps=FEW).solution
    other = setting.run(options={**setting.case.way.options, "engine": "python"}, max_num_steps=FEW).solution
    if first is None or other is None:
        yield "engine='python' or the compiled one raises"
    elif first.status is not other.status or first.t.size != other.t.size:
        ends = [f"{s.status.label} after {s.t.size} rows" for s in (other, first)]
        yield f"engine='python': {ends[0]}, compiled {ends[1]}"
    elif not all(np.array_equal(getattr(first, name), getattr(other, name)) for name in ("t", "q", "v")):
        off = np.abs(first.q - other.q).max()
        yield f"engine='python': other bits, q off by {off:.1e}"


def callables(setting: Setting) -> Iterator[str]:
    """Machine code with exact derivatives beside functions in Python with declared ones."""
    if smooth(setting):
        yield from as_the_run(setting, "functions in Python", setting.run(system=setting.callables))


KNOWN: dict[str, Twin] = {
    "units": units,
    "rescaled": rescaled,
    "rotated": rotated,
    "algebra": algebra,
    "reversed": backward,
    "order": order,
    "rows": rows,
    "budget": budget,
    "watched": watched,
    "by hand": by_hand,
    "python": python,
    "callables": callables,
}
