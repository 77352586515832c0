"""``hhtbench verify damping``: amplification, damping, period and overshoot against closed forms.

Scenes with constraints must have those of the oscillator: reactions do not enter the tangential motion.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Sequence

import numpy as np

from hhtbench.evidence import Curve, Evidence, Plot, Row
from solvers.hht.verify.study import ALPHAS, NAMES, Method, Progress, Study, below_row, judged_row, verify
from solvers.hht.verify.vibration import (
    Spectrum,
    invariants_error,
    make_scene,
    measured_matrix,
    measured_swing,
    radius,
    roots,
    series,
    spectrum,
    swing_of,
)

ROUNDOFF = 1e-12  # of trace, minors and determinant
AGREES = 1e-3  # relative: what the recurrence leaves out
LEADING = 0.02  # relative: what the first term of the series leaves out at w h = 0.1
KEPT = 1e-8  # damping ratio that counts as none
DRAWN = (0.0, -0.05, -0.15, -1.0 / 3.0)  # -0.3 would lie on -1/3
MEASURED = tuple(np.logspace(-2, 8, 31).tolist())  # w h; fewer than the report's most marks
CLOSED = tuple(np.logspace(-2, 8, 601).tolist())  # more than those: a line without marks
SMOOTH = 1.0 + 1e-9  # w h up to which a vibration is resolved: six steps a period
GUIDED_UP_TO = 1e4  # w h of the guided scene: Newton's iteration fails far above it, as springs across are as stiff
RADIUS = (
    "The factor by which one step multiplies a vibration at most: 1 at alpha = 0 for every frequency, "
    "(1 + alpha)/(1 - alpha) at infinity. "
    "The guided scene, with springs across its constraints, has the radius of the oscillator."
)
DAMPING = "Numerical damping grows as the cube of the frequency: slow motion is spared. alpha = 0 has none and is not drawn."
ELONGATION = "Periods come out too long by a part that grows as the square of the frequency, least at alpha = 0."


def verify_damping(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """What ``alpha`` or ``rho_inf`` does to vibrations, measured by stepping; a minute on one core."""
    return verify("Damping in the user's terms", STUDIES, progress, jobs)


def one_step(name: str, alphas: Sequence[float], method: Method, cases: Iterable[tuple[float, float]]) -> Row:
    """Invariants of one step of a scene, which make its spectral radius, worst over ``alphas`` and ``cases`` (w h, zeta)."""
    scene, cases, worst = make_scene(name), list(cases), 0.0
    for alpha, (frequency, zeta) in itertools.product(alphas, cases):
        measured = measured_matrix(scene, {**method, "alpha": alpha}, frequency, zeta)
        worst = max(worst, invariants_error(measured, alpha, frequency, zeta))
    label = name if scene.free.size == 1 else f"{name}, {_variant(method)}"
    highest = max(frequency for frequency, _ in cases)
    seen = f"{label}, alpha = {', '.join(NAMES[a] for a in alphas)}, w h = 0.01 ... {highest:g}, zeta = 0 and 0.05"
    claim = f"{seen}: trace, minors, determinant of one step, whose eigenvalues are its amplification"
    return below_row(f"matrix/{name}", claim, worst, ROUNDOFF)


def _variant(method: Method) -> str:
    """The method without its damping."""
    return f"{method['reaction']}, b = {method['b']:g}"


def rho_inf(rho: float) -> Row:
    """``HHT(system, rho_inf=rho)`` has that spectral radius at the highest frequency, (H18)."""
    measured = radius(spectrum(measured_matrix(make_scene("oscillator"), {"rho_inf": rho}, 1e8)))
    bound = 1e-5 if rho == 0.5 else 1e-6  # at 1/2 the radius comes down as (w h)^(-2/3) only
    claim = f"HHT(rho_inf={rho:g}), w h = 1e8: spectral radius of one step less rho_inf"
    return below_row("rho_inf", claim, abs(measured - rho), bound)


def swing(name: str, method: Method, frequency: float, periods: float) -> list[Row]:
    """Damping ratio and period elongation of a run against the eigenvalues and the leading terms of their series."""
    alpha, rows = method["alpha"], []
    found = measured_swing(make_scene(name), method, frequency, periods)
    exact, leading = swing_of(roots(alpha, frequency), frequency), series(alpha, frequency)
    run = f"{name}, {_variant(method)}, alpha = {NAMES[alpha]}, w h = {frequency:g}, {periods:g} periods"
    for quantity in ("damping", "elongation"):
        measured, root, first = (getattr(x, quantity) for x in (found, exact, leading))
        id, claim = f"{quantity}/{name}", f"{run}: {quantity} (eigenvalue {root:.5g}, series {first:.5g})"
        if first == 0.0:
            rows.append(below_row(id, claim, abs(measured), KEPT))
            continue
        close = abs(measured - root) < AGREES * abs(root) and abs(measured - first) < LEADING * abs(first)
        bound = f"{AGREES:.1%} of the eigenvalue, {LEADING:.0%} of the series"
        rows.append(judged_row(id, claim, f"{measured:.5g}", bound, close))
    return rows


def overshoot(alpha: float) -> Row:
    """The first step from y0 with a0 = f0, and from y'0, in the limit of (H18) for w h -> infinity."""
    frequency = 1e4  # the limit is reached to O((w h)^-2), roundoff of a0 grows as (w h)^2: they meet here
    matrix = measured_matrix(make_scene("oscillator"), {"alpha": alpha}, frequency)
    y, z, _ = matrix @ np.array([1.0, 0.0, -(frequency**2)])
    found = np.array([y, z / frequency**2, matrix[1, 1]])
    scale = (1.0 - alpha) ** 2
    position = (alpha**3 - alpha**2 - alpha - 1.0) / (scale * (1.0 + alpha))  # in [-1, 1]
    limits = np.array([position, -(alpha**2) / scale, (alpha**2 + 2.0 * alpha - 1.0) / scale])
    text = f"y1/y0 = {y:.4f}, y'1/(w y0) = {z / frequency**2:.4f} w h, y'1/y'0 = {matrix[1, 1]:.4f}"
    claim = f"alpha = {NAMES[alpha]}, w h = 1e4: {text}: error against their limits; no overshoot in y"
    return below_row("overshoot", claim, float(np.max(np.abs(found - limits))), 1e-6)


def curves() -> list[Plot]:
    """The three plots, zeta = 0; closed forms last, so that they are drawn over the lines between the marks."""
    up_to = [x for x in MEASURED if x <= GUIDED_UP_TO]
    found = [("guided", -0.15, _measured("guided", {"alpha": -0.15, "b": 0.25}, up_to))]
    found += [("measured", alpha, _measured("oscillator", {"alpha": alpha}, MEASURED)) for alpha in DRAWN]
    found += [("closed form", alpha, {x: roots(alpha, x) for x in CLOSED}) for alpha in DRAWN]
    slow = [(name, alpha, {x: r for x, r in at.items() if x <= SMOOTH}) for name, alpha, at in found if name != "guided"]
    damped = [(name, alpha, at) for name, alpha, at in slow if alpha != 0.0]
    return [
        _plot("radius", "Spectral radius", "radius", RADIUS, found, lambda r, x: radius(r)),
        _plot("damping", "Damping ratio", "damping ratio", DAMPING, damped, lambda r, x: swing_of(r, x).damping),
        _plot(
            "elongation",
            "Period elongation",
            "relative elongation",
            ELONGATION,
            slow,
            lambda r, x: swing_of(r, x).elongation,
        ),
    ]


Found = list[tuple[str, float, dict[float, Spectrum]]]  # what is drawn, alpha, and eigenvalues by w h


def _measured(name: str, method: Method, frequencies: Iterable[float]) -> dict[float, Spectrum]:
    scene = make_scene(name)
    return {x: spectrum(measured_matrix(scene, method, x)) for x in frequencies}


def _plot(id: str, title: str, y_label: str, caption: str, found: Found, of: Callable[[Spectrum, float], float]) -> Plot:
    lines = []
    for name, alpha, at in found:
        values = tuple(max(of(eigenvalues, x), 0.0) or math.nan for x, eigenvalues in at.items())
        lines.append(Curve(label=f"alpha = {NAMES[alpha]}, {name}", x=tuple(at), y=values))
    x_label = "\N{GREEK SMALL LETTER OMEGA} h"
    return Plot(id=id, title=title, caption=caption, x_label=x_label, y_label=y_label, curves=tuple(lines))


REACTIONS = ("implicit", 0.0), ("implicit", 0.25), ("predictor", 0.0), ("predictor", 0.25), ("midpoint", 0.0)
METHODS = tuple({"b": b, "reaction": reaction} for reaction, b in (*REACTIONS, ("midpoint_predictor", 0.0)))
IMPLICIT, HALF, MIDPOINT = METHODS[0], METHODS[1], METHODS[4]
UP_TO_1E4 = ((1e-2, 0.0), (1.0, 0.05), (1e2, 0.0), (1e4, 0.05))  # w h and zeta of the constrained scenes
UP_TO_1E8 = tuple((10.0**k, zeta) for k in range(-2, 9) for zeta in (0.0, 0.05))
OSCILLATOR: tuple[Study, ...] = tuple((one_step, "oscillator", (alpha,), IMPLICIT, UP_TO_1E8) for alpha in ALPHAS)
STUDIES: tuple[Study, ...] = (
    *OSCILLATOR,
    *((rho_inf, rho) for rho in (1.0, 0.9, 0.7, 0.55, 0.5)),
    *((swing, "oscillator", {**IMPLICIT, "alpha": alpha}, x, 2000.0 * x) for alpha in ALPHAS for x in (0.05, 0.1)),
    *((overshoot, alpha) for alpha in ALPHAS),
    *((one_step, "guided", ALPHAS, method, UP_TO_1E4) for method in METHODS),
    *((one_step, "mixed", ALPHAS, method, UP_TO_1E4) for method in (IMPLICIT, HALF, METHODS[3], MIDPOINT)),
    (one_step, "rolling", ALPHAS, IMPLICIT, UP_TO_1E4),
    *((swing, "bead", {**method, "alpha": alpha}, 0.1, 20) for method in (HALF, MIDPOINT) for alpha in (0.0, -0.3)),
    (curves,),
)
