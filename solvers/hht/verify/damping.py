"""``hhtbench verify damping``: radius, damping, period and overshoot of the integrator against closed forms."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from hhtbench.evidence import Evidence, Row
from solvers.hht.verify.closed import roots, swing_of
from solvers.hht.verify.damping_plots import plots
from solvers.hht.verify.guided import bead_row, ringing_row, stiff_row
from solvers.hht.verify.measure import Progress
from solvers.hht.verify.orders import ALPHAS, NAMES
from solvers.hht.verify.vibration import (
    STEP,
    Driven,
    Guided,
    Mixed,
    Rolling,
    constrained,
    long_run,
    oscillator,
    read_swing,
)
from solvers.hht.verify.vibration_rows import agreement_row, matrix_rows, overshoot_row, rho_inf_row, swing_row, swing_rows

FREQUENCIES = tuple(10.0**k for k in range(-2, 9))  # w h
UP_TO_1E4 = ((1e-2, 0.0), (1.0, 0.05), (1e2, 0.0), (1e4, 0.05))  # w h and zeta of the constrained scenes
ZETAS = (0.0, 0.05)
PERIODS = 100
METHODS: tuple[dict[str, Any], ...] = (
    {"b": 0.0, "reaction": "implicit"},
    {"b": 0.25, "reaction": "implicit"},
    {"b": 0.0, "reaction": "predictor"},
    {"b": 0.25, "reaction": "predictor"},
    {"b": 0.0, "reaction": "midpoint"},
    {"b": 0.0, "reaction": "midpoint_predictor"},
)


def verify_damping(progress: Progress | None = None, jobs: int = 1) -> Evidence:
    """What ``alpha`` or ``rho_inf`` does to vibrations, measured by stepping; a minute on one core.

    Parameters
    ----------
    progress
        Told what is being measured, a line each.
    jobs
        Not used: most of the minute is compilation that the parts share.
    """
    tell = progress or _nobody
    started = time.perf_counter()
    rows: list[Row] = []
    for part in PARTS:
        tell(part.__name__.strip("_").replace("_", " "))
        rows += part()
    tell("curves")
    title, drawn = "Damping in the user's terms", plots()
    return Evidence(title=title, rows=tuple(rows), plots=drawn, seconds=time.perf_counter() - started)


def _nobody(line: str) -> None:
    """Progress that is not shown."""


def _oscillator() -> list[Row]:
    cases = [(frequency, zeta) for frequency in FREQUENCIES for zeta in ZETAS]
    return [row for alpha in ALPHAS for row in matrix_rows(oscillator(), (alpha,), METHODS[0], cases)]


def _rho_inf() -> list[Row]:
    return [rho_inf_row(rho) for rho in (1.0, 0.9, 0.7, 0.55, 0.5)]


def _long_runs() -> list[Row]:
    return [row for alpha in ALPHAS for row in swing_rows(alpha, PERIODS)]


def _damped() -> list[Row]:
    rows = []
    for alpha in ALPHAS:
        solution = long_run(oscillator(), {"alpha": alpha}, 0.1, 0.05, 5)
        found = read_swing(solution, lambda q, v: (q[:, 0], v[:, 0]), 0.1 / STEP)
        claim = f"alpha = {NAMES[alpha]}, zeta = 0.05, w h = 0.1, 5 periods"
        rows.append(agreement_row("damping/damped", claim, found, swing_of(roots(alpha, 0.1, 0.05), 0.1)))
    return rows


def _overshoot() -> list[Row]:
    return [overshoot_row(alpha) for alpha in ALPHAS]


def _constrained() -> list[Row]:
    """The tangential matrix of the extended form is that of the oscillator, whatever b and the reaction."""
    rows: list[Row] = []
    some = (METHODS[0], METHODS[1], METHODS[3], METHODS[4])
    for name, kind, methods in (("guided", Guided, METHODS), ("mixed", Mixed, some)):
        for method in methods:
            rows += matrix_rows(constrained(name, kind), ALPHAS, method, UP_TO_1E4)
    for method in some:
        rows += matrix_rows(constrained("driven", Driven), ALPHAS, method, UP_TO_1E4[:3])
    return rows + matrix_rows(constrained("rolling", Rolling), ALPHAS, METHODS[0], UP_TO_1E4)


def _constrained_swings() -> list[Row]:
    scenes = [(constrained("guided", Guided), method) for method in METHODS]
    scenes += [(constrained("rolling", Rolling), METHODS[0])]
    scenes += [(constrained("mixed", Mixed), method) for method in (METHODS[0], METHODS[3])]
    return [swing_row(scene, method, alpha) for scene, method in scenes for alpha in (0.0, -0.3)]


def _nothing_rings() -> list[Row]:
    kinds = (("guided", Guided), ("mixed", Mixed), ("rolling", Rolling))
    return [ringing_row(constrained(name, kind), METHODS) for name, kind in kinds]


def _bead_on_a_circle() -> list[Row]:
    return [bead_row({**method, "alpha": alpha}) for method in (METHODS[1], METHODS[4]) for alpha in (0.0, -0.3)]


def _stiff_across() -> list[Row]:
    scenes = constrained("guided", Guided), constrained("rolling", Rolling)
    return [stiff_row(scene, frequency) for scene in scenes for frequency in (1e5, 1e6, 1e7, 1e8)]


PARTS: tuple[Callable[[], list[Row]], ...] = (
    _oscillator,
    _rho_inf,
    _long_runs,
    _damped,
    _overshoot,
    _constrained,
    _constrained_swings,
    _nothing_rings,
    _bead_on_a_circle,
    _stiff_across,
)
