"""The consistent start nearest to one that is given, for every solver."""

from __future__ import annotations

import numpy as np

from hhtbench.counting import Work
from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import Dynamics, size_of, unreduced
from hhtbench.result import Status
from solvers._projection import MOST_ITERATIONS, PROJECTED, Projection
from solvers._start import Failure, Guesses, Place, check_start, finite_levels, of_dynamics, violations

AT_REST = 1e-15  # of v0: constraints that leave no more of a velocity leave none


def consistent_start(
    dynamics: Dynamics, place: Place, guesses: Guesses, work: Work, *, calc_initcond: bool
) -> tuple[Place, str] | Failure:
    """Where the motion begins, and what was moved how far: ``place``, or the consistent start nearest to it.

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity.
    ProblemError
        A guess has not one entry per constraint.
    """
    at, note = place, ""
    if calc_initcond and dynamics.structure.constrained:
        projected = project(dynamics, place, work)
        if isinstance(projected, Failure):
            return projected
        at, note = projected
    return check_start(dynamics, of_dynamics(unreduced(dynamics)).levels, at, guesses) or (at, note)


def project(dynamics: Dynamics, place: Place, work: Work) -> tuple[Place, str] | Failure:
    """The closest consistent start in the norm of the mass matrix, (H20), and what was moved how far.

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity at the start itself; on the way that is a failure to arrive.
    """
    projection = Projection(dynamics)
    finite_levels(projection.levels, place.t, place.q, place.v)
    for _ in range(2):  # one value that is not finite is not the cause
        try:
            return _projected(projection, place)
        except NonFiniteValue as error:
            work.add("nonfinite_evaluations")
            last = error
    return Failure(Status.inconsistent_initial, f"no consistent start was found near q0, v0: the way there leads to {last}")


def _projected(projection: Projection, place: Place) -> tuple[Place, str] | Failure:
    t, levels = place.t, projection.levels
    q = projection.position(t, place.q, place.v)
    at = finite_levels(levels, t, q, place.v)
    if at.position.size and not np.max(at.scaled_position(size_of(q))) <= PROJECTED:
        message = f"no consistent position was found near q0: after {MOST_ITERATIONS} steps g = {at.position}"
        return Failure(Status.inconsistent_initial, message)
    v = projection.velocity(t, q, projection.velocity(t, q, place.v))  # twice: the first leaves roundoff of v0
    if np.abs(v).max(initial=0.0) <= AT_REST * np.abs(place.v).max(initial=0.0):
        v = np.zeros_like(v)
    moved = Place(t, q, v)
    text = violations(finite_levels(levels, t, q, v), moved, PROJECTED)
    if text:
        return Failure(Status.inconsistent_initial, f"no consistent start was found near q0, v0: {text} remain")
    note = f"calc_initcond moved q0 by {np.max(np.abs(q - place.q)):.3g} and v0 by {np.max(np.abs(v - place.v)):.3g}."
    return moved, note
