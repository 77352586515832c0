"""Why a step was not made, in words that say what to do."""

from __future__ import annotations

import numpy as np

from hhtbench.result import Status
from solvers._start import Failure
from solvers.hht.control.plan import ByError, Plan
from solvers.hht.equations.coefficients import NEAR_HALF
from solvers.hht.equations.formulas import SHORT
from solvers.hht.loops import memory as mem
from solvers.hht.run.engine import Engine
from solvers.hht.step.state import State

RESIDUAL = "the step's residual"  # what is named where every function is finite one by one


def failure_of(engine: Engine, plan: Plan, state: State, ended: int) -> Failure:
    """Of the step from ``state`` that the loops tried last and left with ``ended``."""
    numbers, by_error = engine.loops.section(mem.ATTEMPT), plan.by_error
    h, t = float(numbers[mem.H_TRIED]), state.t
    where = f"in the step from t = {t:.17g} with h = {h:g}"
    if ended == mem.NO_ADVANCE:
        text = f"t = {t:.17g} cannot be advanced by h = {h:g}; {Status.time_resolution.text}"
        return Failure(Status.time_resolution, text)
    if by_error is not None and ended in (mem.TOO_LARGE, mem.ROUNDOFF_REACHED):
        return _too_large(by_error, state, numbers, roundoff=ended == mem.ROUNDOFF_REACHED)
    cause = engine.explain(state, float(numbers[mem.T_END])) if ended in (mem.NONFINITE, mem.SINGULAR) else None
    if ended == mem.NONFINITE or (cause is not None and cause.function != RESIDUAL):
        return Failure(Status.nonfinite_callback, f"{cause}, {where}")
    if ended == mem.SINGULAR:
        return Failure(Status.singular_iteration_matrix, f"the matrix of the step has a zero pivot, {where}")
    near = abs(engine.method.coefficients.b - 0.5) < NEAR_HALF
    remedy = "b is close to the singular value 1/2, take b = 0" if near else "take a smaller step"
    return Failure(Status.newton_failed, f"Newton's iteration did not converge, {where}; {remedy}")


def _too_large(plan: ByError, before: State, numbers: np.ndarray, *, roundoff: bool) -> Failure:
    """The error of the last step that was tried is more than what is allowed."""
    o, t, h, error = plan.options, before.t, abs(float(numbers[mem.H_TRIED])), float(numbers[mem.ERROR_SIZE])
    text = f"at t = {t:.17g} the error of a step of {h:.3g} s is {error:.3g} times what the tolerances allow"
    if roundoff:
        first = float(numbers[mem.FIRST_H])
        text += f", that of {abs(first):.3g} s was {numbers[mem.FIRST_ERROR]:.3g} times" if abs(first) != h else ""
        return Failure(Status.step_too_small, f"{text}: {plan.tolerances.reachable(before, first)}")
    by_times = o.min_step < o.spacings * float(np.spacing(abs(t)))
    moved = h * max(before.size_v, h * float(np.abs(before.vdot).max()))
    if by_times and moved > SHORT * before.size_q:  # at a jump steps become so short that nothing moves
        return Failure(Status.time_resolution, f"{text}; {Status.time_resolution.text}")
    return Failure(Status.step_too_small, f"{text}; {Status.step_too_small.text}")
