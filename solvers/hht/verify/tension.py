"""``hhtbench verify tension``: vibrations that constraint forces carry, over b and with extrapolated multipliers, (H55)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hhtbench.evidence import Evidence, Row
from hhtbench.request import Request
from hhtbench.result import Solution
from hhtbench.testing.extremes.linkages import DoublePendulum
from solvers.hht.options import make_options
from solvers.hht.solver import HHT, refused
from solvers.hht.verify.drawn import GRAVITY, Beads
from solvers.hht.verify.measure import scaled_drift, solved
from solvers.hht.verify.study import Method, Progress, Study, below_row, order_row, shown_row, slope, verify
from solvers.hht.verify.weights import COARSE, constrained
from solvers.hht.verify.work import KINDS, Scene, load, refined, run, steps_at

EXTRAPOLATED: Method = {"extrapolate_reaction": True}
METHODS: dict[str, Method] = {
    **{f"b = {b:.3g}": {"b": b} for b in (0.0, 1.0 / 6.0, 0.2, 0.25, 0.4, 1.0)},
    "extrapolated": EXTRAPOLATED,
    "extrapolated, b = 1": {**EXTRAPOLATED, "b": 1.0},
}
BESIDE = ("b = 0", "b = 1", "extrapolated")
STEP, COUNT, LAST = 0.01, 200, 10  # [s] and steps of a vibration, and how many of them are looked at
FAINT = 1e-6  # [rad] of it: its square is roundoff
TOO_LONG = (2.1, 5.0, 20.0, 200.0)  # h omega, beyond (H33) for b = 0
LEFT = {-0.05: 0.1, -0.3: 1e-4}  # of a vibration after COUNT steps, over alpha
MARGIN = 0.1  # of an order
ROUNDOFF = 1e-12  # of scaled levels
ANGLE, UNTIL, LONGER = 0.5, 1.0, 4.0  # [rad], [s]: the double pendulum is let go straight
ENOUGH = {-0.05: 500.0, -0.1: math.inf, -0.3: math.inf}  # alpha -> h omega up to which it damps what extrapolation errs by
STILL = 1e-3  # [m/s] of a vibration, where the motion has 3
BOUND = 10.0  # errors over tolerance
FEWER = 20.0  # times less steps than b = 1 takes with masses 1e6 apart and more, at the loosest tolerance
TOLERANCES = (1e-3, 1e-4, 1e-5)
FINEST = 1e-6  # of what they are compared with
MOST = 2_000_000  # steps
RATIOS = (1e2, 1e4, 1e6, 1e8)
SEEN = 1e6  # masses so far apart vibrate less than the loosest tolerance sees


def verify_tension(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Damping, order, and steps with light bodies and on the library; some minutes."""
    library = [(library_steps, kind, spec) for kind in KINDS for spec in taken()]
    return verify("Vibrations that constraint forces carry", (*STUDIES, *library), progress, jobs)


def taken() -> list[str]:
    """The problems of the library with position constraints and a known motion which the option is made for."""
    options = make_options(**EXTRAPOLATED)
    return [spec for spec in constrained() if refused(load(spec).system, options) is None]


def damped(alpha: float) -> Row:
    """A vibration in steps far too long for it, of one length and 1 : 2: what is left of it."""
    found = {o: max(left(o, alpha, pattern) for pattern in ((1.0,), (1.0, 2.0))) for o in TOO_LONG}
    text = ", ".join(f"{o:g}: {size:.1e}" for o, size in found.items())
    claim = f"small swing, alpha = {alpha:g}, extrapolated: of it after {COUNT} steps, of one length or 1:2, h omega {text}"
    return below_row(f"damping/alpha {alpha:g}", claim, max(found.values()), LEFT[alpha])


def left(o: float, alpha: float, pattern: Sequence[float]) -> float:
    """What is left of a swing of frequency ``o`` / STEP after COUNT steps, whose lengths repeat ``pattern`` times STEP."""
    hht = HHT(Beads(mass=[1.0], length=[1.0], g=(o / STEP) ** 2), alpha=alpha, **EXTRAPOLATED)
    steps = np.resize(pattern, COUNT) * STEP
    start = [math.sin(FAINT), -math.cos(FAINT)], [0.0, 0.0]
    solution = solved("swing", hht, (0.0, math.fsum(steps)), *start, steps=steps)
    return float(np.abs(solution.q[-LAST:, 0]).max()) / FAINT


def orders(scene: Scene, counts: Sequence[int]) -> list[Row]:
    """Errors of two drawn masses, steps of one length and 1 : 2, and beside those of other methods."""
    found, beside = dict[str, float](), dict[str, float]()
    for name, pattern in (("equal steps", (1.0,)), ("1:2", (1.0, 2.0))):
        errors = {label: [_error(scene, METHODS[label], pattern, count) for count in counts] for label in BESIDE}
        found[name] = -slope(counts, errors["extrapolated"])
        beside |= {f"{name}, {label}": errors["extrapolated"][-1] / errors[label][-1] for label in BESIDE[:2]}
    claim = f"{load(scene).name}, extrapolated, {', '.join(map(str, counts))} steps"
    return [
        order_row("order", f"{claim}: order of q and v", found, 2.0, MARGIN),
        shown_row("error", f"{claim}: error over that of other methods", beside),
    ]


def _error(scene: Scene, method: Method, pattern: Sequence[float], count: int) -> float:
    t0, t1 = load(scene).t_span
    lengths = np.resize(pattern, count)
    found = run(scene, method, Request(steps=(t1 - t0) * lengths / lengths.sum()))
    return found.error if found else math.nan


def levels(scene: Scene, steps: int) -> Row:
    """Both of them hold as without."""
    p = load(scene)
    solution = solved(p.name, HHT(p.system, **EXTRAPOLATED), p.t_span, p.q0, p.v0, steps=steps)
    worst = max(scaled_drift(p, solution))
    return below_row("levels", f"{p.name}, extrapolated, {steps} steps: largest residual of both levels", worst, ROUNDOFF)


def light(ratio: float) -> list[Row]:
    """A light body between two rods on its way down, under error control: steps of every method, and errors."""
    best = _falls(ratio, {"b": 1.0}, FINEST).q[-1]
    rows, first = [], dict[str, int]()
    for rtol in TOLERANCES:
        found = {name: _falls(ratio, method, rtol) for name, method in METHODS.items()}
        counts = {name: _steps(solution) for name, solution in found.items()}
        first = first or counts
        error = float(np.abs(found["extrapolated"].q[-1] - best).max()) / rtol
        claim = f"masses 1 : {ratio:g} on rods, {UNTIL:g} s, rtol {rtol:g}"
        text = ", ".join(f"{name}: {count:,}" for name, count in counts.items())
        rows += [
            shown_row(f"light/{ratio:g}/{rtol:g}", f"{claim}: steps", text),
            below_row(f"light/{ratio:g}/{rtol:g}/error", f"{claim}, extrapolated: error/rtol", error, BOUND),
        ]
    share = first["extrapolated"] / first["b = 1"]
    claim = f"masses 1 : {ratio:g} on rods, rtol {TOLERANCES[0]:g}: steps extrapolated over those with b = 1"
    judged = ratio >= SEEN
    id = f"light/{ratio:g}"
    return [*rows, below_row(id, claim, share, 1.0 / FEWER) if judged else shown_row(id, claim, f"{share:.2f}")]


def _falls(ratio: float, method: Method, rtol: float) -> Solution:
    hht, end = HHT(DoublePendulum(ratio=ratio), **method), [UNTIL]
    start = DoublePendulum.straight(ANGLE)
    return solved(f"1 : {ratio:g}", hht, (0.0, UNTIL), *start, rtol=rtol, t_eval=end, max_num_steps=MOST)


def _steps(solution: Solution) -> int:
    counters = solution.counters
    return sum(x or 0 for x in (counters.steps_accepted, counters.steps_rejected_error))


def prescribed(ratio: float) -> Row:
    """The same with steps of one length: by what the rods turn apart at the end; NaN where Newton's iteration fails.

    Steps longer than ``ENOUGH`` allows of an alpha are shown, but not judged.
    """
    shown, judged, omega = list[str](), list[float](), DoublePendulum.fastest(ratio)
    for alpha, most in ENOUGH.items():
        runs = [(h, _bent(ratio, {**EXTRAPOLATED, "alpha": alpha, "b": b}, h)) for b in (0.0, 1.0) for h in (0.04, 0.01)]
        shown.append(f"alpha {alpha:g}: " + ", ".join(f"{size:.0e}" for _, size in runs))
        judged += [size for h, size in runs if h * omega <= most]
    claim = f"masses 1 : {ratio:g}, {LONGER:g} s, extrapolated, b = 0 and 1, h = 0.04 and 0.01 s: speed of vibrations [m/s]"
    text = f"{claim} {'; '.join(shown)}; largest where alpha is enough"
    return below_row(f"prescribed/{ratio:g}", text, float(np.max(judged)), STILL)


def _bent(ratio: float, method: Method, h: float) -> float:
    hht, start = HHT(DoublePendulum(ratio=ratio), **method), DoublePendulum.straight(ANGLE)
    solution = hht.solve((0.0, LONGER), *start, step=h)
    v = solution.v[-1]
    return float(np.abs(v[:2] - v[2:] / 2.0).max()) if solution.success else math.nan


def energy(h: float, seconds: float) -> Row:
    """A pendulum of 1 rad: alpha damps a motion that reactions carry too, as little as any that steps resolve."""
    system, angle = Beads(mass=[1.0], length=[1.0]), 1.0
    start, shown = ([math.sin(angle), -math.cos(angle)], [0.0, 0.0]), dict[str, float]()
    for name in BESIDE:
        solution = solved(name, HHT(system, **METHODS[name]), (0.0, seconds), *start, step=h)
        energies = system.energies(solution.q, solution.v)
        shown[name] = float(energies[-1] - energies[0]) / (GRAVITY * (1.0 - math.cos(angle)))
    claim = f"pendulum of 1 rad, {seconds:g} s in steps of {h:g} s: change of the energy of motion"
    return shown_row("energy", claim, ", ".join(f"{name} {change:.1e}" for name, change in shown.items()))


def library_steps(kind: str, spec: str) -> Row:
    """Steps at COARSE over those with b = 0."""
    needed: Mapping[str, Any] = {name: steps_at(refined(spec, kind, METHODS[name], COARSE), COARSE) for name in BESIDE}
    text = ", ".join(f"{name} {needed[name] / needed['b = 0']:.2f}" for name in BESIDE[1:])
    claim = f"{load(spec).name}, {kind}: steps at error {COARSE:g} over those with b = 0 ({needed['b = 0']:.0f})"
    return shown_row(f"{kind}/{spec}", claim, text)


TWO: Scene = (3, 2, 2, 0.0)
STUDIES: tuple[Study, ...] = (
    *((damped, alpha) for alpha in LEFT),
    (orders, TWO, (400, 800, 1600)),
    (levels, TWO, 400),
    *((light, ratio) for ratio in RATIOS),
    *((prescribed, ratio) for ratio in (1e4, 1e8)),
    (energy, 0.02, 20.0),
)
