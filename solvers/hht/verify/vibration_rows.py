"""Rows that hold what was measured by stepping an oscillator, free or guided, against its closed forms."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from hhtbench.evidence import Row
from solvers.hht.verify.closed import Swing, invariants_error, radius, roots, series, spectrum, swing_of
from solvers.hht.verify.measure import below_row
from solvers.hht.verify.orders import ALPHAS, NAMES
from solvers.hht.verify.vibration import STEP, Scene, long_run, measured_matrix, oscillator, pair, read_swing

SIMPLE = 10.0  # w h up to which all roots are well apart
SLACK = {"matrix": 1e-12, "simple": 1e-11, "double": 1e-7, "triple": 1e-5}  # of a root: roundoff, its square and cube root
AGREES = 1e-3  # relative: zero crossings of straight lines and peaks of cubics
LEADING = 0.02  # relative: what the first term of the series leaves out at w h = 0.1
KEPT = 1e-8  # damping ratio that counts as none: roundoff and cubics at the peaks of ten periods


def method_name(method: dict[str, Any]) -> str:
    """The method without its damping."""
    return f"{method['reaction']}, b = {method['b']:g}"


def matrix_rows(
    scene: Scene, alphas: Iterable[float], method: dict[str, Any], cases: Iterable[tuple[float, float]]
) -> list[Row]:
    """Invariants and spectral radius of the measured matrix, worst over ``alphas`` and ``cases`` (w h, zeta)."""
    label = scene.name + ("" if scene.free.size == 1 else f", {method_name(method)}")
    matrix, simple, multiple = 0.0, 0.0, 0.0
    cases, alphas = list(cases), list(alphas)
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
        below_row(f"matrix/{scene.name}", f"{seen}: trace, minors, determinant of one step", matrix, SLACK["matrix"]),
        Row(
            id=f"radius/{scene.name}",
            claim=f"{seen}: spectral radius of one step, error up to w h = {SIMPLE:g}, above",
            measured=f"{simple:.1e}, {multiple:.1e}",
            bound=f"< {SLACK['simple']:g}, < {loose:g}",
            passed=simple < SLACK["simple"] and multiple < loose,
        ),
    ]


def rho_inf_row(rho: float) -> Row:
    """``HHT(system, rho_inf=rho)`` has that spectral radius at the highest frequency, (H18)."""
    measured = radius(spectrum(measured_matrix(oscillator(), {"rho_inf": rho}, 1e8, 0.0)))
    bound = 1e-5 if rho == 0.5 else 1e-6  # at 1/2 the radius comes down as (w h)^(-2/3) only
    claim = f"HHT(rho_inf={rho:g}), w h = 1e8: spectral radius of one step less rho_inf"
    return below_row("rho_inf", claim, abs(measured - rho), bound)


def swing_rows(alpha: float, periods: float) -> list[Row]:
    """Damping ratio and period elongation at w h = 0.05 and 0.1 from one run of both."""
    slow = 0.05
    solution = long_run(pair(), {"alpha": alpha}, slow, 0.0, periods)
    rows: list[Row] = []
    for i, frequency in enumerate((slow, 2.0 * slow)):
        found = read_swing(solution, lambda q, v, i=i: (q[:, i], v[:, i]), frequency / STEP)  # type: ignore[misc]
        exact, leading = swing_of(roots(alpha, frequency, 0.0), frequency), series(alpha, frequency)
        claim = f"alpha = {NAMES[alpha]}, w h = {frequency:g}, {periods * (i + 1):g} periods"
        rows.append(
            _swing_row("damping/oscillator", f"{claim}: damping ratio", found.damping, exact.damping, leading.damping)
        )
        rows.append(
            _swing_row("elongation/oscillator", f"{claim}: period", found.elongation, exact.elongation, leading.elongation)
        )
    return rows


def _swing_row(id: str, claim: str, found: float, exact: float, leading: float) -> Row:
    if leading == 0.0:
        return below_row(id, claim, abs(found), KEPT)
    return Row(
        id=id,
        claim=f"{claim} (eigenvalue {exact:.5g}, series {leading:.5g})",
        measured=f"{found:.5g}",
        bound=f"{AGREES:.1%} of the eigenvalue, {LEADING:.0%} of the series",
        passed=abs(found - exact) < AGREES * abs(exact) and abs(found - leading) < LEADING * abs(leading),
    )


def agreement_row(id: str, claim: str, found: Swing, exact: Swing, agrees: float = AGREES) -> Row:
    """A row for damping and elongation that must both be those of ``exact``; where it has no damping, below KEPT."""
    damping, longer = abs(found.damping - exact.damping), abs(found.elongation - exact.elongation)
    return Row(
        id=id,
        claim=f"{claim}: damping ratio ({exact.damping:.4g}) and elongation ({exact.elongation:.4g}), error",
        measured=f"{damping:.1e}, {longer:.1e}",
        bound=f"{agrees:.1%} of each",
        passed=damping < max(agrees * abs(exact.damping), KEPT) and longer < agrees * abs(exact.elongation),
    )


def overshoot_row(alpha: float) -> Row:
    """The first step from y0 with a0 = f0, and from y'0, in the limit of (H18) for w h -> infinity."""
    frequency = 1e4  # the limit is reached to O((w h)^-2), roundoff of a0 grows as (w h)^2: they meet here
    matrix = measured_matrix(oscillator(), {"alpha": alpha}, frequency, 0.0)
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
    return row if abs(y) <= 1.0 else Row(id="overshoot", claim=claim, measured=y, bound="in [-1, 1]", passed=False)


def swing_row(scene: Scene, method: dict[str, Any], alpha: float, periods: float = 10) -> Row:
    """Damping and elongation of the free vibration of a constrained scene at w h = 0.1."""
    solution = long_run(scene, {**method, "alpha": alpha}, 0.1, 0.0, periods)
    along = scene.along
    found = read_swing(solution, lambda q, v: (q @ along, v @ along), 0.1 / STEP)
    claim = f"{scene.name}, {method_name(method)}, alpha = {NAMES[alpha]}, w h = 0.1, {periods:g} periods"
    return agreement_row(f"damping/{scene.name}", claim, found, swing_of(roots(alpha, 0.1, 0.0), 0.1))
