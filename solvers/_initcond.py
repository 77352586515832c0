"""Checked start of a run: consistent or projected, with accelerations and multipliers, or the reason why there is none."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import issparse

from hhtbench.lowering import CONSISTENT, ConstraintLevels, Dynamics, size_of, unreduced
from hhtbench.lowering.dynamics.kkt_rows import Acceleration
from hhtbench.lowering.dynamics.rank import constraint_rank
from hhtbench.protocol.arguments import Vector, all_finite
from hhtbench.protocol.errors import NonFiniteValue, ProblemError
from hhtbench.protocol.system import NumpySystem, System
from hhtbench.solution.counting import Work
from hhtbench.solution.result import Status
from solvers._finite import explain_nonfinite
from solvers._start import (
    CORRECT,
    Begun,
    Failure,
    Guesses,
    PhasePoint,
    dynamics_for,
    finite_levels,
    of_dynamics,
    points_of,
    singular_mass,
    violations,
)

if TYPE_CHECKING:
    from solvers._projection import Projection

NEARLY = 1e-7  # relative difference of nearly dependent rows: a KKT matrix sees its square, about roundoff
AT_REST = 1e-15  # relative to q0 or v0: a projected state that is smaller is set to zero


def begun(
    system: System | NumpySystem, place: PhasePoint, guesses: Guesses, work: Work, *, calc_initcond: bool
) -> Begun | Failure:
    """The start at ``place`` after all checks.

    Raises
    ------
    NonFiniteValue
        A function of the system is not finite at the start.
    ProblemError
        A guess does not have one entry per constraint.
    """
    dynamics = dynamics_for(system, place)
    start = consistent_start(dynamics, place, guesses, work, calc_initcond=calc_initcond)
    if isinstance(start, Failure):
        return start
    place, note = start
    found = start_acceleration(dynamics, work, place, guesses)
    return found if isinstance(found, Failure) else Begun(dynamics, place, found, note)


def consistent_start(
    dynamics: Dynamics, place: PhasePoint, guesses: Guesses, work: Work, *, calc_initcond: bool
) -> tuple[PhasePoint, str] | Failure:
    """``place``, or with ``calc_initcond`` the consistent start nearest to it and a note on the distance.

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity.
    ProblemError
        A guess does not have one entry per constraint.
    """
    at, note = place, ""
    if calc_initcond and dynamics.structure.constrained:
        projected = project(dynamics, place, work)
        if isinstance(projected, Failure):
            return projected
        at, note = projected
    return check_start(dynamics, of_dynamics(unreduced(dynamics)).levels, at, guesses) or (at, note)


def project(dynamics: Dynamics, place: PhasePoint, work: Work) -> tuple[PhasePoint, str] | Failure:
    """The nearest consistent start in the norm of the mass matrix, (H20), and a note on the distance.

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian is not finite at the start itself; in later iterations this is a Failure.
    """
    from solvers._projection import Projection  # most starts are consistent

    projection = Projection(dynamics)
    finite_levels(projection.levels, place.t, place.q, place.v)
    for _ in range(2):  # one value that is not finite is not the cause
        try:
            return _projected(projection, place)
        except NonFiniteValue as error:
            work.add("nonfinite_evaluations")
            last = error
    return Failure(Status.inconsistent_initial, f"no consistent start was found near q0, v0: the way there leads to {last}")


def _projected(projection: Projection, place: PhasePoint) -> tuple[PhasePoint, str] | Failure:
    from solvers._projection import MAX_ITERATIONS, PROJECTED

    t, levels = place.t, projection.levels
    q = at_rest(projection.position(t, place.q, place.v), float(np.abs(place.q).max(initial=0.0)))
    at = finite_levels(levels, t, q, place.v)
    if at.position.size and not np.max(at.scaled_position(size_of(q))) <= PROJECTED:
        message = f"no consistent position was found near q0: after {MAX_ITERATIONS} steps g = {at.position}"
        return Failure(Status.inconsistent_initial, message)
    v = projection.velocity(t, q, projection.velocity(t, q, place.v))  # twice: the first leaves roundoff of v0
    v = at_rest(v, float(np.abs(place.v).max(initial=0.0)))
    moved = PhasePoint(t, q, v)
    text = violations(finite_levels(levels, t, q, v), moved, PROJECTED)
    if text:
        return Failure(Status.inconsistent_initial, f"no consistent start was found near q0, v0: {text} remain")
    note = f"calc_initcond moved q0 by {np.max(np.abs(q - place.q)):.3g} and v0 by {np.max(np.abs(v - place.v)):.3g}."
    return moved, note


def at_rest(x: Vector, size: float) -> Vector:
    """``x`` (n,), or zeros if all of it is roundoff of ``size``."""
    return np.zeros_like(x) if np.abs(x).max(initial=0.0) <= AT_REST * size else x


def check_start(dynamics: Dynamics, levels: ConstraintLevels, place: PhasePoint, guesses: Guesses) -> Failure | None:
    """Failure if no motion can begin at ``place``, else None; ``levels`` and ``guesses`` include redundant rows of [g; k].

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity.
    ProblemError
        A guess does not have one entry per constraint.
    """
    s = levels.structure
    if s.constrained:
        at = finite_levels(levels, place.t, place.q, place.v)
        if text := violations(at, place, CONSISTENT):
            return Failure(Status.inconsistent_initial, f"the start violates {text}; {CORRECT}")
        whole = unreduced(dynamics) is dynamics and not issparse(at.position_jacobian)  # there the KKT matrix shows it
        if whole and at.rank.redundant:
            return Failure(Status.redundant_constraints, f"the constraint Jacobian at the start has {at.rank.text}")
    elif singular_mass(dynamics, place):
        message = "the mass matrix is singular at the start and no constraint determines the accelerations"
        return Failure(Status.singular_iteration_matrix, f"{message}; give every coordinate a mass")
    for name, guess, size in (("lam_guess", guesses[0], s.m), ("mu_guess", guesses[1], s.p)):
        if guess is not None and guess.shape != (size,):
            raise ProblemError(f"{name} must have shape ({size},), one entry per constraint; got {guess.shape}.")
    return None


def start_acceleration(dynamics: Dynamics, work: Work, place: PhasePoint, guesses: Guesses) -> Acceleration | Failure:
    """Accelerations and multipliers at the start, or a Failure; the guesses matter for nonlinear reactions only.

    Raises
    ------
    NonFiniteValue
        A function of the system is not finite at the start.
    """
    t, q, v = place.t, place.q, place.v
    known = of_dynamics(dynamics)
    found = known.acceleration.solve(t, q, v, *guesses)
    work.add("residual_evaluations", points_of(dynamics))
    if found.singular:
        at = known.levels.at(t, q, v)
        if issparse(at.position_jacobian) and at.ranked and at.rank.redundant:
            return Failure(Status.redundant_constraints, f"the constraint Jacobian at the start has {at.rank.text}")
        message = "the KKT matrix [[M, C^T], [C, 0]] is singular at the start: accelerations are not determined"
        nearly = constraint_rank(at.rows, NEARLY) if at.ranked else None
        if nearly and nearly.redundant:
            message += f", as rows nearly depend on others: up to {NEARLY:g} of their length {nearly.text}"
            message += "; take them out, or write them so that they differ by more"
        return Failure(Status.singular_iteration_matrix, message)
    if not all_finite(found.vdot):
        explain_nonfinite(dynamics, t, q, v)
    if not found.converged:
        message = "no multipliers satisfy the acceleration level at the start from lam_guess; give a better guess"
        return Failure(Status.newton_failed, message)
    return found
