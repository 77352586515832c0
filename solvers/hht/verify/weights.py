"""``hhtbench verify b``: effect of the weight b of the end reaction on stability, local errors and number of steps.

Each b is compared with extrapolated multipliers, (H55), which have no such limit of stability.
"""

from __future__ import annotations

import math
import time
from typing import Any

import numpy as np

from hhtbench import list_problems, load_problem
from hhtbench.conformance.scenes.linkages import DoublePendulum
from hhtbench.conformance.scenes.pendulum import GRAVITY
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.evidence import Evidence, Row
from hhtbench.protocol.problem import Motion
from hhtbench.protocol.system import declared
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers.hht.solver import HHT
from solvers.hht.step.state import State
from solvers.hht.verify.measure import FLOOR, Run, run, solved, step_by_hand
from solvers.hht.verify.study import Method, Progress, Study, below_row, collected, judged_row, run_all, shown_row

WEIGHTS = (0.0, 0.1, 1.0 / 6.0, 0.2, 0.25, 0.3)
LISTED = ", ".join(f"{b:.3g}" for b in WEIGHTS)
EXTRAPOLATED = "extrapolated"
METHODS: dict[str, Method] = {f"b = {b:.3g}": {"b": b} for b in WEIGHTS} | {EXTRAPOLATED: {"extrapolate_reaction": True}}
CHOSEN = "b = 0.2"  # the weight that the documentation advises

FAINT = 1e-6  # [m] amplitude of a small vibration: its square is roundoff
ASIDE = 0.005  # relative distance of the steps tried from the limit of stability
GROWING = 50  # steps over which growth is measured
GROWN = 100.0  # growth that counts as unstable: below the limit it reaches 10, above it 1e4
LEADING = 0.01  # relative error of the leading term of a local error
ERROR = 1e-3  # both kinds of runs are refined until b = 0 has an error below it
MAX_SECONDS = 120.0  # of one solve [s]
KINDS = {
    "constant steps": tuple(Request(steps=2**k, max_seconds=MAX_SECONDS) for k in range(3, 17)),
    "error control": tuple(Request(rtol=10.0**-k, max_seconds=MAX_SECONDS) for k in range(2, 7)),
}
LIGHT = 1e6  # lower over upper mass of the falling pendulum
FEWER = 20.0  # factor by which extrapolated multipliers must reduce the steps of b = 1


def verify_b(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """Evidence on stability, local errors, a light body, and steps at equal error for the library; some minutes."""
    began = time.perf_counter()
    items = run_all(STUDIES, progress, jobs)
    cells = [(name, kind) for kind in KINDS for name in constrained()]
    found = dict(zip(cells, run_all([(work, *cell) for cell in cells], progress, jobs), strict=True))
    for kind in KINDS:
        items += work_rows(kind, {name: at for (name, of), at in found.items() if of == kind and at})
    return collected("The weight b of the end reaction", items, began)


def stability(ratio: float) -> Row:
    """Row: small vibrations of a hanging double pendulum with constant tension, against (H33)."""
    methods: list[Method] = [*({"b": b} for b in WEIGHTS), {"b": 0.0, "reaction": "midpoint"}]
    wrong = list[str]()
    for method in methods:
        limit = 2.0 / math.sqrt(1.0 - 2.0 * method["b"])  # (H33)
        for factor in (1.0 - ASIDE, 1.0 + ASIDE):
            if (growth(ratio, limit * factor, GROWING, alpha=0.0, **method).max() > GROWN) != (factor > 1.0):
                wrong.append(f"{method} at {factor:g}")
    claim = f"masses 1 : {ratio:g} hanging, alpha = 0, b = {LISTED}, midpoint: vibrations grow if (h omega)^2 (1 - 2b) > 4"
    bound = f"not {ASIDE:.1%} below, {ASIDE:.1%} above"
    return judged_row("stability", claim, ", ".join(wrong) or "all so", bound, not wrong)


def growth(ratio: float, frequency: float, count: int, **method: Any) -> Vector:
    """Amplitudes (count,) after each step with h omega = ``frequency``, relative to that at the start."""
    omega = DoublePendulum.fastest(ratio)
    q0, v0 = DoublePendulum.straight(0.0)
    mode = np.array([1.0 - omega**2 / GRAVITY, 1.0])  # from r x2'' = -r g (x2 - x1)
    q0[::2] += FAINT * mode / np.abs(mode).max()
    hht = HHT(DoublePendulum(ratio=ratio), **method)
    hht.init_step(0.0, q0, v0, step=frequency / omega, calc_initcond=True)
    return np.array([np.abs(step_by_hand("hanging", hht).q[::2]).max() for _ in range(count)]) / FAINT


def local_errors(h: float) -> Row:
    """Row: one step of the library's pendulum against (H31), which does not contain alpha."""
    p, off, t0 = load_problem("simple_pendulum"), list[float](), 0.3  # where it has both a position and a velocity
    (x, u), end = _polar(p.exact(t0)), _polar(p.exact(t0 + h))  # type: ignore[misc]
    square = float(p.system.g / p.system.L)  # type: ignore[union-attr]
    pull, push = u**2 + square * math.cos(x), -square * math.sin(x)
    for b in WEIGHTS:
        hht, start = HHT(p.system, b=b), p.exact(t0)  # type: ignore[misc]
        hht.init_step(t0, start.q, start.v, step=h)
        found = (_polar(step_by_hand(p.name, hht)) - end) / h**3
        wanted = np.array([(1 - 3 * b) / 6 * pull * u, -push * (pull / 12 + b * u**2 / (2 - 4 * b))])  # (H31)
        off.append(float(np.abs(found - wanted).max() / np.abs(wanted).max()))
    claim = f"{p.name}, one step of {h:g} s, b = {LISTED}: local errors of angle and rate less (H31), relative"
    return below_row("local", claim, max(off), LEADING)


def _polar(at: Motion | State) -> Vector:
    """Angle from below [rad] and its rate [rad/s] of a point on a circle about the origin."""
    (x, y), (across, up) = at.q, at.v
    return np.array([math.atan2(x, -y), (up * x - across * y) / (x * x + y * y)])


def light_body(rtol: float) -> Row:
    """Row: steps for a light body between two rods under error control, where (H33) limits those of b = 0."""
    counts = {}
    for name, method in {"b = 0": {"b": 0.0}, "b = 1": {"b": 1.0}, EXTRAPOLATED: METHODS[EXTRAPOLATED]}.items():
        hht = HHT(DoublePendulum(ratio=LIGHT), **method)
        solution = solved(name, hht, (0.0, 1.0), *DoublePendulum.straight(0.5), rtol=rtol, t_eval=[1.0])
        counts[name] = (solution.counters.steps_accepted or 0) + (solution.counters.steps_rejected_error or 0)
    text = ", ".join(f"{name} {count:,}" for name, count in counts.items())
    claim = f"masses 1 : {LIGHT:g} on rods, 1 s, rtol {rtol:g}: steps {text}; extrapolated over b = 1"
    return below_row("light body", claim, counts[EXTRAPOLATED] / counts["b = 1"], 1.0 / FEWER)


def constrained() -> list[str]:
    """Names of the library's problems with position constraints and a known motion."""
    problems = {name: load_problem(name) for name in list_problems()}
    known = {name: p.exact is not None or p.reference is not None for name, p in problems.items()}
    return [name for name, p in problems.items() if known[name] and declared(p.system, "constraint") is not None]


def work(name: str, kind: str) -> dict[str, float]:
    """Steps at equal error relative to b = 0, by method; empty if b = 0 does not come below ERROR.

    Errors are of order two in the steps, also under error control, so steps times the root of the error are compared.
    Infinite where a run fails, NaN where a method does not accept the problem.
    """
    for request in KINDS[kind]:
        plain = run(name, request, **METHODS["b = 0"])
        if plain.error is not None and plain.error < ERROR:
            break
    if plain.error is None or not FLOOR < plain.error < ERROR:
        return {}
    return {label: _cost(run(name, request, **method)) / _cost(plain) for label, method in METHODS.items()}


def _cost(one: Run) -> float:
    if one.error is None:
        return math.nan if one.status is Status.declined else math.inf
    return one.steps * math.sqrt(one.error)


def work_rows(kind: str, found: dict[str, dict[str, float]]) -> list[Row]:
    """Rows for each problem and for the quartiles; b = 0.2 must take fewer steps than b = 0 in the median."""
    claim = f"{kind}: steps at error {ERROR:g} over those with b = 0"
    rows = [shown_row(f"{kind}/{name}", f"{name}, {claim}", at) for name, at in found.items()]
    table = np.array([list(at.values()) for at in found.values()])
    for name, level in {"lower quartile": 0.25, "median": 0.5, "upper quartile": 0.75}.items():
        at = dict(zip(METHODS, np.nanquantile(table, level, axis=0, method="nearest").tolist(), strict=True))
        rows.append(shown_row(f"{kind}/quartiles", f"{name} of {len(found)} problems, {claim}", at))
    median = float(np.nanmedian(table[:, list(METHODS).index(CHOSEN)]))
    return [*rows, below_row(f"{kind}/median", f"median of {len(found)} problems, {claim}, {CHOSEN}", median, 1.0)]


STUDIES: tuple[Study, ...] = (
    *((stability, ratio) for ratio in (1.0, 100.0)),
    (local_errors, 5e-4),
    (light_body, 1e-3),
)
