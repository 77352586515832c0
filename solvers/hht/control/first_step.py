"""The length of the first step, and what stands for the point before it, from a look at the motion at the start."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.errors import NonFiniteValue
from solvers.hht.control.plan import STILL, ControlOptions
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.step.state import ControlMemory, State

if TYPE_CHECKING:
    from solvers.hht.run.engine import Engine

PROBE = 1e-3  # of the time in which v and v' change q and v by their own size: where the change of v' is looked at
CAUTION = 0.3  # of the step that the change of v' suggests: it is a guess, and a rejection costs a step
UNKNOWN = 1e-3  # of the interval, where v' does not change at the probe: at rest, in free fall


def prepared(engine: Engine, state: State, tolerances: Tolerances, options: ControlOptions, stop: float) -> State:
    """``state`` with what step control needs to begin or to begin again there, (H27).

    A probe along v and v' shows how fast v' changes, and so stands for the point before the first step.
    """
    if state.h is not None:  # stepping began without control: v' of a step belongs to its middle
        state = engine.with_multipliers(state) if engine.structure.constrained else replace(state, vdot=state.f)
    longest = min(abs(stop - state.t), options.max_step)
    probe = PROBE * min(longest, _time_scale(state, tolerances))
    jerk = _jerk(engine, state, math.copysign(probe, stop - state.t))
    suggested = _suggested(engine, state, tolerances, jerk, probe)
    h = options.first_step or max(min(longest, suggested or UNKNOWN * abs(stop - state.t)), options.min_step)
    signed = math.copysign(probe, stop - state.t)
    before = state.vdot if jerk is None else state.vdot - signed * jerk
    if engine.method.start == "shifted":
        shift = engine.method.coefficients.alpha * math.copysign(h, signed)
        a = engine.force(state.t + shift, state.q + shift * state.v, state.v + shift * state.vdot)[0]  # (H12)
        state = replace(state, a=a)
    return replace(state, memory=ControlMemory(h_next=h, last=signed, earlier=before, acceleration=state.vdot))


def _suggested(engine: Engine, state: State, tolerances: Tolerances, jerk: Vector | None, probe: float) -> float:
    """|h| [s] whose leading local errors are what is allowed: h^3/12 |v''| in q, h^3/12 |v'''| in v; 0: nothing is known.

    With ``start="f0"`` also |alpha| h^2 |v''| / 2 in v.
    """
    if jerk is None:
        return probe
    n = state.q.size
    weights = tolerances.weights(state, state) * math.sqrt(tolerances.relative(state))
    in_q, in_v, alpha = _norm(jerk / weights[:n]), _norm(jerk / weights[n:]), abs(engine.method.coefficients.alpha)
    if float(np.abs(jerk).max()) * probe <= STILL * float(np.abs(state.vdot).max(initial=0.0)):
        return 0.0
    candidates = [math.inf]
    if in_q > 0:
        candidates.append(CAUTION * (12 / in_q) ** (1 / 3))
    if in_v > 0:
        candidates.append(CAUTION * (12 / (in_v * _rate(state, jerk, probe))) ** (1 / 3))
    if in_v > 0 and alpha > 0 and engine.method.start == "f0":
        candidates.append(CAUTION * math.sqrt(2 / (alpha * in_v)))
    return min(candidates) if min(candidates) < math.inf else 0.0


def _rate(state: State, jerk: Vector, probe: float) -> float:
    """[1/s] at which v'' changes: as v' does by v'', or v by it and v'; at rest as little as can be."""
    change, speed, acceleration = _norm(jerk), _norm(state.v), _norm(state.vdot)
    rates = [change / acceleration] if acceleration > change * probe else []
    rates += [math.sqrt(change / speed)] if speed > change * probe**2 else []
    return max(min(rates, default=0.0), PROBE / probe)


def _time_scale(state: State, tolerances: Tolerances) -> float:
    """[s] in which q changes by its size along v, or along v' from rest; a q near zero is sized by its tolerances."""
    speed, acceleration, n = state.size_v, float(np.max(np.abs(state.vdot))), state.q.size
    relative, absolute = float(tolerances.rtol[:n].max()), float(tolerances.atol[:n].max())
    size = max(state.size_q, absolute / relative if relative > 0 else 0.0) or 1.0
    times = [size / speed] if speed > 0 else []
    times += [math.sqrt(size / acceleration)] if acceleration > 0 else []
    times += [speed / acceleration] if acceleration > 0 and speed > 0 else []
    return min(times, default=math.inf)


def _jerk(engine: Engine, state: State, h: float) -> Vector | None:
    """v'' (n,) from v' at the end of a step along v and v'; None where it cannot be had there."""
    if not math.isfinite(h) or state.t + h == state.t:
        return None
    t, q, v = state.t + h, state.q + h * state.v, state.v + h * state.vdot
    try:
        if engine.structure.constrained:
            found = engine.acceleration.solve(t, q, v, state.lam, state.mu)
            engine.work.add("residual_evaluations", engine.points)
            change = found.vdot - state.vdot
        else:
            change = engine.force(t, q, v)[0] - state.vdot
    except NonFiniteValue:
        return None
    return change / h if np.isfinite(change).all() else None


def _norm(x: Vector) -> float:
    return math.sqrt(float(x @ x) / x.size)
