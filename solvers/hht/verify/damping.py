"""``hhtbench verify damping``: spectral radius, damping, period and overshoot against closed forms.

Scenes with constraints must have those of the oscillator: reactions do not enter the tangential motion.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.evidence import Curve, Evidence, Plot, Row
from solvers.hht.step.state import State
from solvers.hht.verify.measure import step_by_hand
from solvers.hht.verify.study import ALPHAS, NAMES, Method, Progress, Study, below_row, verify
from solvers.hht.verify.vibration import (
    STEP,
    Scene,
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

SIMPLE = 10.0  # w h up to which all roots are well apart
SLACK = {"matrix": 1e-12, "simple": 1e-11, "double": 1e-7, "triple": 1e-5}  # of a root: roundoff, its square and cube root
AGREES = 1e-3  # relative: zero crossings of straight lines and peaks of cubics
LEADING = 0.02  # relative: what the first term of the series leaves out at w h = 0.1
KEPT = 1e-8  # damping ratio that counts as none: roundoff and cubics at the peaks of ten periods
SILENT = 1e-5  # change of q, v and of multipliers that a normal error of one in a0 may leave
DRAWN = (0.0, -0.05, -0.15, -1.0 / 3.0)  # -0.3 would lie on -1/3
MEASURED = tuple(np.logspace(-2, 8, 31).tolist())  # w h; fewer than the report's most marks
CLOSED = tuple(np.logspace(-2, 8, 601).tolist())  # more than those: a line without marks
SMOOTH = 1.0 + 1e-9  # w h up to which a vibration is resolved: six steps a period
GUIDED_UP_TO = 1e4  # w h of the guided scene: Newton's iteration fails far above it, as springs across are as stiff
X_LABEL = "\N{GREEK SMALL LETTER OMEGA} h"
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


def one_step(name: str, alphas: Sequence[float], method: Method, cases: Iterable[tuple[float, float]]) -> list[Row]:
    """Invariants and spectral radius of one step of a scene, worst over ``alphas`` and ``cases`` (w h, zeta)."""
    scene, cases = make_scene(name), list(cases)
    label = name if scene.free.size == 1 else f"{name}, {_variant(method)}"
    matrix, simple, multiple = 0.0, 0.0, 0.0
    for alpha in alphas:
        for frequency, zeta in cases:
            measured = measured_matrix(scene, {**method, "alpha": alpha}, frequency, zeta)
            matrix = max(matrix, invariants_error(measured, alpha, frequency, zeta))
            wrong = abs(radius(spectrum(measured)) - radius(roots(alpha, frequency, zeta)))
            simple, multiple = (max(simple, wrong), multiple) if frequency <= SIMPLE else (simple, max(multiple, wrong))
    loose = SLACK["triple"] if ALPHAS[-1] in alphas else SLACK["double"]
    highest = max(frequency for frequency, _ in cases)
    seen = f"{label}, alpha = {', '.join(NAMES[a] for a in alphas)}, w h = 0.01 ... {highest:g}, zeta = 0 and 0.05"
    return [
        below_row(f"matrix/{name}", f"{seen}: trace, minors, determinant of one step", matrix, SLACK["matrix"]),
        Row(
            id=f"radius/{name}",
            claim=f"{seen}: spectral radius of one step, error up to w h = {SIMPLE:g}, above",
            measured=f"{simple:.1e}, {multiple:.1e}",
            bound=f"< {SLACK['simple']:g}, < {loose:g}",
            passed=simple < SLACK["simple"] and multiple < loose,
        ),
    ]


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
    alpha = method["alpha"]
    found = measured_swing(make_scene(name), method, frequency, periods)
    exact, leading = swing_of(roots(alpha, frequency), frequency), series(alpha, frequency)
    rows = []
    for quantity in ("damping", "elongation"):
        measured, root, first = (getattr(x, quantity) for x in (found, exact, leading))
        close = abs(measured - root) < AGREES * abs(root) and abs(measured - first) < LEADING * abs(first)
        rows.append(
            Row(
                id=f"{quantity}/{name}",
                claim=f"{name}, {_variant(method)}, alpha = {NAMES[alpha]}, w h = {frequency:g}, {periods:g} periods: "
                f"{quantity} (eigenvalue {root:.5g}, series {first:.5g})",
                measured=f"{measured:.5g}",
                bound=f"{AGREES:.1%} of the eigenvalue, {LEADING:.0%} of the series" if first else f"< {KEPT:g}",
                passed=close if first else abs(measured) < KEPT,
            )
        )
    return rows


def overshoot(alpha: float) -> Row:
    """The first step from y0 with a0 = f0, and from y'0, in the limit of (H18) for w h -> infinity."""
    frequency = 1e4  # the limit is reached to O((w h)^-2), roundoff of a0 grows as (w h)^2: they meet here
    matrix = measured_matrix(make_scene("oscillator"), {"alpha": alpha}, frequency)
    y, z, _ = matrix @ np.array([1.0, 0.0, -(frequency**2)])
    found = np.array([y, z / frequency**2, matrix[1, 1]])
    scale = (1.0 - alpha) ** 2
    position = (alpha**3 - alpha**2 - alpha - 1.0) / (scale * (1.0 + alpha))
    limits = np.array([position, -(alpha**2) / scale, (alpha**2 + 2.0 * alpha - 1.0) / scale])
    claim = (
        f"alpha = {NAMES[alpha]}, w h = 1e4: y1/y0 = {y:.4f}, y'1/(w y0) = {z / frequency**2:.4f} w h, y'1/y'0 = "
        f"{matrix[1, 1]:.4f}: error against their limits; no overshoot in y"
    )
    row = below_row("overshoot", claim, float(np.max(np.abs(found - limits))), 1e-6)
    return row if abs(y) <= 1.0 else replace(row, measured=y, bound="in [-1, 1]", passed=False)


def ringing(name: str, methods: Iterable[Method]) -> Row:
    """A normal error of one in a0 leaves q, v and the multipliers of later steps next to unchanged.

    The multipliers of the step itself take it up.  With velocity constraints q keeps ``(alpha h)^2 / 4`` of it and later
    multipliers the force of a spring stretched by that.
    """
    scene, states, multipliers = make_scene(name), 0.0, 0.0
    for method in [{**method, "alpha": alpha} for method in methods for alpha in (0.0, -0.3)]:
        honest, wrong = _five_states(scene, method, 0.0), _five_states(scene, method, 1.0)
        states = max(states, *(_largest(a.q - b.q, a.v - b.v) for a, b in zip(honest, wrong, strict=True)))
        for a, b in zip(honest[1:], wrong[1:], strict=True):
            multipliers = max(multipliers, _largest(a.lam - b.lam, a.mu - b.mu) / _largest(a.lam, a.mu))
    return Row(
        id=f"ringing/{name}",
        claim=f"{name}, every b and reaction, alpha = 0 and -0.3, h = {STEP:g}: what an error of 1 across in a0 does "
        "to q, v of the next five steps, and (relative) to the multipliers after the first",
        measured=f"{states:.1e}, {multipliers:.1e}",
        bound=f"< {SILENT:g}",
        passed=max(states, multipliers) < SILENT,
    )


def _five_states(scene: Scene, method: Method, error: float) -> list[State]:
    """After a start with ``error`` [m/s^2] across the free direction in a0."""
    hht = scene.integrator(method, 0.1)
    hht.init_step(0.0, scene.free, np.zeros(scene.free.size), step=STEP)
    hht.restart(replace(hht.state, a=hht.state.a + error * scene.across, h=STEP))
    return [step_by_hand(scene.name, hht) for _ in range(5)]


def _largest(*parts: Vector) -> float:
    return float(np.abs(np.concatenate(parts)).max())


def curves() -> list[Plot]:
    """The three plots, zeta = 0; closed forms last, so that they are drawn over the lines between the marks."""
    found = [("measured", alpha, _measured("oscillator", {"alpha": alpha}, MEASURED)) for alpha in DRAWN]
    up_to = [x for x in MEASURED if x <= GUIDED_UP_TO]
    guided = ("guided", -0.15, _measured("guided", {"alpha": -0.15, "b": 0.25}, up_to))
    found += [("closed form", alpha, {x: roots(alpha, x) for x in CLOSED}) for alpha in DRAWN]
    radii = [(name, alpha, {x: radius(r) for x, r in at.items()}) for name, alpha, at in (guided, *found)]
    slow = [(name, alpha, {x: swing_of(r, x) for x, r in at.items() if x <= SMOOTH}) for name, alpha, at in found]
    damping = [(name, alpha, {x: s.damping for x, s in at.items()}) for name, alpha, at in slow if alpha != 0.0]
    longer = [(name, alpha, {x: s.elongation for x, s in at.items()}) for name, alpha, at in slow]
    return [
        _plot("radius", "Spectral radius", "radius", RADIUS, radii),
        _plot("damping", "Damping ratio", "damping ratio", DAMPING, damping),
        _plot("elongation", "Period elongation", "relative elongation", ELONGATION, longer),
    ]


def _measured(name: str, method: Method, frequencies: Iterable[float]) -> dict[float, Spectrum]:
    scene = make_scene(name)
    return {x: spectrum(measured_matrix(scene, method, x)) for x in frequencies}


def _plot(id: str, title: str, y_label: str, caption: str, found: list[tuple[str, float, dict[float, float]]]) -> Plot:
    lines = []
    for name, alpha, at in found:
        values = tuple(y if y > 0 else math.nan for y in at.values())
        lines.append(Curve(label=f"alpha = {NAMES[alpha]}, {name}", x=tuple(at), y=values))
    return Plot(id=id, title=title, caption=caption, x_label=X_LABEL, y_label=y_label, curves=tuple(lines))


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
    *((ringing, name, METHODS) for name in ("guided", "mixed", "rolling")),
    *((swing, "bead", {**method, "alpha": alpha}, 0.1, 20) for method in (HALF, MIDPOINT) for alpha in (0.0, -0.3)),
    (curves,),
)
