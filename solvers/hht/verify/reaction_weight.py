"""What the weight b of the end reaction does to single steps and to swings, against closed forms."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import ellipe, ellipk

from hhtbench import load_problem
from hhtbench.arguments import Vector
from hhtbench.evidence import Curve, Plot, Row
from hhtbench.protocol import NumpySystem, Problem, System
from hhtbench.result import Solution
from solvers.hht.solver import HHT
from solvers.hht.verify.drawn import GRAVITY, Beads, drawn, hanging
from solvers.hht.verify.measure import solved, step_by_hand
from solvers.hht.verify.study import Method, below_row, shown_row

BEST = (8.0 - math.sqrt(19.0)) / 18.0  # 0.2023: the zero of (H32) at 90 degrees
WEIGHTS = (0.0, 0.1, 1.0 / 6.0, 0.2, 0.25, 0.3, 1.0)
LEADING = 0.01  # relative: what the leading terms leave out at the steps used here
RETURNS = 1e-10  # of q and v there and back: roundoff, what two masses make of it included
SWING = 1e-6  # [m] of a small swing: its square is roundoff
MEETS = 1e-3  # relative: the step at which small swings begin to grow
SPLIT = 0.01  # relative: the first steps, and a change of length at every step
MARGIN = 1e-7  # of a spectral radius that counts as one: square root of roundoff where two roots meet


def local_errors(angle: float, rate: float, h: float) -> Row:
    """One step of a mass on a rod of 1 m against (H31), from ``angle`` [rad] and ``rate`` [rad/s]."""
    length, off = 1.0, list[float]()
    exact = solve_ivp(
        lambda t, y: [y[1], -GRAVITY * math.sin(y[0])], (0, h), [angle, rate], "DOP853", rtol=1e-13, atol=1e-16
    )
    pull, push = rate**2 + GRAVITY * math.cos(angle), -GRAVITY * math.sin(angle)
    for b in WEIGHTS:
        hht = HHT(Beads(mass=[1.0], length=[length]), b=b)
        hht.init_step(0.0, *_on_circle(angle, rate), step=h)
        q, v = (state := step_by_hand("pendulum", hht)).q, state.v
        found = np.array([math.atan2(q[0], -q[1]), v[1] * q[0] - v[0] * q[1]]) - exact.y[:, -1]
        wanted = _local_error(b, pull, push, rate)  # (H31)
        off.append(float(np.max(np.abs(found / h**3 - wanted)) / np.max(np.abs(wanted))))
    claim = f"pendulum at {angle:g} rad, {rate:g} rad/s, b = {listed(WEIGHTS)}: local errors less (H31), relative"
    return below_row("local/pendulum", claim, _worst(off), LEADING)


def _worst(values: Iterable[float]) -> float:
    """The largest magnitude; NaN if there is one, which is below no bound."""
    return float(np.max(np.abs(list(values))))


def _on_circle(angle: float, rate: float) -> tuple[list[float], list[float]]:
    sin, cos = math.sin(angle), math.cos(angle)
    return [sin, -cos], [rate * cos, rate * sin]


def _local_error(b: float, pull: float, push: float, rate: float) -> Vector:
    """Of angle and rate, over h^3, (H31)."""
    return np.array([(1 - 3 * b) / 6 * pull * rate, -push * (pull / 12 + b * rate**2 / (2 - 4 * b))])


def period_error(b: float, amplitude: float) -> float:
    """Relative elongation of the period of a pendulum over (h w)^2, (H32)."""
    k = math.sin(amplitude / 2) ** 2
    turning = ellipe(k) / ellipk(k) - 1 + k
    return float((6 * b - 1) / 24 * math.cos(amplitude) + turning * (3 * (1 - 2 * b) / 8 + b / (2 - 4 * b) - (1 - 3 * b)))


def measured_period_error(b: float, amplitude: float, steps: int, alpha: float = 0.0) -> float:
    """The same from the lag after five quarters of a period, with ``steps`` steps."""
    w = math.sqrt(GRAVITY)
    t_end = 5 * ellipk(math.sin(amplitude / 2) ** 2) / w
    hht = HHT(Beads(mass=[1.0], length=[1.0]), b=b, alpha=alpha)
    solution = solved("pendulum", hht, (0.0, t_end), *_on_circle(amplitude, 0.0), steps=steps)
    q, v = solution.q[-1], solution.v[-1]
    lag = -math.atan2(q[0], -q[1]) / ((v[1] * q[0] - v[0] * q[1]) * t_end)
    return lag / (w * t_end / steps) ** 2


def periods(amplitude: float, steps: int) -> Row:
    """Elongation of a swing's period against (H32)."""
    weights = WEIGHTS[:-1]
    wanted = np.array([period_error(b, amplitude) for b in weights])
    found = np.array([measured_period_error(b, amplitude, steps) for b in weights])
    claim = (
        f"pendulum from {math.degrees(amplitude):.0f} degrees, b = {listed(weights)}: elongation of the period less (H32)"
    )
    return below_row(
        "period", f"{claim}, over that at b = 0", float(np.max(np.abs(found - wanted)) / abs(wanted[0])), LEADING
    )


def best(steps: int) -> Row:
    """At the zero of (H32) for 90 degrees the period has no error of second order, whatever alpha."""
    found = [measured_period_error(BEST, math.pi / 2, steps, alpha) for alpha in (0.0, -0.3)]
    claim = f"pendulum from 90 degrees, b = (8 - sqrt 19)/18 = {BEST:.4f}, alpha = 0 and -0.3: elongation over that at b = 0"
    return below_row("period/best", claim, _worst(found) / abs(period_error(0.0, math.pi / 2)), LEADING)


def period_plot(amplitudes: Sequence[float]) -> Plot:
    """(H32) over b."""
    weights = np.linspace(0.0, 0.35, 71)
    lines = [(f"{math.degrees(a):.0f} degrees", tuple(period_error(float(b), a) for b in weights)) for a in amplitudes]
    return Plot(
        id="period",
        title="Period of a pendulum over the weight b",
        caption="Relative elongation over (h w)^2 by (H32): small swings are best at b = 1/6, 90 degrees at 0.2023.",
        x_label="b",
        y_label="elongation / (h w)^2",
        curves=tuple(Curve(label=label, x=tuple(weights), y=y) for label, y in lines),
        logarithmic=False,
    )


def turning(steps: int) -> list[Row]:
    """The driven circle of the library against (H34), with constant steps and under error control."""
    off, sizes = list[float](), list[float]()
    for b in WEIGHTS[:-1]:
        p = load_problem("arevalo_circle")
        h = (p.t_span[1] - p.t_span[0]) / steps
        found = _lead(solved(p.name, HHT(p.system, alpha=0.0, b=b), p.t_span, p.q0, p.v0, steps=steps, t_eval=[p.t_span[1]]))
        wanted = _driven_error(b, 2.0, 2.0, 10.0)
        off, sizes = [*off, float(found[-1]) / h**2 - wanted], [*sizes, abs(wanted)]
    claim = f"arevalo_circle, constant steps, b = {listed(WEIGHTS[:-1])}: error of the angle at the end less (H34), relative"
    parts = {b: _parts(b, p, 1e-5) for b in (0.0, 0.2)}
    split = "; ".join(
        f"b = {b:g}: {x[0]:.1e} by the angle's, {x[1]:.1e} by the rate's, measured {x[2]:.1e}" for b, x in parts.items()
    )
    apart = _worst((x[0] + x[1] - x[2]) / max(map(abs, x)) for x in parts.values())
    claim_split = (
        f"arevalo_circle under error control at 1e-5, error of the angle at the end by local errors of (H34), {split}"
    )
    return [
        below_row("circle", claim, _worst(off) / max(sizes), LEADING),
        below_row("circle/split", f"{claim_split}; sum less measured, relative", apart, SPLIT),
    ]


def _parts(b: float, p: Problem, rtol: float) -> tuple[float, float, float]:
    """What local errors of the angle and of the rate, (H34), make of its error over the steps taken; what is measured."""
    solution = solved(p.name, HHT(p.system, alpha=0.0, b=b), p.t_span, p.q0, p.v0, rtol=rtol)
    ends, lengths = solution.steps_data.t, solution.steps_data.h  # type: ignore[union-attr]
    rate = 2.0 * (ends - lengths / 2)
    angle, late = lengths**3 * (1 - 3 * b) / 6 * rate**3, -(lengths**3) * 2.0 * rate**2 / (4 - 8 * b)
    return float(angle.sum()), float(late @ (p.t_span[1] - ends)), float(_lead(solution)[-1])


def _lead(solution: Solution) -> Vector:
    """Error of the angle t^2 [rad] of the driven circle at the output times; x = sin, y = cos."""
    angle = solution.t**2
    x, y = solution.q.T
    return np.arctan2(x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle))


def _driven_error(b: float, push: float, first: float, last: float) -> float:
    """Error of the angle over h^2 when a push has turned the rate from ``first`` to ``last`` with constant steps, (H34)."""
    turned = (last**4 - first**4) / 4
    late = -(turned - first**3 * (last - first)) / (12 - 24 * b)
    return (late + (1 - 3 * b) / 6 * turned) / push


def symmetry(seed: int, steps: int, h: float) -> list[Row]:
    """At alpha = 0 the implicit reaction leads there and back for every b; the other reactions do not."""
    p, rows = drawn(seed, 2), []
    for methods, judged in ((WEIGHTS_OF["implicit"], True), (WEIGHTS_OF["others"], False)):
        found = {_named(method): _there_and_back(p.system, p.q0, p.v0, method, steps, h) for method in methods}
        claim = f"two masses, alpha = 0, {steps} steps forward and back: largest distance of q and v from the start"
        if judged:
            rows.append(below_row("symmetry/implicit", f"{claim}, implicit, every b", _worst(found.values()), RETURNS))
        else:
            rows.append(shown_row("symmetry/others", claim, ", ".join(f"{k} {v:.0e}" for k, v in found.items())))
    return rows


def _there_and_back(system: System | NumpySystem, q0: Vector, v0: Vector, method: Method, steps: int, h: float) -> float:
    t_end = steps * h
    there = solved("two masses", HHT(system, **method), (0.0, t_end), q0, v0, steps=steps)
    back = solved("two masses", HHT(system, **method), (t_end, 0.0), there.q[-1], there.v[-1], steps=steps)
    return float(max(np.abs(back.q[-1] - q0).max(), np.abs(back.v[-1] - v0).max()))


def bounds(seed: int, count: int) -> list[Row]:
    """The longest step at which no small swing of a hanging chain grows against (H33)."""
    system, q0, frequencies, modes = hanging(seed, count)
    wrong, grown = 0, list[float]()
    methods: list[Method] = [{"b": b} for b in WEIGHTS[:-1]]
    for method in [*methods, {"b": 0.0, "reaction": "midpoint"}]:
        limit = 2 / math.sqrt(1 - 2 * method["b"]) / frequencies[-1]  # (H33)
        for step, stable in ((limit * (1 - MEETS), True), (limit * (1 + MEETS), False)):
            size = _growth(system, q0, modes[:, -1], {"alpha": 0.0, **method}, step)[0]
            wrong += (size <= 1 + MARGIN) is not stable
    for b in (0.0, 0.2, 1.0):
        h = 1.0 / frequencies[-1]
        found = _growth(system, q0, modes[:, -1], {"alpha": 0.0, "b": b, "reaction": "predictor"}, h)[1]
        grown.append(found - 1 - (1 - 2 * b) / 4)  # (H33)
    scene = f"drawn {seed}, {count} masses hanging, fastest swing"
    claim = f"{scene}, h w = 1, predictor: determinant less 1 + (1 - 2b)/4"
    held = f"{scene}: steps {MEETS:.1%} below and above 2/(w sqrt(1 - 2b)) on the wrong side of stability"
    return [
        below_row("stability", f"{held}; implicit with b = {listed(WEIGHTS[:-1])}, and midpoint", float(wrong), 1.0),
        below_row("stability/predictor", claim, _worst(grown), 1e-6),
    ]


def _growth(system: Beads, q0: Vector, mode: Vector, method: Method, h: float) -> tuple[float, float]:
    """Spectral radius and determinant of one step on the small swings along ``mode`` (k,)."""
    columns = []
    for q, v in ((SWING, 0.0), (0.0, SWING / h)):
        hht, start = HHT(system, calc_initcond=True, **method), (q0.copy(), np.zeros(q0.size))
        start[0][0::2], start[1][0::2] = q * mode, v * mode
        hht.init_step(0.0, *start, step=h)
        state = step_by_hand("hanging", hht)
        along = mode * np.asarray(system.mass) / (mode @ (np.asarray(system.mass) * mode)) / SWING
        columns.append([along @ state.q[0::2], h * (along @ state.v[0::2])])
    matrix = np.array(columns).T
    return float(np.abs(np.linalg.eigvals(matrix)).max()), float(np.linalg.det(matrix))


def _named(method: Method) -> str:
    reaction = method["reaction"]
    return reaction if reaction.startswith("midpoint") else f"{reaction}, b = {method['b']:.3g}"


def listed(weights: Sequence[float]) -> str:
    """As a claim shows them."""
    return ", ".join(f"{b:.3g}" for b in weights)


WEIGHTS_OF: dict[str, tuple[Method, ...]] = {
    "implicit": tuple({"alpha": 0.0, "reaction": "implicit", "b": b} for b in WEIGHTS),
    "others": tuple(
        {"alpha": 0.0, "reaction": reaction, "b": b}
        for reaction, b in (("predictor", 0.0), ("predictor", 0.2), ("midpoint", 0.0), ("midpoint_predictor", 0.0))
    ),
}
