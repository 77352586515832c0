"""What one run must be, by itself; what it is not is an AssertionError in words."""

from __future__ import annotations

import re

import numpy as np

from hhtbench import ProblemError, Solution, Status
from hhtbench.conformance.subject import expect
from hhtbench.lowering import CONSISTENT
from solvers.hht.step.newton import NewtonOptions
from tests.fuzz import formulas
from tests.fuzz.judge import CLEAR
from tests.fuzz.runs import Found, Setting
from tests.fuzz.systems import Planted

PATIENCE = 10.0  # s of processor time of one solve, compilation included
EPS = float(np.finfo(np.float64).eps)
ROUNDED = 20.0  # roundings of what a step sums up
BY_DIFFERENCES = 1e-6  # of rows whose derivatives are not declared
CLOSE = 1e-6  # of forces: multipliers of rows far from lost rank
RESOLVED = 0.5  # rad of what is fastest in a step
FASTER = 10.0  # times what is fastest at the start
LOOKS = 25  # rows of a run that are looked at, at most
RUN_ENDS = list(Status)[: list(Status).index(Status.deadline) + 1]  # those after it are not of runs
LOCAL_PRESCRIBED = 0.5  # times (h rate)^3 of the sizes: the error of a prescribed step
LOCAL_CONTROLLED = 20.0  # times what is allowed: the error of a step that was accepted
TOLERANCES = 50.0  # of error control, over a radian: so many tolerances
LOST = "is off by"  # in messages: of the end


def judged(setting: Setting) -> None:
    """The case's own run."""
    found = setting.base
    expect(found.seconds <= PATIENCE, f"hangs: {found.seconds:.0f} s")
    if found.solution is None:
        raised(setting, found)
        return
    trajectory(setting, found.solution)
    ended(setting, found.solution)
    if setting.case.family != "hostile":
        with np.errstate(all="ignore"):
            own_equations(setting, found.solution, 3)


def raised(setting: Setting, found: Found) -> None:
    """Whether an exception is the user's own, or refuses what was asked."""
    spoil, error = setting.case.spoil, found.raised
    if isinstance(error, Planted) and spoil is not None and spoil.kind == "raise":
        left = getattr(error, "partial_solution", None)
        expect(isinstance(left, Solution), "the user's exception carries no partial solution")
    else:
        refused = isinstance(error, ProblemError) and setting.case.family == "hostile"
        expect(refused, f"crashes: {type(error).__name__}: {str(error)[:200]}")


def trajectory(setting: Setting, s: Solution) -> None:
    """Finite rows in order, from the start to the end, on both levels; also of a run that failed."""
    (t0, t1), (q0, v0), n = setting.span, setting.start, setting.made.shape.n
    expected = s.status in RUN_ENDS or (s.status is Status.unreliable and setting.case.family == "hostile")
    expect(expected and s.message, f"ends with {s.status.label}, message {s.message!r}")
    shapes = {name: getattr(s, name).shape for name in ("q", "v", "lam", "mu")}
    fitting = shapes["q"] == shapes["v"] == (s.t.size, n) and shapes["lam"][0] == shapes["mu"][0] == s.t.size
    expect(fitting, f"shapes {shapes} of {s.t.size} rows")
    expect(s.t.size or not s.success, "success without rows")
    if not s.t.size:
        return
    for name in ("t", "q", "v", "lam", "mu"):
        lost = ~np.isfinite(getattr(s, name).reshape(s.t.size, -1)).all(axis=1)
        expect(not lost.any(), f"row {int(np.argmax(lost))} of {s.t.size}: {name} is not finite")
    ahead = np.diff(s.t) * (1.0 if t1 >= t0 else -1.0)
    expect(np.all(ahead >= 0.0) and (setting.events or np.all(ahead > 0.0)), "times out of order")
    whole = s.t[0] == t0 and (s.status is not Status.success or s.t[-1] == t1)
    expect(whole, f"from {s.t[0]:.17g} to {s.t[-1]:.17g}, not from {t0:.17g} to {t1:.17g}")
    expect(np.array_equal(s.q[0], q0) and np.array_equal(s.v[0], v0), "the first row is not the start")
    on_levels(setting, s)


def some(count: int, most: int = LOOKS):
    """Indices of rows after the start, the last among them."""
    return np.unique(np.linspace(min(1, count - 1), count - 1, min(count, most)).astype(int))


def on_levels(setting: Setting, s: Solution) -> None:
    """Both levels of the constraints at the rows after the start, up to the roundoff of the steps."""
    spoil, shape, judge = setting.case.spoil, setting.made.shape, setting.judge
    if not (shape.rods or shape.blade) or s.t.size < 2 or (spoil is not None and "constraint" in spoil.where):
        return
    with np.errstate(all="ignore"):
        limits = roundoff(setting, s)
        for i in some(s.t.size):
            if i == s.t.size - 1 and LOST in s.message:
                continue
            t = float(s.t[i])
            for name, off, limit in zip(("q", "v"), judge.off(t, s.q[i], s.v[i]), limits, strict=True):
                most, where = off.max(initial=0.0), f"{s.status.label}, row {i} of {s.t.size} (t = {t:.6g}): {name}"
                expect(most <= limit, f"{where} is off its level by {most:.1e}, {most / limit:.1e} times what may be")


def number(words: str, s: Solution) -> float:
    """The one in the message that ``words`` leave out; 0 without."""
    told = re.search(words, s.message)
    return float(told[1]) if told else 0.0


def rounding(setting: Setting, s: Solution) -> tuple[float, float]:
    """What the steps' own sums round q and v to.

    Of a step of h over which forces and reactions push with accelerations up to A, before they cancel one another, the sums
    for q and v round to eps h^2 A and eps h A, and the reaction of a place that is off turns: v is off by A h / l times
    that, l the shortest length.  A is large where rows are nearly dependent, or hold light bodies between heavy ones.
    """
    judge, (size_q, size_v), looks = setting.judge, sizes(setting, s), some(s.t.size)
    lengths = np.abs(np.diff(s.t))
    longest, shortest = lengths.max(), lengths.min(initial=np.inf, where=lengths > 0.0)
    pushed = strained(setting, s)
    nearest = min(judge.shortest(float(s.t[i]), s.q[i]) for i in looks)
    clock = EPS * np.abs(s.t).max()  # constraints that move are seen at rounded times
    in_q = EPS * (size_q + longest * (size_v + longest * pushed)) + clock * size_v
    in_v = EPS * (size_v + size_q / shortest + longest * pushed) + clock * setting.rate * size_v
    return ROUNDED * in_q, ROUNDED * (in_v + in_q * longest * pushed / nearest)


def strained(setting: Setting, s: Solution) -> float:
    """The largest of accelerations before they cancel one another."""
    multipliers = np.nan_to_num(np.concatenate([s.lam, s.mu], axis=1))
    return max(setting.judge.strained(float(s.t[i]), s.q[i], s.v[i], multipliers[i]) for i in some(s.t.size))


def sizes(setting: Setting, s: Solution) -> tuple[float, float]:
    """Of q and of v, at the start or on the way."""
    size_q, size_v = setting.judge.sizes
    return max(size_q, float(np.abs(s.q).max())), max(size_v, float(np.abs(s.v).max()))


def roundoff(setting: Setting, s: Solution) -> tuple[float, float]:
    """What q and v may be off the levels by.

    Beside what they are rounded to, Newton's increments are small, of v beside what forces could make of it in a step, by
    (H15), or as large as the run says, and rows left out as redundant are held as well as a start is consistent.
    """
    case, judge, spoil, (size_q, size_v) = setting.case, setting.judge, setting.case.spoil, sizes(setting, s)
    in_q, in_v = rounding(setting, s)
    in_v += NewtonOptions().stagnation * np.abs(np.diff(s.t)).max() * strained(setting, s)
    relative = NewtonOptions().stagnation
    if len(judge.distinct) < s.lam.shape[1] + s.mu.shape[1] or not judge.sound:
        relative += CONSISTENT
    if not case.way.declares:
        relative += BY_DIFFERENCES
    if spoil is not None and (spoil.kind == "off"):
        relative += spoil.since  # a start that is off by less than can be told
    return in_q + relative * size_q, in_v + relative * size_v


def ended(setting: Setting, s: Solution) -> None:
    """That a sound and gentle run arrives, and that a planted fault is told."""
    case, spoil = setting.case, setting.case.spoil
    off = spoil is not None and spoil.kind == "off" and spoil.since > 1e-6 and setting.made.shape.rods
    expect(not (off and setting.judge.sound and s.success), "a start off its constraints is taken")
    passed = s.success and s.t.size and passed_over(setting, abs(s.t[-1] - s.t[0]))
    expect(not passed, f"{s.status.label} beyond {spoil}")
    lost = setting.must_succeed and not s.success and clear(setting, s)
    expect(not lost, f"a sound and gentle case ends with {s.status.label}: {s.message[:200]}")
    if case.way.watch == "terminal" and s.status is Status.event:
        value = abs(setting.events[0].function(s.t[-1], s.q[-1], s.v[-1]))
        clock = 2 * EPS * float(np.abs(s.t).max() * np.abs(s.v[-1]).max())  # times are rounded
        expect(value <= 1e-9 * setting.judge.sizes[0] + clock, f"a terminal event ends {value:.1e} m beside its zero")


def passed_over(setting: Setting, reached: float) -> bool:
    """Whether a run that ends after `reached` [s] must have met the planted NaN or exception."""
    spoil, shape = setting.case.spoil, setting.made.shape
    if spoil is None or spoil.kind not in ("nan", "raise") or setting.case.way.turns < 1e-6:
        return False
    called = {"force": True, "constraint": bool(shape.rods), "velocity_constraint": shape.blade is not None}
    return called.get(spoil.where, False) and reached > 1.01 * spoil.since * abs(setting.length)


def clear(setting: Setting, s: Solution) -> bool:
    """Whether on the way, and just ahead, rank was kept and the steps resolve what is fastest there."""
    if not s.t.size:
        return True
    judge, way = setting.judge, setting.case.way
    ahead = setting.length / (way.steps or 20) * max(way.ratios, default=1.0) / np.mean(way.ratios or 1.0)
    places = [(float(s.t[i]), s.q[i], s.v[i]) for i in some(s.t.size, 12)]
    times = [float(s.t[-1]) + ahead * x for x in (0.5, 1.0)]
    motion = judge.carried(float(s.t[-1]), s.q[-1], s.v[-1], times)
    if motion is None:
        return False
    places += [(t, *np.split(y, 2)) for t, y in zip(times, motion, strict=True)]
    fastest = max(judge.rate(*place) for place in places)
    resolved = abs(ahead) * fastest <= RESOLVED if way.steps else fastest <= FASTER * setting.rate
    return resolved and all(judge.sigma(*place[:2]) > CLEAR for place in places)


def own_equations(setting: Setting, s: Solution, count: int) -> bool:
    """Whether ``count`` steps, or all, could be integrated anew; a wrong motion or reaction raises."""
    multipliers(setting, s)
    way = setting.case.way
    if s.steps_data is None or not setting.judge.sound or not way.declares or way.watch:
        return False
    return local_errors(setting, s, count)


def multipliers(setting: Setting, s: Solution) -> None:
    """The reaction's pull on every point, from the acceleration level."""
    judge = setting.judge
    if not s.lam.size + s.mu.size or not setting.case.way.declares:
        return
    for i in some(s.t.size, 3):
        t = float(s.t[i])
        if judge.sigma(t, s.q[i]) > CLEAR:
            vdot, _, lam, settled = judge.acceleration(t, s.q[i], s.v[i])
            rows, own = judge.rows(t, s.q[i]), np.concatenate([s.lam[i], s.mu[i]])
            mass = formulas.masses(np, judge.shape, judge.p, s.q[i]).max()
            size = mass * np.abs(vdot).max() + (np.abs(rows.T) @ np.abs(lam)).max()
            still = np.finfo(float).eps * mass * judge.sizes[0] / np.ptp(setting.span) ** 2  # of a motion made of roundoff
            off = float(np.abs(rows.T @ (own - lam)).max()) / (size + still + 1e-300)
            expect(not settled or off <= CLOSE, f"the reaction at t = {t:.6g} is off by {off:.1e} of its size")


def local_errors(setting: Setting, s: Solution, count: int) -> bool:
    """Steps that resolve what is fastest, clear of lost rank, beside a tight integration: whether all chosen are such."""
    first, last = 1 if setting.case.way.steps else 0, s.t.size - 2  # with a0 = f0 the first prescribed one is of lower order
    chosen = np.unique(np.linspace(first, last, count).astype(int)).tolist() if first <= last else []
    compared = 0
    for i in chosen:
        ends = [(float(s.t[j]), s.q[j], s.v[j]) for j in (i, i + 1)]
        fastest = max(setting.rate, *(setting.judge.rate(*end) for end in ends))
        size = abs(s.t[i + 1] - s.t[i]) * fastest
        exact = setting.judge.carried(*ends[0], [ends[1][0]]) if size <= RESOLVED else None
        if exact is not None and all(setting.judge.sigma(*end[:2]) > CLEAR for end in ends):
            compared += 1
            over = step_error(setting, s, i, fastest, exact[-1])
            told = f"step {i} of {s.t.size - 1}, from t = {s.t[i]:.6g}, errs {over:.1f} times what may be"
            expect(over <= 1.0, f"{told} ({size:.2g} rad)")
    return 0 < compared == len(chosen)


def step_error(setting: Setting, s: Solution, i: int, fastest: float, exact: np.ndarray) -> float:
    """That of step ``i`` over what may be."""
    way, n, t = setting.case.way, setting.made.shape.n, float(s.t[i])
    error, own = np.abs(np.concatenate([s.q[i + 1], s.v[i + 1]]) - exact), np.repeat(setting.judge.sizes, n)
    clock = EPS * abs(t) * setting.judge.sizes[1] * np.repeat([1.0, fastest], n)  # times are rounded
    clock += np.repeat(rounding(setting, s), n)
    if way.steps:
        order = 3 if way.options.get("rescale_a", True) or not way.ratios else 2  # a0 is that of another step, (H11)
        allowed = LOCAL_PRESCRIBED * (fastest * abs(s.t[i + 1] - t)) ** order * np.repeat(sizes(setting, s), n)
        return float((error / (allowed + clock + 1e-9 * own)).max())
    now = np.maximum(np.abs(exact), np.concatenate([s.q[i], s.v[i]]))
    allowed = way.rtol * (np.abs(now) + own) * np.sqrt(min(1.0, 2 * way.rtol))
    return float(np.sqrt(np.mean((error / (allowed + clock + 1e-11 * own)) ** 2))) / LOCAL_CONTROLLED
