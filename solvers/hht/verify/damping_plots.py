"""Radius, damping ratio and period elongation over the frequency: measured marks on closed curves."""

from __future__ import annotations

import math

import numpy as np

from hhtbench.evidence import Curve, Plot
from solvers.hht.verify.closed import Spectrum, Swing, radius, roots, spectrum, swing_of
from solvers.hht.verify.orders import NAMES
from solvers.hht.verify.vibration import Guided, constrained, measured_matrix, oscillator

ALPHAS = (0.0, -0.05, -0.15, -1.0 / 3.0)  # -0.3 would lie on -1/3
MEASURED = tuple(float(x) for x in np.logspace(-2, 8, 31))  # w h; fewer than the report's most marks
CLOSED = tuple(float(x) for x in np.logspace(-2, 8, 601))  # more than those: a line without marks
SMOOTH = 1.0  # w h up to which a vibration is resolved: six steps a period
HELD_UP_TO = 1e4  # w h of the guided scene, see the rows "stiff"
X_LABEL = "\N{GREEK SMALL LETTER OMEGA} h"


def plots() -> tuple[Plot, ...]:
    """The three plots, zeta = 0; closed forms last, so that they are drawn over what joins the marks."""
    measured = {alpha: [_eigenvalues(alpha, x) for x in MEASURED] for alpha in ALPHAS}
    closed = {alpha: [roots(alpha, x, 0.0) for x in CLOSED] for alpha in ALPHAS}
    radii = [_curve(alpha, "measured", MEASURED, [radius(r) for r in measured[alpha]]) for alpha in ALPHAS]
    radii.append(_guided())
    radii += [_curve(alpha, "closed form", CLOSED, [radius(r) for r in closed[alpha]]) for alpha in ALPHAS]
    swings = [(alpha, "measured", *_resolved(MEASURED, measured[alpha])) for alpha in ALPHAS]
    swings += [(alpha, "closed form", *_resolved(CLOSED, closed[alpha])) for alpha in ALPHAS]
    damping = [_curve(a, name, x, [s.damping for s in found]) for a, name, x, found in swings if a != 0.0]
    longer = [_curve(a, name, x, [s.elongation for s in found]) for a, name, x, found in swings]
    return (
        _plot("radius", "Spectral radius", "radius", radii, RADIUS),
        _plot("damping", "Damping ratio", "damping ratio", damping, DAMPING),
        _plot("elongation", "Period elongation", "relative elongation", longer, ELONGATION),
    )


RADIUS = (
    "What one step leaves of a vibration at worst: 1 at alpha = 0 for every frequency, (1 + alpha)/(1 - alpha) at infinity. "
    "The guided scene, with springs across its constraints, has the radius of the oscillator."
)
DAMPING = "Numerical damping grows as the cube of the frequency: slow motion is spared. alpha = 0 has none and is not drawn."
ELONGATION = "Periods come out too long by a part that grows as the square of the frequency, least at alpha = 0."


def _eigenvalues(alpha: float, frequency: float) -> Spectrum:
    return spectrum(measured_matrix(oscillator(), {"alpha": alpha}, frequency, 0.0))


def _guided() -> Curve:
    alpha, scene = -0.15, constrained("guided", Guided)
    x = tuple(frequency for frequency in MEASURED if frequency <= HELD_UP_TO)
    y = [radius(spectrum(measured_matrix(scene, {"alpha": alpha, "b": 0.25}, f, 0.0))) for f in x]
    return _curve(alpha, "guided", x, y)


def _resolved(frequencies: tuple[float, ...], found: list[Spectrum]) -> tuple[tuple[float, ...], list[Swing]]:
    pairs = [(x, swing_of(r, x)) for x, r in zip(frequencies, found, strict=True) if x <= SMOOTH * (1.0 + 1e-9)]
    return tuple(x for x, _ in pairs), [swing for _, swing in pairs]


def _curve(alpha: float, name: str, x: tuple[float, ...], y: list[float]) -> Curve:
    return Curve(label=f"alpha = {NAMES[alpha]}, {name}", x=x, y=tuple(value if value > 0 else math.nan for value in y))


def _plot(id: str, title: str, y_label: str, curves: list[Curve], caption: str) -> Plot:
    return Plot(id=id, title=title, caption=caption, x_label=X_LABEL, y_label=y_label, curves=tuple(curves))
