"""What is known before a step: Newmark weights, the places of the reactions, a0 after a change of step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from solvers.hht.coefficients import Method
from solvers.hht.layout import Layout
from solvers.hht.state import State

MUCH_SHORTER = 0.01  # of the last step: many growths of 1.5 followed by one such shrink are unstable in the stiff limit


def rescaled_acceleration(state: State, h: float) -> Vector:
    """a0 for a step of another length than the last, (H11); near f(t + alpha h) again, f itself for a far shorter one."""
    if state.h is None or state.h == h:
        return state.a
    if abs(h) < MUCH_SHORTER * abs(state.h):
        return state.f
    return state.f + (h / state.h) * (state.a - state.f)  # (H11)


def first_acceleration(method: Method, state: State, h: float, a1: Vector) -> Vector:
    """The a0 that a step of length ``h`` [s] from ``state`` to ``a1`` was made with, (H11), (H12)."""
    if state.h is None and method.start == "trapezoidal":
        alpha = method.coefficients.alpha
        return (alpha * a1 + state.f) / (1.0 + alpha)  # (H12)
    return rescaled_acceleration(state, h) if method.rescale_a else state.a


def known_values(
    method: Method, layout: Layout, inverse_mass: Callable[..., Any], state: State, h: float, t1: float
) -> dict[str, Any]:
    """The values that :meth:`Layout.pack` packs for the step from ``state`` to ``t1``.

    ``inverse_mass(t, q)`` is called only where a reaction is taken at a place known in advance and the mass varies.
    """
    c = method.coefficients
    a0 = rescaled_acceleration(state, h) if method.rescale_a else state.a
    from_end = 0.0
    if state.h is None and method.start == "trapezoidal":
        from_end = c.alpha / (1.0 + c.alpha)  # (H12): a0 = from_end * a1 + the rest, by (H6)
        a0 = (1.0 / (1.0 + c.alpha)) * state.f
    q, v = state.q, state.v
    half = 0.5 * h * h
    values: dict[str, Any] = {
        "h": h,
        "t1": t1,
        "alpha": c.alpha,
        "q_a": half * (2.0 * c.beta + (1.0 - 2.0 * c.beta) * from_end),
        "v_a": h * (c.gamma + (1.0 - c.gamma) * from_end),
        "q_known": q + h * v + half * (1.0 - 2.0 * c.beta) * a0,
        "v_known": v + h * (1.0 - c.gamma) * a0,
        "f0": state.f,
        "inverse_mass": state.inverse_mass,
    }
    if layout.structure.m:
        values |= _reaction_values(method.reaction, c.b, state, h, t1)
        if "inverse_mass_stage" in layout.arrays:
            values["inverse_mass_stage"] = inverse_mass(values["t_stage"], values["q_stage"])
    if layout.structure.p:
        values |= {"t_half": state.t + 0.5 * h, "q_half": q + 0.5 * h * v, "v0": v}  # (H10)
    return values


def _reaction_values(reaction: str, b: float, state: State, h: float, t1: float) -> dict[str, Any]:
    """Weights and place of the two stage reactions, (H8) with the predictor (H9)."""
    half, predicted = 0.5 * h * h, state.q + h * state.v  # (H9)
    values = {"t0": state.t, "q0": state.q, "q_R0": half * (1.0 - b), "q_R1": half * b, "v_R0": 0.5 * h, "v_R1": 0.5 * h}
    if reaction == "implicit":
        return values | {"t_stage": t1, "q_stage": np.zeros_like(state.q), "theta": 1.0}
    if reaction == "predictor":
        return values | {"t_stage": t1, "q_stage": predicted, "theta": 0.0}
    values |= {"v_R0": 0.0, "v_R1": h, "t_stage": state.t + 0.5 * h}
    if reaction == "midpoint":
        return values | {"q_stage": 0.5 * state.q, "theta": 0.5}
    return values | {"q_stage": 0.5 * (state.q + predicted), "theta": 0.0}
