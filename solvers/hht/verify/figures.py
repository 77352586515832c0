"""The figures of section 5 of the paper as curves, compared with an independent implementation.

The paper shows plots without numbers.  ``independent_errors.json`` holds the errors of a separate plain
implementation of (3.4), kept with six to seven digits.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from hhtbench.protocol.evidence import Curve, Plot, Row
from solvers.hht.verify.measure import Case, alternating, integrate, refine
from solvers.hht.verify.study import below_row

AGREEMENT = 1e-5  # relative: the independent errors are kept with six to seven digits
ROUNDOFF = 2e-13  # absolute: the errors themselves are differences of numbers of size one
CONSTANT, PAIRS = (10, 20, 40, 80, 160, 320), (10, 20, 40, 80, 160, 320, 640)
INDEPENDENT = json.loads(Path(__file__).with_name("independent_errors.json").read_text(encoding="utf-8"))
TEST1_FIGURES: dict[str, tuple[bool, str, dict[str, Any], float]] = {
    # alternating steps, title, method, slope of the guide line
    "5.1": (False, "constant steps, implicit reaction", {"reaction": "implicit"}, 2.0),
    "5.2": (False, "constant steps, predictor (3.5)", {"reaction": "predictor"}, 2.0),
    "5.3": (True, "steps h/3, 2h/3 without (2.3)", {"rescale_a": False}, 1.0),
    "5.4": (True, "steps h/3, 2h/3 with (2.3)", {}, 2.0),
}
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
    for number, (pairs, title, method, guide) in TEST1_FIGURES.items():
        found = refine(case, [alternating(case, n) for n in PAIRS] if pairs else CONSTANT, alpha=-0.15, b=0.3, **method)
        errors = {key: [float(at[-1]) for at in found.errors(key)] for key in ("q", "v", "a")}
        caption = "2-norm errors at t = 1 for alpha = -0.15, b = 0.3; a against f(1 + alpha h)."
        plots.append(_plot(number, f"test1, {title}", caption, found.steps, errors, guide))
    stored = INDEPENDENT["test1"]
    worst = disagreement(plots[0], [case.t_end / n for n in stored["steps"]], stored)
    claim = "test1, implicit: errors of q, v, a at t = 1 equal those of an independent implementation (relative)"
    return [below_row("figure/5.1", claim, worst, AGREEMENT), *plots]


def pendulum_figures(case: Case) -> list[Row | Plot]:
    """Figures 5.7 and 5.8: errors of y3 and z3 at t = 2 for alpha = 0 and -0.3."""
    plots, worst, end = [], 0.0, case.known(case.t_end)
    for (number, alpha), stored in zip(PENDULUM_FIGURES.items(), INDEPENDENT["pendulum"], strict=True):
        steps = [0.01 / 2**k for k in range(8)]
        runs = [integrate(case, round(case.t_end / h), alpha=alpha, b=0.0) for h in steps]
        errors = {"y3": [abs(x.q[-1, 2] - end.q[2]) for x in runs], "z3": [abs(x.v[-1, 2] - end.v[2]) for x in runs]}
        caption = "|error| of angle and angular velocity at t = 2."
        plots.append(_plot(number, f"pendulum, alpha = {alpha:g}, b = 0", caption, steps, errors, 2.0))
        worst = max(worst, disagreement(plots[-1], stored["step"], stored))
    claim = "pendulum, b = 0, alpha in {0, -0.3}: errors of y3, z3 at t = 2 equal those of an independent implementation"
    return [below_row("figure/5.7-5.8", claim, worst, AGREEMENT), *plots]


def _plot(number: str, title: str, caption: str, steps: Sequence[float], errors: Mapping[str, Any], guide: float) -> Plot:
    return Plot(
        id=number,
        title=f"Figure {number}: {title}",
        caption=f"{caption} {SEEN[number]}",
        x_label="(mean) step h [s]",
        y_label="error (components in their SI units)",
        curves=tuple(Curve(label=f"|{key}|", x=tuple(steps), y=tuple(map(float, x))) for key, x in errors.items()),
        slope=guide,
    )


def disagreement(plot: Plot, steps: Sequence[float], stored: Mapping[str, Any]) -> float:
    """Largest relative difference of the curves of ``plot`` from the ``stored`` errors at ``steps`` [s]."""
    worst = 0.0
    for curve in plot.curves:
        measured = dict(zip(curve.x, curve.y, strict=True))
        for h, expected in zip(steps, stored[curve.label.strip("|")], strict=True):
            worst = max(worst, (abs(measured[h] - expected) - ROUNDOFF) / expected)
    return worst
