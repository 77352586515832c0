"""Method and stability: the step against the closed forms, alpha, lengths of steps (rows M1 to M6, M10, M11, M14, M15)."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Lane
from hhtbench.conformance.rows.judging import Cases, refuses, row, within
from hhtbench.conformance.scenes.circles import Oscillator
from hhtbench.conformance.scenes.rod import Q0, V0, Rod, plane
from hhtbench.conformance.subject import ALPHAS, Subject
from hhtbench.protocol.arguments import Matrix

EVERY_ALPHA = (0.0, -0.05, -0.15, -0.3, -1.0 / 3.0)
FREQUENCIES = (0.1, 1.0, 10.0, 1e3, 1e8)  # times the step
STEP = 1.0 / 64.0  # [s]


def measured_matrix(subject: Subject, alpha: float, frequency: float, zeta: float) -> Matrix:
    """(3, 3): what one step makes of the unit vectors of (y, h y', h^2 a)."""
    omega = frequency / STEP
    hht = subject.hht(Oscillator(stiffness=omega**2, damping=2.0 * zeta * omega), alpha=alpha)

    def end(y: float, z: float, a: float) -> list[float]:
        hht.init_step(0.0, [y], [z / STEP], step=STEP)
        hht.restart(replace(hht.state, a=np.array([a / STEP**2]), h=STEP))
        if hht.step() is not hb.Status.success:
            raise RuntimeError(hht.message)
        return [hht.state.q[0], STEP * hht.state.v[0], STEP**2 * hht.state.a[0]]

    return np.array([end(*unit) for unit in np.eye(3)]).T


def invariants(a: float, o: float, zeta: float) -> np.ndarray:
    """Trace, sum of the principal minors and determinant of the step in closed form."""
    below = 4 + (1 - a) ** 2 * (1 + a) * o**2 + 4 * zeta * o * (1 + a) * (1 - 2 * a)
    trace = 8 + (3 * a**3 - a - 2) * o**2 - 12 * zeta * o * a * (1 + 2 * a)
    minors = 4 + (3 * a**3 + 3 * a**2 + a + 1) * o**2 - 4 * zeta * o * (6 * a**2 + 3 * a + 1)
    return np.array([trace, minors, a * o * ((1 + a) ** 2 * o - 4 * zeta * (1 + 2 * a))]) / below


def _of_matrix(x: Matrix) -> np.ndarray:
    minors = sum(x[i, i] * x[j, j] - x[i, j] * x[j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    return np.array([np.trace(x), minors, np.linalg.det(x)])


@row("M1", "one step on y'' = -w^2 y - 2 zeta w y' from unit vectors, 5 alphas, w h = 0.1..1e8", "the closed matrix")
def amplification(subject: Subject) -> Cases:
    """By its invariants; entries at w h = 1e8 are 1e16, and what cancels is lost to rounding: they are balanced first."""
    for alpha, o, zeta in product(EVERY_ALPHA, FREQUENCIES, (0.0, 0.05)):
        scale = np.array([max(o, 1.0), 1.0, 1.0 / max(o, 1.0)])
        found = _of_matrix(scale[:, None] * measured_matrix(subject, alpha, o, zeta) / scale)
        miss = np.abs(found - invariants(alpha, o, zeta)).max()
        yield f"alpha={alpha:.3g}, w h = {o:g}, zeta={zeta:g}", within(miss, 1e-12, "trace, minors, determinant off by")


@row("M2", "spectral radius at w h = 1e8", "(1 + alpha)/(1 - alpha), to 1e-6; alpha = -1/3 to 1e-5")
def radius(subject: Subject) -> Cases:
    """A double root carries the rounding of the entries as its square root."""
    for alpha in EVERY_ALPHA:
        roots = np.linalg.eigvals(measured_matrix(subject, alpha, 1e8, 0.0))
        miss = abs(np.abs(roots).max() - (1 + alpha) / (1 - alpha))
        yield f"alpha={alpha:.3g}", within(miss, 1e-5 if alpha < -0.33 else 1e-6)


ROUNDING = {
    "hht": (tuple(f"energy at w h = 1e+0{k}" for k in (4, 5, 6, 7, 8)), "h^2 a rounds to eps (w h)^2 of q, THEORY.md 8")
}


@row("M3", "1e5 steps, w h = 1e-3..1e8, alpha in [-1/3, 0]", "no growth; alpha = 0 keeps the energy to 1e-9", known=ROUNDING)
def long_runs(subject: Subject) -> Cases:
    """In the norm of the energy, over that after the first step; 2,000 steps where they run in Python."""
    steps = 2_000 if subject.engine == "python" else 100_000
    for alpha in EVERY_ALPHA:
        for frequency in np.logspace(-3, 8, 12):
            omega = float(frequency) / STEP
            hht = subject.hht(Oscillator(stiffness=omega**2), alpha=alpha)
            found = hht.solve((0.0, steps * STEP), [1.0], [0.0], steps=steps)
            if not found.success:
                raise RuntimeError(f"w h = {frequency:g}, alpha = {alpha:g}: {found.message}")
            size = np.hypot(found.q[:, 0], found.v[:, 0] / omega)
            growth = size.max() / max(1.0, size[1])
            yield f"growth at alpha={alpha:.3g}, w h = {frequency:.3g}", within(growth, 10.0, "sizes over the first step's:")
            if alpha == 0.0:
                yield f"energy at w h = {frequency:.3g}", within(2 * np.abs(size - 1.0).max(), 1e-9, "energy off by")


@row("M4", "w h = 0.05, 0.1 over 100 periods", "damping and elongation of the series, to 2 %")
def damping(subject: Subject) -> Cases:
    """Of the decay of the peaks and the distances of the zeros."""
    for alpha in (-0.05, -0.3, -1.0 / 3.0):
        for o in (0.05, 0.1):
            steps = int(np.ceil(200 * np.pi / o))
            found = subject.hht(Oscillator(stiffness=1.0), alpha=alpha).solve((0.0, steps * o), [1.0], [0.0], steps=steps)
            decay, elongation = _decay(found)
            xi, longer = -alpha * (1 + alpha) ** 2 * o**3 / 8, o**2 * (2 - 6 * alpha - 9 * alpha**2) / 24
            miss = max(abs(decay / xi - 1), abs(elongation / longer - 1))
            yield f"alpha={alpha:.3g}, w h = {o:g}", within(miss, 0.02, "off the series by")


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
def overshoot(subject: Subject) -> Cases:
    """The limit of w h to infinity has its next term at 1/(w h)^2 of it, so it is taken of two frequencies."""
    for alpha in EVERY_ALPHA:
        (y, z), (_, far) = (_first_step(subject, alpha, o) for o in (1e3, 2e3))
        limit = (4 * far - z) / 3
        yield f"alpha={alpha:.3g}, velocity", within(abs(limit + alpha**2 / (1 - alpha) ** 2), 1e-6, "z1/(w h w y0) off by")
        yield f"alpha={alpha:.3g}, position", within(abs(y), 1.0, "|y1/y0|")


def _first_step(subject: Subject, alpha: float, o: float) -> tuple[float, float]:
    """y1/y0 and z1/(w h w y0) of a step from y0 at rest."""
    x = measured_matrix(subject, alpha, o, 0.0)
    y, z, _ = x[:, 0] - o**2 * x[:, 2]
    return float(y), float(z / o**2)


@row("M6", "alpha outside [-1/3, 0], NaN, text", "ValueError, no clamping")
def bad_alpha(subject: Subject) -> Cases:
    """The same by the spec of the bench."""
    bad: list[Any] = [0.01, 1.0, -0.34, -1.0, 1e-15, np.nan, np.inf, "-0.3", 1j, [-0.1, -0.2], True]
    for x in bad:
        yield repr(x), refuses(partial(subject.hht, plane(), alpha=x), "alpha")
        yield f"spec {x!r}", refuses(partial(subject.fresh, alpha=x), "alpha")


@row("M10", "error control in the stiff limit and on a pendulum", "no step grows by more than 1.5")
def growth(subject: Subject) -> Cases:
    """Random histories of errors: tests/hht/test_control.py."""
    for alpha in ALPHAS:
        for system, q0, v0 in ((Rod(), Q0, V0), (Oscillator(stiffness=1e12), [1e-6], [0.0]), (Oscillator(), [1.0], [0.0])):
            h = subject.hht(system, alpha=alpha).solve((0.0, 2.0), q0, v0, rtol=1e-4).steps_data.h
            yield f"{system} alpha={alpha:g}", within((h[1:] / h[:-1])[:-1].max(), 1.5 * (1 + 1e-9), "growth")


@row("M11", "an error of 1 m/s^2 across the constraint in a0", "y, z change by less than 1e-5, no ringing in lambda")
def wrong_a0(subject: Subject) -> Cases:
    """The local multipliers of the one step take it up."""
    for alpha in ALPHAS:
        clean, disturbed = (subject.hht(Rod(), alpha=alpha) for _ in range(2))
        for hht in (clean, disturbed):
            hht.init_step(0.0, Q0, V0, step=0.01)
        disturbed.restart(replace(disturbed.state, a=disturbed.state.a + Q0))
        for count in range(1, 21):
            clean.step(), disturbed.step()
            moved = max(np.abs(getattr(clean.state, x) - getattr(disturbed.state, x)).max() for x in "qv")
            if count == 1:
                yield f"state alpha={alpha:g}", within(moved, 1e-5, "state moved by")
            pull = [x.state.v @ x.state.v - 9.81 * x.state.q[1] for x in (clean, disturbed)]  # the rod's tension
            yield f"lambda {count} alpha={alpha:g}", within(abs(pull[0] - pull[1]), 1e-4, "lambda by")


@row("M14", "derivatives of all example problems' step residuals", "equal to differences", lane=Lane.slow)
def derivatives(subject: Subject) -> Cases:
    """What the blocks consist of, on every problem; their assembly: tests/hht/test_discretise.py."""
    return _checked(subject, lambda id: id.startswith("derivative"))


@row("M15", "g, G and d(Gz)/dt of every problem", "consistent to 1e-7", lane=Lane.slow)
def consistent(subject: Subject) -> Cases:
    """By ``hhtbench check``."""
    return _checked(subject, lambda id: "constraint" in id)


def _checked(subject: Subject, wanted: Any) -> Cases:
    subject.hht(plane())
    for name in hb.list_problems():
        rows = hb.check(hb.load_problem(name)).rows
        yield name, ", ".join(x.id for x in rows if wanted(x.id) and x.passed is False)
