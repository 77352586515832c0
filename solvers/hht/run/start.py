"""From q0, v0 to the first state: consistency, projection, multipliers and a0."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp

from hhtbench.arguments import Vector
from hhtbench.counting import Work
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import ConstraintLevels, Dynamics, size_of
from hhtbench.lowering.dynamics.jax_dynamics import large
from hhtbench.lowering.dynamics.kkt import Acceleration
from hhtbench.result import Status
from solvers._projection import closest
from solvers._start import (
    Failure,
    Place,
    as_arguments,
    expect_finite,
    finite_levels,
    start_acceleration,
    violations,
)
from solvers.hht.run.engine import Engine
from solvers.hht.step.state import State

PROJECTED = 1e-12  # scaled violation a projected start must reach
PROJECTION_STEPS = 50  # quadratic convergence needs 5; from far away it fails in bounded time


def first_state(engine: Engine, place: Place, lam: Vector | None, mu: Vector | None, h: float) -> State | Failure:
    """The state before the first step of signed length ``h`` [s]; the start must be consistent.

    Without constraints neither multipliers nor KKT matrix are touched.
    """
    t, q, v = place.t, place.q, place.v
    s = engine.structure
    found: Acceleration | None = None
    if s.constrained:  # first: where the KKT matrix is singular there may be no f either
        solved = start_acceleration(engine.acceleration, engine.dynamics, engine.work, place, (lam, mu))
        if isinstance(solved, Failure):
            return solved
        found = solved
    f0, inverse = engine.force(t, q, v)
    nothing = np.zeros(0)
    start = Acceleration(f0, nothing, nothing, converged=True, singular=False) if found is None else found
    a0 = f0
    if engine.method.start == "shifted":
        shift = engine.method.coefficients.alpha * h
        a0 = engine.force(t + shift, q + shift * v, v + shift * start.vdot)[0]  # (H12)
    return State(
        t=t,
        q=q,
        v=v,
        a=a0,
        f=f0,
        h=None,
        lam=start.lam,
        mu=start.mu,
        vdot=start.vdot,
        inverse_mass=inverse,
        unknowns=None,
        earlier=None,
        factorised=None,
        size_q=float(np.max(np.abs(q))),
        size_v=float(np.max(np.abs(v))),
    )


def project(dynamics: Dynamics, levels: ConstraintLevels, place: Place, work: Work) -> tuple[Place, str] | Failure:
    """The closest consistent start in the norm of the mass matrix, (H20), and what was moved how far.

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity at the start itself; on the way that is a failure to arrive.
    """
    finite_levels(levels, place.t, place.q, place.v)
    for _ in range(2):  # one value that is not finite is not the cause
        try:
            return _projected(dynamics, levels, place)
        except NonFiniteValue as error:
            work.add("nonfinite_evaluations")
            last = error
    return Failure(Status.inconsistent_initial, f"no consistent start was found near q0, v0: the way there leads to {last}")


def _projected(dynamics: Dynamics, levels: ConstraintLevels, place: Place) -> tuple[Place, str] | Failure:
    q, far = _project_position(dynamics, levels, place)
    if far is not None:
        return far
    v = place.v.copy()
    for _ in range(PROJECTION_STEPS):
        at = finite_levels(levels, place.t, q, v)
        rows = at.rows
        mass = _finite_mass(dynamics, place.t, q)
        change = closest(mass, rows, mass @ (v - place.v), at.velocity_drift)
        v = v + change
        if np.max(np.abs(change)) <= 1e-15 * max(1.0, float(np.max(np.abs(v)))):
            break
    moved = Place(place.t, q, v)
    text = violations(finite_levels(levels, place.t, q, v), moved, PROJECTED)
    if text:
        return Failure(Status.inconsistent_initial, f"no consistent start was found near q0, v0: {text} remain")
    note = f"calc_initcond moved q0 by {np.max(np.abs(q - place.q)):.3g} and v0 by {np.max(np.abs(v - place.v)):.3g}"
    return moved, note


def _project_position(dynamics: Dynamics, levels: ConstraintLevels, place: Place) -> tuple[Vector, Failure | None]:
    q = place.q.copy()
    for _ in range(PROJECTION_STEPS):
        at = finite_levels(levels, place.t, q, place.v)
        mass = _finite_mass(dynamics, place.t, q)
        change = closest(mass, at.position_jacobian, mass @ (q - place.q), at.position)
        q = q + change
        if np.max(np.abs(change), initial=0.0) <= 1e-15 * max(1.0, float(np.max(np.abs(q)))):
            break
    at = finite_levels(levels, place.t, q, place.v)
    if at.position.size and not np.max(at.scaled_position(size_of(q))) <= PROJECTED:
        message = f"no consistent position was found near q0: after {PROJECTION_STEPS} steps g = {at.position}"
        return q, Failure(Status.inconsistent_initial, message)
    return q, None


def _finite_mass(dynamics: Dynamics, t: float, q: Vector) -> Any:
    products = large(dynamics)
    if products is not None:
        return sp.diags_array(np.asarray(products.mass(t, q).values), format="csr")
    mass = np.asarray(dynamics.mass(*as_arguments(dynamics, t, q)))
    expect_finite("mass_matrix", mass, t)
    return mass
