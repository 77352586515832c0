"""The figures of section 5 of the paper as curves, with rows that compare them with an independent implementation.

The paper shows plots without numbers.  ``independent_errors.json`` holds the errors of a separate plain
implementation of (3.4), kept with six to seven digits.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.evidence import Curve, Plot, Row
from solvers.hht.verify.measure import Case, Progress, below_row, errors, integrate, slope
from solvers.hht.verify.orders import alternating

AGREEMENT = 1e-5  # relative: the independent errors are kept with six to seven digits
ROUNDOFF = 2e-13  # absolute: the errors themselves are differences of numbers of size one
H_LABEL, ERROR = "step h [s]", "error"
TEST1_STEPS = (10, 20, 40, 80, 160, 320)
PAPER = {"alpha": -0.15, "b": 0.3}


@dataclass(frozen=True, kw_only=True)
class Test1Figure:
    """One of the figures 5.1 to 5.4: what is varied and what is seen."""

    number: str
    title: str
    alternating: bool  #: steps h/3, 2h/3 instead of constant ones
    options: dict[str, Any]  #: of the method
    slope: float  #: of the guide line
    seen: str


TEST1_FIGURES = (
    Test1Figure(
        number="5.1",
        title="constant steps, implicit reaction",
        alternating=False,
        options={"reaction": "implicit"},
        slope=2.0,
        seen="All three fall with slope two.",
    ),
    Test1Figure(
        number="5.2",
        title="constant steps, predictor (3.5)",
        alternating=False,
        options={"reaction": "predictor"},
        slope=2.0,
        seen="v and a fall with slope two; the error of q changes sign near h = 0.025, which bends its curve.",
    ),
    Test1Figure(
        number="5.3",
        title="steps h/3, 2h/3 without (2.3)",
        alternating=True,
        options={"rescale_a": False},
        slope=1.0,
        seen="Carrying a over unchanged costs one order: slope one for mean steps below 5e-3.",
    ),
    Test1Figure(
        number="5.4",
        title="steps h/3, 2h/3 with (2.3)",
        alternating=True,
        options={},
        slope=2.0,
        seen="With (2.3) the slope is two again.",
    ),
)
BASE_UNITS = "error (components in their SI units)"


@cache
def independent_errors() -> dict[str, Any]:
    """The stored errors of the independent implementation."""
    return json.loads(Path(__file__).with_name("independent_errors.json").read_text(encoding="utf-8"))


def test1_figures(case: Case, progress: Progress) -> tuple[list[Row], list[Plot]]:
    """Figures 5.1 to 5.4: constant steps with both reactions, alternating steps with and without (H11)."""
    rows: list[Row] = []
    plots: list[Plot] = []
    constant: list[int | Vector] = list(TEST1_STEPS)
    pairs: list[int | Vector] = [alternating(case, n) for n in (10, 20, 40, 80, 160, 320, 640)]
    for figure in TEST1_FIGURES:
        number, title, refinements = figure.number, figure.title, pairs if figure.alternating else constant
        progress(f"figure {number}")
        steps = [case.t_end / (n if isinstance(n, int) else n.size) for n in refinements]
        ends = [errors(case, integrate(case, n, **PAPER, **figure.options), PAPER["alpha"]).end for n in refinements]
        curves = tuple(Curve(label=f"|{key}|", x=tuple(steps), y=tuple(e[key] for e in ends)) for key in ("q", "v", "a"))
        plots.append(
            Plot(
                id=number,
                title=f"Figure {number}: test1, {title}",
                caption=f"2-norm errors at t = 1 for alpha = -0.15, b = 0.3; a against f(1 + alpha h). {figure.seen}",
                x_label="mean step [s]" if figure.alternating else H_LABEL,
                y_label=ERROR,
                curves=curves,
                slope=figure.slope,
            )
        )
        rows.append(_end_slopes(f"figure/{number}", f"test1, {title}: end-point slopes of q, v, a", steps, curves))
    return [_agreement_test1(case), *rows], plots


def pendulum_figures(case: Case, long_case: Case, progress: Progress) -> tuple[list[Row], list[Plot]]:
    """Figures 5.6 to 5.8: the angle on [0, 4], errors of y3 and z3 at t = 2 for alpha = 0 and -0.3."""
    rows, plots = [], [_angle_plot(long_case)]
    for number, alpha in (("5.7", 0.0), ("5.8", -0.3)):
        progress(f"figure {number}")
        steps = [0.01 / 2**k for k in range(8)]
        found = [_last_angle_errors(case, round(case.t_end / h), alpha) for h in steps]
        labels = ("|y3|", "|z3|")
        curves = tuple(Curve(label=label, x=tuple(steps), y=tuple(e[i] for e in found)) for i, label in enumerate(labels))
        plots.append(
            Plot(
                id=number,
                title=f"Figure {number}: pendulum, alpha = {alpha:g}, b = 0",
                caption=f"|error| of angle and angular velocity at t = 2. {_z3_remark(alpha)}",
                x_label=H_LABEL,
                y_label=BASE_UNITS,
                curves=curves,
                slope=2.0,
            )
        )
        rows.append(
            _end_slopes(f"figure/{number}", f"pendulum, alpha = {alpha:g}: end-point slopes of y3, z3", steps, curves)
        )
    worst = max(_agreement_pendulum(case, stored) for stored in independent_errors()["pendulum"])
    claim = "pendulum, b = 0, alpha in {0, -0.3}: errors of y3, z3 at t = 2 equal those of an independent implementation"
    return [below_row("figure/5.7-5.8", claim, worst, AGREEMENT), *rows, _angle_row(long_case)], plots


def extrapolated(case: Case, reference: tuple[float, float], progress: Progress) -> Row:
    """y3(2), z3(2) from three step sizes, the h^2 and h^3 parts of the error removed, against the reference."""
    progress("extrapolation")
    coarse, middle, fine = (_last_angle(case, n) for n in (4000, 8000, 16000))
    once = (4 * middle - coarse) / 3, (4 * fine - middle) / 3
    value = (8 * once[1] - once[0]) / 7
    claim = "pendulum: y3(2), z3(2) extrapolated from N = 4000, 8000, 16000 against the reference"
    return below_row("figure/limit", claim, float(np.max(np.abs(value - np.array(reference)))), 1e-9)


def _last_angle(case: Case, steps: int, alpha: float = -0.05) -> np.ndarray:
    solution = integrate(case, steps, alpha=alpha, b=0.0)
    return np.array([solution.q[-1, 2], solution.v[-1, 2]])


def _last_angle_errors(case: Case, steps: int, alpha: float) -> tuple[float, float]:
    end = case.exact(case.t_end)
    y3, z3 = np.abs(_last_angle(case, steps, alpha) - np.array([end.q[2], end.v[2]]))
    return float(y3), float(z3)


def _agreement_test1(case: Case) -> Row:
    stored = independent_errors()["test1"]
    worst = 0.0
    for i, steps in enumerate(stored["steps"]):
        end = errors(case, integrate(case, steps, alpha=stored["alpha"], b=stored["b"]), stored["alpha"]).end
        worst = max(worst, *(_difference(end[key], stored[key][i]) for key in ("q", "v", "a")))
    claim = "test1, implicit: errors of q, v, a at t = 1 equal those of an independent implementation (relative)"
    return below_row("figure/5.1", claim, worst, AGREEMENT)


def _agreement_pendulum(case: Case, stored: dict[str, Any]) -> float:
    found = [_last_angle_errors(case, round(case.t_end / h), stored["alpha"]) for h in stored["step"]]
    pairs = [(y3, stored["y3"][i]) for i, (y3, _) in enumerate(found)] + [
        (z3, stored["z3"][i]) for i, (_, z3) in enumerate(found)
    ]
    return max(_difference(a, b) for a, b in pairs)


def _difference(measured: float, stored: float) -> float:
    return max(0.0, abs(measured - stored) - ROUNDOFF) / stored


def _end_slopes(id: str, claim: str, steps: list[float], curves: tuple[Curve, ...]) -> Row:
    text = ", ".join(f"{curve.label} {slope(steps, curve.y):.3f}" for curve in curves)
    return Row(id=id, claim=claim, measured=text, bound="not judged", passed=None)


def _z3_remark(alpha: float) -> str:
    if alpha == 0.0:
        return "The leading error of z3 nearly cancels at t = 2: its curve is crooked down to h = 2.5e-4."
    return "z3 approaches slope two from above."


def _angle_plot(case: Case) -> Plot:
    solution = integrate(case, 400, alpha=-0.3, b=0.0)
    times = np.linspace(0.0, case.t_end, 401)
    exact = tuple(float(case.exact(float(t)).q[2]) for t in times)
    found = tuple(float(x) for x in np.atleast_2d(solution(times).q)[:, 2])
    return Plot(
        id="5.6",
        title="Figure 5.6: the angle of the pendulum",
        caption="Exact (one-coordinate equation) and alpha = -0.3, b = 0 with h = 0.01: the swing dies out about 3 pi / 2.",
        x_label="t [s]",
        y_label="y3 [rad]",
        curves=(Curve(label="exact", x=tuple(times), y=exact), Curve(label="h = 0.01", x=tuple(times), y=found)),
        logarithmic=False,
    )


def _angle_row(case: Case) -> Row:
    solution = integrate(case, 4000, alpha=-0.3, b=0.0)
    worst = max(abs(float(q[2]) - float(case.exact(float(t)).q[2])) for t, q in zip(solution.t, solution.q, strict=True))
    return below_row("figure/5.6", "pendulum: largest error of the angle on [0, 4] at h = 0.001 [rad]", worst, 5e-5)
