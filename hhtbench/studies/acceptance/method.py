"""Method and stability: the step against the closed forms, alpha, lengths of steps (rows M1 to M6, M10, M11, M14, M15)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.arguments import Matrix
from hhtbench.conformance.scenes.circles import Oscillator
from hhtbench.studies.acceptance.asked import ALPHAS, Asked
from hhtbench.studies.acceptance.rows import Finding, bounded, every, row
from hhtbench.studies.acceptance.scenes import PLAIN, Q0, V0, Rod, refuses

EVERY_ALPHA = (0.0, -0.05, -0.15, -0.3, -1.0 / 3.0)
FREQUENCIES = (0.1, 1.0, 10.0, 1e3, 1e8)  # times the step
STEP = 1.0 / 64.0  # [s]
MATRIX = 1e-12  # invariants of the step may be off by
KEPT, EPS = 1e-9, float(np.finfo(float).eps)  # of the energy


def measured_matrix(asked: Asked, alpha: float, frequency: float, zeta: float) -> Matrix:
    """(3, 3): what one step makes of the unit vectors of (y, h y', h^2 a)."""
    omega = frequency / STEP
    hht = asked.hht(Oscillator(stiffness=omega**2, damping=2.0 * zeta * omega), alpha=alpha)

    def end(y: float, z: float, a: float) -> list[float]:
        hht.init_step(0.0, [y], [z / STEP], step=STEP)
        hht.restart(replace(hht.state, a=np.array([a / STEP**2]), h=STEP))
        if hht.step() is not hb.Status.success:
            raise RuntimeError(hht.message)
        return [hht.state.q[0], STEP * hht.state.v[0], STEP**2 * hht.state.a[0]]

    return np.array([end(*unit) for unit in np.eye(3)]).T


def invariants(a: float, o: float, zeta: float) -> np.ndarray:
    """Trace, sum of the principal minors and determinant in closed form (acceptance 1.1)."""
    below = 4 + (1 - a) ** 2 * (1 + a) * o**2 + 4 * zeta * o * (1 + a) * (1 - 2 * a)
    trace = 8 + (3 * a**3 - a - 2) * o**2 - 12 * zeta * o * a * (1 + 2 * a)
    minors = 4 + (3 * a**3 + 3 * a**2 + a + 1) * o**2 - 4 * zeta * o * (6 * a**2 + 3 * a + 1)
    return np.array([trace, minors, a * o * ((1 + a) ** 2 * o - 4 * zeta * (1 + 2 * a))]) / below


def _of_matrix(x: Matrix) -> np.ndarray:
    minors = sum(x[i, i] * x[j, j] - x[i, j] * x[j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    return np.array([np.trace(x), minors, np.linalg.det(x)])


@row("M1", "one step on y'' = -w^2 y - 2 zeta w y' from unit vectors, 5 alphas, w h = 0.1..1e8", "the closed matrix")
def amplification(asked: Asked) -> Finding:
    """By its invariants."""
    return bounded(float(np.max([*step_errors(asked).values()])), MATRIX, "trace, minors, determinant off by")


def step_errors(asked: Asked) -> dict[tuple[float, float], float]:
    """By alpha and w h: by how much invariants of the step are off their closed forms, the largest of two dampings.

    Entries of a matrix at w h = 1e8 are 1e16, and what cancels there is lost to rounding: they are balanced first.
    """
    errors = {}
    for alpha in EVERY_ALPHA:
        for frequency in FREQUENCIES:
            balance = np.diag([max(frequency, 1.0), 1.0, 1.0 / max(frequency, 1.0)])
            steps = {zeta: balance @ measured_matrix(asked, alpha, frequency, zeta) for zeta in (0.0, 0.05)}
            found = [
                _of_matrix(x @ np.linalg.inv(balance)) - invariants(alpha, frequency, zeta) for zeta, x in steps.items()
            ]
            errors[alpha, frequency] = float(np.abs(found).max())
    return errors


@row("M2", "spectral radius at w h = 1e8", "(1 + alpha)/(1 - alpha), to 1e-6; alpha = -1/3 to 1e-5")
def radius(asked: Asked) -> Finding:
    """A double root carries the rounding of the entries as its square root."""
    shares = {}
    for alpha in EVERY_ALPHA:
        roots = np.linalg.eigvals(measured_matrix(asked, alpha, 1e8, 0.0))
        miss = abs(np.abs(roots).max() - (1 + alpha) / (1 - alpha))
        shares[alpha] = float(miss / (1e-5 if alpha < -0.33 else 1e-6))
    return bounded(max(shares.values()), 1.0, "share of what is allowed:")


@row("M3", "1e5 steps, w h = 1e-3..1e8, alpha in [-1/3, 0]", "no growth; alpha = 0 keeps the energy to 1e-9")
def long_runs(asked: Asked) -> Finding:
    """In the norm of the energy, over that after the first step."""
    if asked.engine == "python":
        return _grown(asked, 2_000)
    return _grown(asked, 100_000)


def _grown(asked: Asked, steps: int) -> Finding:
    """Beyond w h = 3e3 the energy is known to eps (w h)^2/2 only: so much of y is lost in its sum with h^2 a."""
    growth, lost = 0.0, {}
    for alpha in EVERY_ALPHA:
        for frequency in np.logspace(-3, 8, 12):
            omega = float(frequency) / STEP
            hht = asked.hht(Oscillator(stiffness=omega**2), alpha=alpha)
            found = hht.solve((0.0, steps * STEP), [1.0], [0.0], steps=steps)
            if not found.success:
                return Finding(measured=f"w h = {frequency:g}, alpha = {alpha:g}: {found.message}", holds=False)
            size = np.hypot(found.q[:, 0], found.v[:, 0] / omega)
            growth = max(growth, float(size.max() / max(1.0, size[1])))
            if alpha == 0.0:
                lost[float(frequency)] = float(np.abs(size - 1.0).max()) * 2
    kept = max((x for x in lost if max(lost[y] for y in lost if y <= x) <= KEPT), default=0.0)
    worst = max(lost, key=lost.__getitem__)
    shares = max(lost[x] / (EPS * x**2 / 2) for x in lost if x > kept) if kept < max(lost) else 0.0
    told = f"to {KEPT:g} up to w h = {kept:g}; at {worst:g} to {lost[worst]:.1e}"
    told += f", beyond at most {shares:.2g} of the rounding of h^2 a, eps (w h)^2/2" if shares else ""
    return Finding(
        measured=f"largest size {growth:.3g} of the first step's; alpha = 0 keeps the energy {told}; {steps} steps",
        holds=growth <= 10.0 and lost[worst] <= KEPT,
        failing=("growth",) * (growth > 10.0) + tuple(f"energy at w h = {x:.3g}" for x in lost if lost[x] > KEPT),
    )


@row("M4", "w h = 0.05, 0.1 over 100 periods", "damping and elongation of the series, to 2 %")
def damping(asked: Asked) -> Finding:
    """Of the decay of the peaks and the distances of the zeros."""
    worst = 0.0
    for alpha in (-0.05, -0.3, -1.0 / 3.0):
        for o in (0.05, 0.1):
            steps = int(np.ceil(200 * np.pi / o))
            found = asked.hht(Oscillator(stiffness=1.0), alpha=alpha).solve((0.0, steps * o), [1.0], [0.0], steps=steps)
            decay, elongation = _decay(found)
            xi, longer = -alpha * (1 + alpha) ** 2 * o**3 / 8, o**2 * (2 - 6 * alpha - 9 * alpha**2) / 24
            worst = max(worst, abs(decay / xi - 1), abs(elongation / longer - 1))
    return bounded(worst, 0.02, "off the series by")


def _decay(found: hb.Solution) -> tuple[float, float]:
    """Damping ratio and relative elongation of the period of ``y'' = -y``."""
    t, y, z = found.t, found.q[:, 0], found.v[:, 0]
    zeros, peaks = _roots(t, y), _roots(t, z)
    period = 2 * (zeros[-1] - zeros[0]) / (zeros.size - 1)
    heights = np.log(np.abs(found(peaks).q[:, 0]))
    return -float(np.polyfit(peaks, heights, 1)[0]), float(period / (2 * np.pi) - 1)


def _roots(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    at = np.flatnonzero(y[:-1] * y[1:] < 0)
    return np.asarray(t[at] + y[at] / (y[at] - y[at + 1]) * (t[at + 1] - t[at]))


@row("M5", "w h = 1e3, a0 = f0", "velocity overshoot -w h alpha^2/(1 - alpha)^2, none of the position; to 1e-6")
def overshoot(asked: Asked) -> Finding:
    """The limit of w h to infinity has its next term at 1/(w h)^2 of it, so it is taken of two frequencies."""
    worst, high = 0.0, 0.0
    for alpha in EVERY_ALPHA:
        (y, z), (_, far) = (_first_step(asked, alpha, o) for o in (1e3, 2e3))
        limit = (4 * far - z) / 3
        worst, high = max(worst, abs(limit + alpha**2 / (1 - alpha) ** 2)), max(high, abs(y))
    return Finding(
        measured=f"z1/(w h w y0) off by {worst:.1e}, |y1/y0| at most {high:.6f}", holds=worst <= 1e-6 and high <= 1
    )


def _first_step(asked: Asked, alpha: float, o: float) -> tuple[float, float]:
    """y1/y0 and z1/(w h w y0) of a step from y0 at rest."""
    x = measured_matrix(asked, alpha, o, 0.0)
    y, z, _ = x[:, 0] - o**2 * x[:, 2]
    return float(y), float(z / o**2)


@row("M6", "alpha outside [-1/3, 0], NaN, text", "ValueError, no clamping")
def bad_alpha(asked: Asked) -> Finding:
    """The same by the spec of the bench."""
    bad: list[Any] = [0.01, 1.0, -0.34, -1.0, 1e-15, np.nan, np.inf, "-0.3", 1j, [-0.1, -0.2], True]
    faults = {repr(x): refuses(partial(asked.hht, PLAIN.problem.system, alpha=x), "alpha") for x in bad}
    faults |= {f"spec {x!r}": refuses(partial(asked.solver, alpha=x), "alpha") for x in bad}
    return every(faults)


@row("M10", "error control in the stiff limit and on a pendulum", "no step grows by more than 1.5")
def growth(asked: Asked) -> Finding:
    """Random histories of errors: tests/hht/test_control.py."""
    worst = 0.0
    for alpha in ALPHAS:
        for system, q0, v0 in ((Rod(), Q0, V0), (Oscillator(stiffness=1e12), [1e-6], [0.0]), (Oscillator(), [1.0], [0.0])):
            h = asked.hht(system, alpha=alpha).solve((0.0, 2.0), q0, v0, rtol=1e-4).steps_data.h
            worst = max(worst, float((h[1:] / h[:-1])[:-1].max()))
    return bounded(worst, 1.5 * (1 + 1e-9), "largest growth")


@row(
    "M11",
    "an error of 1 m/s^2 across the constraint in a0",
    "y, z change by less than 1e-5 at h = 0.01, no ringing in lambda",
)
def wrong_a0(asked: Asked) -> Finding:
    """The local multipliers of the one step take it up."""
    moved, rung = 0.0, 0.0
    for alpha in ALPHAS:
        clean, disturbed = (asked.hht(Rod(), alpha=alpha) for _ in range(2))
        for hht in (clean, disturbed):
            hht.init_step(0.0, Q0, V0, step=0.01)
        disturbed.restart(replace(disturbed.state, a=disturbed.state.a + Q0))
        for count in range(20):
            clean.step(), disturbed.step()
            difference = np.abs(clean.state.q - disturbed.state.q).max(), np.abs(clean.state.v - disturbed.state.v).max()
            moved = max(moved, *difference) if count == 0 else moved
            pull = [x.state.v @ x.state.v - 9.81 * x.state.q[1] for x in (clean, disturbed)]  # the rod's tension
            rung = max(rung, abs(pull[0] - pull[1]))
    return Finding(
        measured=f"state moved by {moved:.1e}, lambda by {rung:.1e} in 20 steps", holds=moved < 1e-5 and rung < 1e-4
    )


@row("M14", "derivatives of all example problems' step residuals", "equal to differences", long=True)
def derivatives(asked: Asked) -> Finding:
    """What the blocks consist of, on every problem; their assembly: tests/hht/test_discretise.py."""
    return _checked(asked, lambda id: id.startswith("derivative"))


@row("M15", "g, G and d(Gz)/dt of every problem", "consistent to 1e-7", long=True)
def consistent(asked: Asked) -> Finding:
    """By ``hhtbench check``."""
    return _checked(asked, lambda id: "constraint" in id)


def _checked(asked: Asked, wanted: Any) -> Finding:
    asked.hht(PLAIN.problem.system)
    faults = {}
    for name in hb.list_problems():
        evidence = hb.check(hb.load_problem(name))
        wrong = [x.id for x in evidence.rows if wanted(x.id) and x.passed is False]
        faults[name] = ", ".join(wrong)
    return every(faults)
