"""What one run must be, by itself: faults in words."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hhtbench import ProblemError, Solution, Status
from tests.fuzz.judge import CLEAR
from tests.fuzz.runs import Found, Setting
from tests.fuzz.systems import Planted

PATIENCE = 10.0  # s of processor time of one solve, compilation included
LEVEL = 2e-9  # of its size, of rows whose derivatives are declared or exact
OF_LEFT_OUT = 2e-8  # of rows that depend on others at the start
NEARLY_LOST = 1e-13  # over the least singular value there: what Newton's iteration takes for roundoff
NOISE = 1.0  # times the noise of a force: (H30) takes it for roundoff, and stops as far from the constraints
BY_DIFFERENCES = 1e-6  # of others
CLOSE = 1e-6  # of forces: multipliers of rows far from lost rank
RESOLVED = 0.5  # rad of what is fastest in a step
FASTER = 10.0  # times what is fastest at the start
LOOKS = 25  # rows of a run that are looked at, at most
RUN_ENDS = (
    *(Status.success, Status.event, Status.max_steps, Status.step_too_small, Status.newton_failed, Status.deadline),
    *(Status.singular_iteration_matrix, Status.redundant_constraints, Status.nonfinite_callback, Status.time_resolution),
    *(Status.inconsistent_initial, Status.evaluation_budget),
)
LOCAL_CONTROLLED = 20.0  # times what is allowed: the error of a step that was accepted
LOCAL_PRESCRIBED = 30.0  # times (h rate)^3 of the size of v
ENERGY = 6.0  # times (h rate)^2 of the energies in play
OFF = ("off by", "off the constraints", "beside a singular position")  # in messages: rows that are told not to be on them


def judged(setting: Setting) -> Iterator[str]:
    """The faults of the case's own run."""
    found = setting.base
    if found.seconds > PATIENCE:
        yield f"hangs: {found.seconds:.0f} s"
    if found.solution is None:
        yield from raised(setting, found)
        return
    faults = list(trajectory(setting, found.solution))
    yield from faults
    yield from ended(setting, found.solution)
    if not faults and setting.case.family != "hostile":
        yield from moved(setting, found.solution)


def raised(setting: Setting, found: Found) -> Iterator[str]:
    """Whether an exception is the user's own, or refuses what was asked."""
    spoil, error = setting.case.spoil, found.raised
    if isinstance(error, Planted) and spoil is not None and spoil.kind == "raise":
        if not isinstance(getattr(error, "partial_solution", None), Solution):
            yield "the user's exception carries no partial solution"
    elif not (isinstance(error, ProblemError) and setting.case.family == "hostile"):
        yield f"crashes: {type(error).__name__}: {str(error)[:200]}"


def trajectory(setting: Setting, s: Solution) -> Iterator[str]:
    """Finite rows in order, from the start to the end, on both levels; also of a run that failed."""
    (t0, t1), (q0, v0), n = setting.span, setting.start, setting.made.shape.n
    if s.status not in RUN_ENDS or not s.message:
        yield f"ends with {s.status.label}, message {s.message!r}"
    if not (s.q.shape == s.v.shape == (s.t.size, n) and s.lam.shape[0] == s.mu.shape[0] == s.t.size):
        yield f"shapes {s.t.shape}, {s.q.shape}, {s.v.shape}, {s.lam.shape}, {s.mu.shape}"
        return
    if s.success and not s.t.size:
        yield "success without rows"
    if not s.t.size:
        return
    told = any(word in s.message for word in OFF)
    values = (s.t, s.q, s.v) if told else (s.t, s.q, s.v, s.lam, s.mu)
    if not all(np.isfinite(x).all() for x in values):
        yield "rows that are not finite"
        return
    ahead = np.diff(s.t) * (1.0 if t1 >= t0 else -1.0)
    if np.any(ahead < 0.0) or (not setting.events and np.any(ahead == 0.0)):
        yield "times out of order"
    if s.t[0] != t0 or (s.status is Status.success and s.t[-1] != t1):
        yield f"from {s.t[0]:.17g} to {s.t[-1]:.17g}, not from {t0:.17g} to {t1:.17g}"
    projects = setting.case.way.options.get("calc_initcond")
    if not projects and not (np.array_equal(s.q[0], q0) and np.array_equal(s.v[0], v0)):
        yield "the first row is not the start"
    if not told:
        yield from levels(setting, s)


def some(count: int, most: int = LOOKS):
    """Indices of rows after the start, the last among them."""
    return np.unique(np.linspace(min(1, count - 1), count - 1, min(count, most)).astype(int))


def levels(setting: Setting, s: Solution) -> Iterator[str]:
    """Both levels of the constraints at the rows after the start."""
    spoil, shape = setting.case.spoil, setting.made.shape
    if not (shape.rods or shape.blade) or s.t.size < 2 or (spoil is not None and "constraint" in spoil.where):
        return
    bound = LEVEL if setting.judge.sound else OF_LEFT_OUT + NEARLY_LOST / max(setting.judge.sigma(*setting.place), CLEAR**4)
    bound, size = (bound if setting.case.way.declares else BY_DIFFERENCES), float(np.abs(s.v).max())
    with np.errstate(all="ignore"):
        off = np.array([setting.judge.off(float(s.t[i]), s.q[i], s.v[i], size) for i in some(s.t.size)])
        rounded = roundoff(setting, s)
    worst = off.max(axis=0)
    if not (worst <= bound + rounded).all():
        yield f"{s.status.label} off the levels by {worst[0]:.1e} and {worst[1]:.1e} of their sizes"


def roundoff(setting: Setting, s: Solution):
    """Of the two levels: of v also that of q over a step."""
    spoil, eps = setting.case.spoil, np.finfo(float).eps
    if spoil is not None and spoil.kind in ("off", "noise"):
        return (3.0 if spoil.kind == "off" else NOISE) * spoil.since
    shortest = np.abs(np.diff(s.t)).min(initial=np.inf, where=np.diff(s.t) != 0.0)
    in_v = 100 * eps * setting.judge.sizes[0] / (setting.judge.sizes[1] * shortest)
    clock = eps * np.abs(s.t).max() * setting.rate  # constraints that move are seen at rounded times
    return np.array([100 * eps + 10 * clock, in_v + 10 * clock])


def ended(setting: Setting, s: Solution) -> Iterator[str]:
    """That a sound and gentle run arrives, and that a planted fault is told."""
    case, spoil = setting.case, setting.case.spoil
    off = spoil is not None and spoil.kind == "off" and spoil.since > 1e-6 and setting.judge.sound
    if off and setting.made.shape.rods and not case.way.options.get("calc_initcond") and s.success:
        yield "a start off its constraints is taken"
    if s.success and s.t.size and passed_over(setting, abs(s.t[-1] - s.t[0])):
        yield f"{s.status.label} beyond {spoil.kind} in {spoil.where}"
    if setting.must_succeed and not s.success and clear(setting, s):
        yield f"a sound and gentle case ends with {s.status.label}: {s.message[:200]}"
    if case.way.watch == "terminal" and s.status is Status.event:
        (event,) = setting.events
        value = abs(event.function(s.t[-1], s.q[-1], s.v[-1]))
        if not value <= 1e-9 * setting.judge.sizes[0]:
            yield f"a terminal event ends {value:.1e} m beside its zero"


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
    ahead = setting.length / max(way.steps, 20) * max(way.ratios, default=1.0)
    places = [(float(s.t[i]), s.q[i], s.v[i]) for i in some(s.t.size, 12)]
    places += [(float(s.t[-1]) + ahead * x, s.q[-1] + ahead * x * s.v[-1], s.v[-1]) for x in (0.5, 1.0)]
    fastest = max(judge.rate(*place) for place in places)
    resolved = abs(ahead) * fastest <= RESOLVED if way.steps else fastest <= FASTER * setting.rate
    return resolved and all(judge.sigma(*place[:2]) > CLEAR for place in places)


def moved(setting: Setting, s: Solution) -> Iterator[str]:
    """That the rows follow the equations of motion, and energy does what it does."""
    with np.errstate(all="ignore"):
        yield from multipliers(setting, s)
        if s.steps_data is not None and setting.judge.sound and setting.case.way.declares and not setting.case.way.watch:
            yield from local_errors(setting, s)
            yield from energies(setting, s)


def multipliers(setting: Setting, s: Solution) -> Iterator[str]:
    """The reaction's pull on every point, from the acceleration level."""
    judge, made = setting.judge, setting.made
    if not s.lam.size + s.mu.size or not setting.case.way.declares:
        return
    for i in some(s.t.size, 3):
        t = float(s.t[i])
        if judge.sigma(t, s.q[i]) <= CLEAR:
            continue
        vdot, lam, settled = judge.acceleration(t, s.q[i], s.v[i])
        rows, own = judge.rows(t, s.q[i]), np.concatenate([s.lam[i], s.mu[i]])
        size = np.abs(np.array(made.masses)).max() * np.abs(vdot).max() + (np.abs(rows.T) @ np.abs(lam)).max()
        off = float(np.abs(rows.T @ (own - lam)).max()) / (size + 1e-300)
        if settled and not off <= CLOSE:
            yield f"the reaction at t = {t:.6g} is off by {off:.1e} of its size"
            return


def smooth_steps(setting: Setting, s: Solution) -> Iterator[tuple[int, float]]:
    """Some steps that resolve what is fastest, clear of lost rank, with their lengths over its time."""
    first = 1 if setting.case.way.steps else 0  # with a0 = f0 the first prescribed one is of lower order
    steps = s.t.size - 1
    for i in sorted({first, steps // 2, steps - 1}):
        if first <= i < steps:
            fastest = max(setting.judge.rate(float(s.t[j]), s.q[j], s.v[j]) for j in (i, i + 1))
            size = abs(s.t[i + 1] - s.t[i]) * max(setting.rate, fastest)
            if size <= 0.5 and all(setting.judge.sigma(float(s.t[j]), s.q[j]) > CLEAR for j in (i, i + 1)):
                yield i, float(size)


def local_errors(setting: Setting, s: Solution) -> Iterator[str]:
    """Steps beside a tight integration of the same equations."""
    judge, way = setting.judge, setting.case.way
    sizes = np.repeat(judge.sizes, setting.made.shape.n)
    for i, size in smooth_steps(setting, s):
        exact = judge.carried(float(s.t[i]), s.q[i], s.v[i], float(s.t[i + 1]))
        if exact is None:
            continue
        error = np.abs(np.concatenate([s.q[i + 1], s.v[i + 1]]) - exact)
        if way.steps:
            speed = max(judge.sizes[1], np.abs(s.v).max())
            length = abs(s.t[i + 1] - s.t[i])
            allowed = LOCAL_PRESCRIBED * size**3 * speed * np.repeat([length + 1 / setting.rate, 1.0], setting.made.shape.n)
            over = float((error / (allowed + 1e-9 * sizes)).max())
        else:
            now = np.maximum(np.abs(exact), np.concatenate([s.q[i], s.v[i]]))
            allowed = way.rtol * (np.abs(now) + sizes) * np.sqrt(min(1.0, 2 * way.rtol))
            over = float(np.sqrt(np.mean((error / (allowed + 1e-11 * sizes)) ** 2))) / LOCAL_CONTROLLED
        if not over <= 1.0:
            yield f"the step from t = {s.t[i]:.6g} errs {over:.1f} times what may be ({size:.2g} rad)"
            return


def energies(setting: Setting, s: Solution) -> Iterator[str]:
    """Kept by motions that conserve it, up to the square of prescribed steps."""
    judge, way = setting.judge, setting.case.way
    if not (judge.conserves and way.steps):
        return
    rows = some(s.t.size)
    held = [judge.energy(float(s.t[i]), s.q[i], s.v[i]) - judge.energy(float(s.t[0]), s.q[0], s.v[0]) for i in rows]
    size = way.turns / way.steps * max(way.ratios, default=1.0) / (np.mean(way.ratios) if way.ratios else 1.0)
    speed = max(judge.sizes[1], float(np.abs(s.v).max()))
    bound = ENERGY * size**2 * max(1.0, way.turns) * sum(setting.made.masses) * speed**2
    if max(map(abs, held)) > bound:
        yield f"energy is off by {max(map(abs, held)):.1e} J, of {bound:.1e} J that may be"
