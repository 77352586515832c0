"""From q0, v0 to the first state: consistency, projection, multipliers and a0."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import ConstraintLevels, Levels, augment, constraint_rank, derive, mass_is_singular
from hhtbench.protocol import NumpySystem, System, declared
from hhtbench.result import Status
from solvers.hht.engine import Failure, HostEngine, as_arguments, expect_finite
from solvers.hht.state import State

CONSISTENT = 1e-8  # scaled violation up to which a start counts as consistent: data given with eight digits
PROJECTED = 1e-12  # scaled violation a projected start must reach
PROJECTION_STEPS = 50  # quadratic convergence needs 5; from far away it fails in bounded time
TRUSTED = 1e-5  # relative difference up to which a declared derivative agrees with the derived one
EQUATIONS = {  # declared derivatives that enter the equations, with the arguments after t
    "constraint_jacobian": "q",
    "constraint_time_derivative": "q",
    "constraint_acceleration": "qv",
    "velocity_constraint_jacobian": "qv",
    "reaction_jacobians": "ql",  # the second one: the multipliers are solved for with it
}


@dataclass(frozen=True)
class Place:
    """A point of the start: [s], (n,), (n,)."""

    t: float
    q: Vector
    v: Vector


def dynamics_for(system: System | NumpySystem, place: Place) -> Any:
    """Derived functions with a regular mass; declared derivatives that enter the equations are compared first.

    A wrong force Jacobian only slows Newton down; a wrong constraint Jacobian changes the motion, so it is
    replaced, with a warning.
    """
    dynamics = derive(system, place.t, place.q, place.v)
    wrong = _wrong_derivatives(system, dynamics, place)
    if wrong:
        warnings.warn(
            f"the declared {', '.join(wrong)} disagrees with the derivative of what is declared and is not used; "
            "`hhtbench check` shows the entries.",
            UserWarning,
            stacklevel=2,
        )
        dynamics = derive(system, place.t, place.q, place.v, ignored=tuple(wrong))
    return regular(dynamics, place)


def regular(dynamics: Any, place: Place) -> Any:
    """``dynamics`` itself, or augmented where its mass is singular at ``place``, (H19)."""
    if dynamics.structure.mass == "identity" or not dynamics.structure.constrained:
        return dynamics
    if not _mass_is_singular(dynamics, place):
        return dynamics
    return augment(dynamics, *as_arguments(dynamics, place.t, place.q))


def undetermined(dynamics: Any, place: Place) -> Failure | None:
    """Without constraints a singular mass leaves accelerations undetermined."""
    if dynamics.structure.constrained or dynamics.structure.mass == "identity" or not _mass_is_singular(dynamics, place):
        return None
    message = "the mass matrix is singular at the start and no constraint determines the accelerations"
    return Failure(Status.singular_iteration_matrix, f"{message}; give every coordinate a mass")


def _mass_is_singular(dynamics: Any, place: Place) -> bool:
    mass = np.asarray(dynamics.mass(*as_arguments(dynamics, place.t, place.q)))
    return bool(np.all(np.isfinite(mass))) and mass_is_singular(mass)


def _wrong_derivatives(system: System | NumpySystem, dynamics: Any, place: Place) -> list[str]:
    names = [name for name in EQUATIONS if declared(system, name) is not None]
    if not names:
        return []
    derived = derive(system, place.t, place.q, place.v, ignored=tuple(names))
    v = place.v + max(1.0, float(np.max(np.abs(place.v)))) * np.cos(np.arange(1.0, place.v.size + 1))  # no entry at rest
    values = {"q": place.q, "v": v, "l": np.cos(np.arange(1.0, dynamics.structure.m + 1))}
    wrong = []
    for name in names:
        arguments = as_arguments(dynamics, place.t, *(values[letter] for letter in EQUATIONS[name]))
        try:
            given, wanted = getattr(dynamics, name)(*arguments), getattr(derived, name)(*arguments)
        except NonFiniteValue:
            if EQUATIONS[name] == "q":
                raise
            continue  # at a made-up velocity or multiplier the system need not be defined
        pairs = zip(given, wanted, strict=True) if isinstance(given, tuple) else [(given, wanted)]
        if not all(_agree(np.asarray(x), np.asarray(y)) for x, y in pairs if x is not None):
            wrong.append(name)
    return wrong


def _agree(given: Matrix, wanted: Matrix) -> bool:
    """Whether two derivatives are equal where both are finite; one that is not is found and named where it is used."""
    both = np.isfinite(given) & np.isfinite(wanted)
    size = max(1.0, float(np.max(np.abs(wanted[both]), initial=0.0)))
    return np.allclose(given[both], wanted[both], rtol=TRUSTED, atol=TRUSTED * size)


def first_state(
    engine: HostEngine, place: Place, lam: Vector | None, mu: Vector | None, h: float
) -> State | Failure:
    """The state before the first step of signed length ``h`` [s]; the start must be consistent.

    Without constraints neither multipliers nor KKT matrix are touched.
    """
    t, q, v = place.t, place.q, place.v
    s = engine.structure
    f0, inverse = engine.force(t, q, v)
    vdot, lam0, mu0 = f0, np.zeros(0), np.zeros(0)
    if s.constrained:
        found = engine.acceleration.solve(t, q, v, lam, mu)
        engine.work.add("residual_evaluations", engine.points)
        if found.singular:
            message = "the KKT matrix [[M, C^T], [C, 0]] is singular at the start: accelerations are not determined"
            return Failure(Status.singular_iteration_matrix, message)
        if not np.all(np.isfinite(found.vdot)):
            engine.explain_nonfinite(t, q, v)
        if found.residual > 0:
            message = "no multipliers satisfy the acceleration level at the start from lam_guess; give a better guess"
            return Failure(Status.newton_failed, message)
        vdot, lam0, mu0 = found.vdot, found.lam, found.mu
    a0 = f0
    if engine.method.start == "shifted":
        shift = engine.method.coefficients.alpha * h
        a0 = engine.force(t + shift, q + shift * v, v + shift * vdot)[0]  # (H12)
    return State(
        t=t,
        q=q,
        v=v,
        a=a0,
        f=f0,
        h=None,
        lam=lam0,
        mu=mu0,
        vdot=vdot,
        inverse_mass=inverse,
        unknowns=None,
        earlier=None,
        factor=None,
        size_q=float(np.max(np.abs(q))),
        size_v=float(np.max(np.abs(v))),
    )


def inconsistency(levels: ConstraintLevels, place: Place) -> Failure | None:
    """None for a consistent start; else the violated rows with their sizes, or the redundant rows.

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity.
    """
    at = _finite_levels(levels, place.t, place.q, place.v)
    text = _violations(at, place, CONSISTENT)
    if text:
        message = f"the start violates {text}; correct q0, v0 or ask for calc_initcond=True"
        return Failure(Status.inconsistent_initial, message)
    rank = constraint_rank(at.position_jacobian, at.velocity_jacobian)
    if rank.redundant:
        return Failure(Status.redundant_constraints, f"the constraint Jacobian at the start has {rank.text}")
    return None


def project(dynamics: Any, levels: ConstraintLevels, place: Place, work: Work) -> tuple[Place, str] | Failure:
    """The closest consistent start in the norm of the mass matrix, (H20), and what was moved how far.

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity at the start itself; on the way that is a failure to arrive.
    """
    _finite_levels(levels, place.t, place.q, place.v)
    for _ in range(2):  # one stray value is not the cause
        try:
            return _projected(dynamics, levels, place)
        except NonFiniteValue as error:
            work.add("nonfinite_evaluations")
            last = error
    return Failure(Status.inconsistent_initial, f"no consistent start was found near q0, v0: the way there leads to {last}")


def _projected(dynamics: Any, levels: ConstraintLevels, place: Place) -> tuple[Place, str] | Failure:
    q, far = _project_position(dynamics, levels, place)
    if far is not None:
        return far
    v = place.v.copy()
    for _ in range(PROJECTION_STEPS):
        at = _finite_levels(levels, place.t, q, v)
        rows = np.concatenate([at.position_jacobian, at.velocity_jacobian], axis=0)
        mass = _finite_mass(dynamics, place.t, q)
        change = _closest(mass, rows, mass @ (v - place.v), at.velocity_drift)
        v = v + change
        if np.max(np.abs(change)) <= 1e-15 * max(1.0, float(np.max(np.abs(v)))):
            break
    moved = Place(place.t, q, v)
    text = _violations(_finite_levels(levels, place.t, q, v), moved, PROJECTED)
    if text:
        return Failure(Status.inconsistent_initial, f"no consistent start was found near q0, v0: {text} remain")
    note = f"calc_initcond moved q0 by {np.max(np.abs(q - place.q)):.3g} and v0 by {np.max(np.abs(v - place.v)):.3g}"
    return moved, note


def _project_position(dynamics: Any, levels: ConstraintLevels, place: Place) -> tuple[Vector, Failure | None]:
    q = place.q.copy()
    for _ in range(PROJECTION_STEPS):
        at = _finite_levels(levels, place.t, q, place.v)
        mass = _finite_mass(dynamics, place.t, q)
        change = _closest(mass, at.position_jacobian, mass @ (q - place.q), at.position)
        q = q + change
        if np.max(np.abs(change), initial=0.0) <= 1e-15 * max(1.0, float(np.max(np.abs(q)))):
            break
    at = _finite_levels(levels, place.t, q, place.v)
    if at.position.size and not np.max(at.scaled_position(_size(q))) <= PROJECTED:
        message = f"no consistent position was found near q0: after {PROJECTION_STEPS} steps g = {at.position}"
        return q, Failure(Status.inconsistent_initial, message)
    return q, None


def _finite_mass(dynamics: Any, t: float, q: Vector) -> Matrix:
    mass = np.asarray(dynamics.mass(*as_arguments(dynamics, t, q)))
    expect_finite("mass_matrix", mass, t)
    return mass


def _closest(mass: Matrix, rows: Matrix, pull: Vector, value: Vector) -> Vector:
    """One Newton step of: least mass-weighted change subject to ``value = 0``; rows may be dependent."""
    n, m = mass.shape[0], rows.shape[0]
    matrix = np.block([[mass, rows.T], [rows, np.zeros((m, m))]])
    return np.linalg.lstsq(matrix, -np.concatenate([pull, value]), rcond=1e-13)[0][:n]


def _violations(at: Levels, place: Place, bound: float) -> str:
    """Rows above ``bound`` in words, position level first; empty when there are none."""
    m = at.position.size
    named = [(f"g[{i}]", at.position[i], r) for i, r in enumerate(at.scaled_position(_size(place.q)))]
    names = [f"(g_t + g_q v)[{i}]" for i in range(m)] + [f"k[{i}]" for i in range(at.velocity.size)]
    scaled = at.scaled_velocity(max(float(np.max(np.abs(place.v))), np.finfo(float).tiny))
    named += list(zip(names, at.velocity_drift, scaled, strict=True))
    rows = [f"{name} = {value:.3g} ({relative:.1g} of its size)" for name, value, relative in named if not relative <= bound]
    return ", ".join(rows)


def _size(q: Vector) -> float:
    return float(np.max(np.abs(q))) or 1.0


def _finite_levels(levels: ConstraintLevels, t: float, q: Vector, v: Vector) -> Levels:
    at = levels.at(t, q, v)
    expect_finite("constraint", at.position, t)
    expect_finite("constraint_jacobian", at.position_jacobian, t)
    expect_finite("velocity_constraint", at.velocity, t)
    expect_finite("velocity_constraint_jacobian", at.velocity_jacobian, t)
    expect_finite("the velocity level of the constraints", at.velocity_drift, t)
    return at
