"""Rows M3, M6, M14, M15: long runs, alpha, derivatives; and rows covered by tests of HHT."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Lane, tested
from hhtbench.conformance.rows.judging import Cases, refuses, row, within
from hhtbench.conformance.scenes.circles import Oscillator
from hhtbench.conformance.scenes.rod import plane
from hhtbench.conformance.subject import Subject

EVERY_ALPHA = (0.0, -0.05, -0.15, -0.3, -1.0 / 3.0)
STEP = 1.0 / 64.0  # [s]
DAMPING = "tests/hht/test_damping.py::test_"

M1 = tested(
    "M1",
    "one step on y'' = -w^2 y - 2 zeta w y' from unit vectors, 5 alphas, w h = 0.01..1e8",
    "trace, minors and determinant of the closed matrix, to 1e-12",
    f"{DAMPING}one_step_of_an_oscillator_is_the_closed_matrix",
    f"{DAMPING}constrained_scene_is_advanced_along_its_free_direction_by_the_closed_matrix",
)
M2 = tested(
    "M2",
    "spectral radius at w h = 1e8",
    "(1 + alpha)/(1 - alpha), to 1e-6; alpha = -1/3 to 1e-5",
    f"{DAMPING}the_fastest_vibration_keeps_rho_inf",
)
M4 = tested(
    "M4",
    "w h = 0.05, 0.1 over 100 periods",
    "damping and elongation of the series, to 2 %",
    f"{DAMPING}an_oscillator_has_the_damping_and_elongation_of_the_series",
)
M5 = tested(
    "M5",
    "w h = 1e4, a0 = f0",
    "velocity overshoot -w h alpha^2/(1 - alpha)^2, none of the position; to 1e-6",
    f"{DAMPING}the_first_step_overshoots_as_the_limit_says",
)


ROUNDING = {
    "hht": (tuple(f"energy at w h = 1e+0{k}" for k in (4, 5, 6, 7, 8)), "h^2 a rounds to eps (w h)^2 of q, THEORY.md 8")
}


@row("M3", "1e5 steps, w h = 1e-3..1e8, alpha in [-1/3, 0]", "no growth; alpha = 0 keeps the energy to 1e-9", known=ROUNDING)
def long_runs(subject: Subject) -> Cases:
    """Yield the cases of row M3: 1e5 steps, w h = 1e-3..1e8, alpha in [-1/3, 0].

    In the norm of the energy, over that after the first step; 2,000 steps where they run in Python.
    """
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


@row("M6", "alpha outside [-1/3, 0], NaN, text", "ValueError, no clamping")
def bad_alpha(subject: Subject) -> Cases:
    """Yield the cases of row M6: invalid alpha, passed to HHT and in a solver's spec."""
    bad: list[Any] = [0.01, 1.0, -0.34, -1.0, 1e-15, np.nan, np.inf, "-0.3", 1j, [-0.1, -0.2], True]
    for x in bad:
        yield repr(x), refuses(partial(subject.hht, plane(), alpha=x), "alpha")
        yield f"spec {x!r}", refuses(partial(subject.fresh, alpha=x), "alpha")


M10 = tested(
    "M10",
    "error control, any history of errors",
    "no step grows by more than 1.5",
    "tests/hht/test_control.py::test_the_controller_never_grows_by_more_than_a_half",
)
M11 = tested(
    "M11",
    "an error of 1 m/s^2 across the constraint in a0",
    "y, z change by less than 1e-5, no ringing in lambda",
    f"{DAMPING}an_error_of_a0_across_the_constraints_does_not_ring_and_one_along_them_does",
)


@row("M14", "derivatives of all example problems' step residuals", "equal to differences", lane=Lane.slow)
def derivatives(subject: Subject) -> Cases:
    """Yield the cases of row M14: derivatives of all example problems' step residuals.

    What the blocks consist of, on every problem; their assembly: tests/hht/test_discretise.py.
    """
    return _checked(subject, lambda id: id.startswith("derivative"))


@row("M15", "g, G and d(Gz)/dt of every problem", "consistent to 1e-7", lane=Lane.slow)
def consistent(subject: Subject) -> Cases:
    """Yield the cases of row M15: g, G and d(Gz)/dt of every problem.

    By ``hhtbench check``.
    """
    return _checked(subject, lambda id: "constraint" in id)


def _checked(subject: Subject, wanted: Any) -> Cases:
    subject.hht(plane())
    for name in hb.list_problems():
        rows = hb.check(hb.load_problem(name)).rows
        yield name, ", ".join(x.id for x in rows if wanted(x.id) and x.passed is False)
