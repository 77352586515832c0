"""The figures of section 5 of the paper as curves, with rows that compare them with an independent implementation.

The paper shows plots without numbers.  ``independent_errors.json`` holds the errors of a separate plain
implementation of (3.4), kept with six to seven digits.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.evidence import Curve, Plot, Row
from solvers.hht.verify.measure import Case, alternating, integrate, known_at, refine
from solvers.hht.verify.study import below_row, shown_row, slope

AGREEMENT = 1e-5  # relative: the independent errors are kept with six to seven digits
ROUNDOFF = 2e-13  # absolute: the errors themselves are differences of numbers of size one
H_LABEL = "step h [s]"
CONSTANT, PAIRS = (10, 20, 40, 80, 160, 320), (10, 20, 40, 80, 160, 320, 640)
INDEPENDENT = json.loads(Path(__file__).with_name("independent_errors.json").read_text(encoding="utf-8"))
TEST1_FIGURES: tuple[tuple[str, bool, str, dict[str, Any], float], ...] = (
    # number, alternating steps, title, method, slope of the guide line
    ("5.1", False, "constant steps, implicit reaction", {"reaction": "implicit"}, 2.0),
    ("5.2", False, "constant steps, predictor (3.5)", {"reaction": "predictor"}, 2.0),
    ("5.3", True, "steps h/3, 2h/3 without (2.3)", {"rescale_a": False}, 1.0),
    ("5.4", True, "steps h/3, 2h/3 with (2.3)", {}, 2.0),
)
PENDULUM_FIGURES = {"5.7": 0.0, "5.8": -0.3}  # number -> alpha
SEEN = {
    "5.1": "All three fall with slope two.",
    "5.2": "v and a fall with slope two; the error of q changes sign near h = 0.025, which bends its curve.",
    "5.3": "Carrying a over unchanged costs one order: slope one for mean steps below 5e-3.",
    "5.4": "With (2.3) the slope is two again.",
    "5.7": "The leading error of z3 nearly cancels at t = 2: its curve is crooked down to h = 2.5e-4.",
    "5.8": "z3 approaches slope two from above.",
}


def test1_figures(case: Case) -> list[Row | Plot]:
    """Figures 5.1 to 5.4: constant steps with both reactions, alternating steps with and without (H11)."""
    plots = []
    for number, pairs, title, method, guide in TEST1_FIGURES:
        run = refine(case, [alternating(case, n) for n in PAIRS] if pairs else CONSTANT, alpha=-0.15, b=0.3, **method)
        seen = "2-norm errors at t = 1 for alpha = -0.15, b = 0.3; a against f(1 + alpha h)."
        x_label, shown = "mean step [s]" if pairs else H_LABEL, {key: run.end[key] for key in ("q", "v", "a")}
        plots.append(
            _errors(number, f"test1, {title}", seen, run.steps, shown, x_label=x_label, y_label="error", slope=guide)
        )
    stored = INDEPENDENT["test1"]
    worst = disagreement(plots[0], [case.t_end / n for n in stored["steps"]], stored)
    claim = "test1, implicit: errors of q, v, a at t = 1 equal those of an independent implementation (relative)"
    return [below_row("figure/5.1", claim, worst, AGREEMENT), *plots, *map(_end_slopes, plots)]


def pendulum_figures(case: Case) -> list[Row | Plot]:
    """Figures 5.7 and 5.8: errors of y3 and z3 at t = 2 for alpha = 0 and -0.3."""
    plots, worst, end = [], 0.0, case.exact(case.t_end)
    for (number, alpha), stored in zip(PENDULUM_FIGURES.items(), INDEPENDENT["pendulum"], strict=True):
        steps = [0.01 / 2**k for k in range(8)]
        errors = [np.abs(_last_angle(case, round(case.t_end / h), alpha) - [end.q[2], end.v[2]]) for h in steps]
        seen, shown = (
            "|error| of angle and angular velocity at t = 2.",
            dict(zip(("y3", "z3"), np.transpose(errors), strict=True)),
        )
        labels = {"x_label": H_LABEL, "y_label": "error (components in their SI units)"}
        plots.append(_errors(number, f"pendulum, alpha = {alpha:g}, b = 0", seen, steps, shown, **labels, slope=2.0))
        worst = max(worst, disagreement(plots[-1], stored["step"], stored))
    claim = "pendulum, b = 0, alpha in {0, -0.3}: errors of y3, z3 at t = 2 equal those of an independent implementation"
    return [below_row("figure/5.7-5.8", claim, worst, AGREEMENT), *plots, *map(_end_slopes, plots)]


def _errors(number: str, title: str, seen: str, steps: Iterable[float], errors: Mapping[str, Any], **more: Any) -> Plot:
    curves = tuple(Curve(label=f"|{key}|", x=tuple(steps), y=tuple(map(float, x))) for key, x in errors.items())
    return Plot(id=number, title=f"Figure {number}: {title}", caption=f"{seen} {SEEN[number]}", curves=curves, **more)


def _end_slopes(plot: Plot) -> Row:
    slopes = {curve.label: slope(curve.x, curve.y) for curve in plot.curves}
    system, names = plot.title.partition(": ")[2], ", ".join(label.strip("|") for label in slopes)
    return shown_row(f"figure/{plot.id}", f"{system}: end-point slopes of {names}", slopes)


def disagreement(plot: Plot, steps: Sequence[float], stored: Mapping[str, Any]) -> float:
    """Largest relative difference of the curves of ``plot`` from the ``stored`` errors, which belong to ``steps`` [s]."""
    worst = 0.0
    for curve in plot.curves:
        measured = dict(zip(curve.x, curve.y, strict=True))
        for h, expected in zip(steps, stored[curve.label.strip("|")], strict=True):
            worst = max(worst, (abs(measured[h] - expected) - ROUNDOFF) / expected)
    return worst


def swinging_angle(case: Case) -> list[Row | Plot]:
    """Figure 5.6: the angle on [0, 4]."""
    coarse, fine = (integrate(case, steps, alpha=-0.3, b=0.0) for steps in (400, 4000))
    times = np.linspace(0.0, case.t_end, 401)
    exact = tuple(float(case.exact(float(t)).q[2]) for t in times)
    found = tuple(float(x) for x in coarse(times).q[:, 2])
    plot = Plot(
        id="5.6",
        title="Figure 5.6: the angle of the pendulum",
        caption="Exact (one-coordinate equation) and alpha = -0.3, b = 0 with h = 0.01: the swing dies out about 3 pi / 2.",
        x_label="t [s]",
        y_label="y3 [rad]",
        curves=(Curve(label="exact", x=tuple(times), y=exact), Curve(label="h = 0.01", x=tuple(times), y=found)),
        logarithmic=False,
    )
    worst = max(abs(float(q[2]) - float(case.exact(float(t)).q[2])) for t, q in zip(fine.t, fine.q, strict=True))
    claim = "pendulum: largest error of the angle on [0, 4] at h = 0.001 [rad]"
    return [plot, below_row("figure/5.6", claim, worst, 5e-5)]


def extrapolated(case: Case) -> Row:
    """y3(2), z3(2) from three step sizes, the h^2 and h^3 parts of the error removed, against the reference."""
    reference = [known_at(case.problem, name, case.t_end)[2] for name in ("q", "v")]
    coarse, middle, fine = (_last_angle(case, n, -0.05) for n in (4000, 8000, 16000))
    once = (4 * middle - coarse) / 3, (4 * fine - middle) / 3
    value = (8 * once[1] - once[0]) / 7
    claim = "pendulum: y3(2), z3(2) extrapolated from N = 4000, 8000, 16000 against the reference"
    return below_row("figure/limit", claim, float(np.max(np.abs(value - reference))), 1e-9)


def _last_angle(case: Case, steps: int, alpha: float) -> Vector:
    """Angle [rad] and angular velocity [rad/s] at the end."""
    solution = integrate(case, steps, alpha=alpha, b=0.0)
    return np.array([solution.q[-1, 2], solution.v[-1, 2]])
