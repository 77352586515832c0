"""Rows M7 to M9, M12, M13: convergence orders, errors under error control, blind spots of the error estimate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import tested
from hhtbench.conformance.rows.judging import Cases, row, within
from hhtbench.conformance.scenes import SCENES
from hhtbench.conformance.scenes.circles import Oscillator
from hhtbench.conformance.scenes.linkages import DoublePendulum
from hhtbench.conformance.scenes.rod import problem
from hhtbench.conformance.scenes.scene import SPAN
from hhtbench.conformance.subject import ALPHAS, Subject

MOVING = [SCENES[name]() for name in ("position", "rheonomic", "velocity", "mixed")]
STEPS = (160, 320, 640, 1280)
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)


class Known(NamedTuple):
    """A problem with its known end state."""

    problem: hb.Problem
    end: Any  #: with q, v


@cache
def _integrated() -> tuple[Known, ...]:
    """Return a slider-crank and a double pendulum with end states by DOP853 on the underlying ODE."""
    crank = hb.load_problem("sundials_slider_crank")
    crank = replace(crank, t_span=(crank.t_span[0], crank.t_span[0] + SPAN[1]))
    q0, v0 = DoublePendulum.bent(0.5, 1.0)
    both = problem(DoublePendulum(), q0=q0, v0=v0, name="double pendulum")
    found = [hb.solve(x, "scipy(method='DOP853')", rtol=1e-12, atol=1e-13) for x in (crank, both)]
    return tuple(
        Known(x, hb.Motion(y.q[-1], y.v[-1], y.lam[-1], y.mu[-1])) for x, y in zip((crank, both), found, strict=True)
    )


def slope(x: Sequence[float], y: Sequence[float]) -> float:
    """Fit the slope of a straight line through the logarithms."""
    return float(np.polyfit(np.log(x), np.log(y), 1)[0])


def _errors(subject: Subject, known: Known, alpha: float, steps: int) -> list[float]:
    """Return the errors of q and v at the end."""
    given = known.problem
    found = subject.hht(given.system, alpha=alpha).solve(given.t_span, given.q0, given.v0, steps=steps)
    if not found.success:
        raise RuntimeError(found.message)
    return [float(np.abs(getattr(found, x)[-1] - getattr(known.end, x)).max()) for x in "qv"]


@row("M7", "six scenes with and without constraints; 160 to 1280 steps", "y and z of order 1.9 to 2.1")
def order(subject: Subject) -> Cases:
    """Yield the cases of row M7: six scenes with and without constraints; 160 to 1280 steps.

    Both alphas; errors at the end against the closed solutions, of the last two against DOP853.
    """
    closed = [Known(scene.problem, scene.exact(scene.problem.t_span[1])) for scene in MOVING]
    for known, alpha in product([*closed, *_integrated()], ALPHAS):
        errors = np.array([_errors(subject, known, alpha, n) for n in STEPS])
        for part, values in zip("qv", errors.T, strict=True):
            if values.min() > 1e-11:
                miss = within(abs(slope(STEPS, values) + 2), 0.1, "order off 2 by")
                yield f"{known.problem.name} alpha={alpha:g} {part}", miss


VERIFIED = "tests/hht/test_verify.py::test_rows_of_the_verification_hold"
M8 = tested(
    "M8",
    "the first problem of Jay and Negrut, a pendulum and a heavy top, multipliers as reported",
    "order 1.9 to 2.1",
    VERIFIED,
    "tests/hht/test_rivals.py::test_orders_and_drift_of_the_verification_hold",
)
M9 = tested(
    "M9",
    "steps 1:2, 1:0.2, random in [0.5, 2]",
    "order at least 1.9; without rescale_a below 1.7",
    VERIFIED,
    "tests/hht/test_verify.py::test_steps_of_one_to_five_keep_the_order",
)


@row(
    "M12",
    "pendulum at tolerances 1e-3..1e-9",
    "error falls with the tolerance, at most 20 tolerances; work as its power -1/3 to -1/2",
    known={"ida": (("1e-07",), "an error of 40 tolerances")},
)
def accuracy(subject: Subject) -> Cases:
    """Yield the cases of row M12: pendulum at tolerances 1e-3..1e-9.

    Of any solver: errors at the end against the closed solution; the power of the work is that of HHT's order only.
    """
    scene, tolerances = MOVING[0], TOLERANCES[: 4 if subject.engine == "python" else len(TOLERANCES)]
    for way, request in subject.alphas({}, {}).items():
        errors, steps = [], []
        for tolerance in tolerances:
            found = subject.ask(scene.problem, **request, rtol=tolerance, t_eval=[0.5, 1.0, 1.5])
            exact = [scene.exact(float(t)).q for t in found.t]
            errors.append(float(np.abs(found.q - exact).max()) if found.success else math.inf)
            steps.append(float(found.counters.steps_accepted or 1))
            yield f"{tolerance:g} {way}".strip(), within(errors[-1] / tolerance, 20, "error over the tolerance")
        falls = bool(np.all(np.diff(errors) < 0))
        yield f"falls {way}", "" if falls else f"errors {', '.join(f'{x:.1e}' for x in errors)}"
        if subject.is_hht:
            yield f"work {way}", within(abs(-slope(tolerances, steps) - 0.425), 0.125, "power of the work off -0.425 by")


class Falling(hb.System):
    """A mass in free fall: every estimate of its error is zero."""

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: weight."""
        return 0.0 * q - 9.81


@row("M13", "constant acceleration; vibration of w = 100", "growth bounded, error of v at most 20 n tolerances")
def blind_spots(subject: Subject) -> Cases:
    """Yield the cases of row M13: constant acceleration; vibration of w = 100.

    What an estimate does not see must not be stepped over without limit.
    """
    fallen = subject.hht(Falling()).solve((0.0, 10.0), [0.0], [1.0], rtol=1e-6)
    h = fallen.steps_data.h
    yield "growth", within((h[1:] / h[:-1]).max(), 1.5 + 1e-9, "growth")
    yield "fall", within(abs(fallen.q[-1, 0] - (10.0 - 0.5 * 9.81 * 100)), 1e-9, "fall off by")
    rung = subject.hht(Oscillator(stiffness=1e4)).solve((0.0, 1.0), [1.0], [0.0], rtol=1e-4, atol=1e-4)
    error = np.abs(rung.v[:, 0] + 100.0 * np.sin(100.0 * rung.t)).max()
    yield "vibration", within(error / (20 * 1e-4 * 100 * rung.counters.steps_accepted), 1.0, "vibration, share allowed:")
