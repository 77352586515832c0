"""What every solver does before its first step and after a failure: derive, check the start, name the cause."""

from __future__ import annotations

import dataclasses
import warnings
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue, ProblemError
from hhtbench.lowering import (
    CONSISTENT,
    AccelerationLevel,
    ConstraintLevels,
    Dynamics,
    Levels,
    Structure,
    augment,
    constraint_rank,
    derive,
    minimum_norm,
    padded,
    reduce_redundant,
    route_of,
    singular_at,
    unreduced,
)
from hhtbench.lowering.dynamics.jax_dynamics import large
from hhtbench.lowering.dynamics.kkt import Acceleration
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics
from hhtbench.lowering.dynamics.regular import AugmentedDynamics, ReducedDynamics
from hhtbench.protocol import NumpySystem, System
from hhtbench.result import Counters, Solution, Status
from solvers._finite import expect_finite, explain_nonfinite
from solvers._trust import as_arguments, check_sparsity, wrong_derivatives


@dataclass(frozen=True)
class Failure:
    """A step that could not be made, with its cause."""

    status: Status
    message: str


@dataclass(frozen=True)
class Place:
    """A point of the start: [s], (n,), (n,)."""

    t: float
    q: Vector
    v: Vector


def dynamics_for(system: System | NumpySystem, place: Place) -> Dynamics:
    """Derived functions with a regular mass; declared derivatives that enter the equations are compared first.

    A wrong force Jacobian only slows Newton down; a wrong constraint Jacobian changes the motion, so it is
    replaced, with a warning.
    """
    dynamics = derive(system, place.t, place.q, place.v)
    if large(dynamics) is not None:  # its Jacobians are never full: none that is declared is called
        return dynamics
    check_sparsity(dynamics, place.t, place.q, place.v)
    wrong = wrong_derivatives(system, dynamics, place.t, place.q, place.v)
    if wrong:
        warnings.warn(
            f"the declared {', '.join(wrong)} disagrees with the derivative of what is declared and is not used; "
            "`hhtbench check` shows the entries.",
            UserWarning,
            stacklevel=2,
        )
        dynamics = derive(system, place.t, place.q, place.v, ignored=tuple(wrong))
    return regular(independent(dynamics, place), place)


def independent(dynamics: Dynamics, place: Place) -> Dynamics:
    """``dynamics`` itself, or without the rows of its constraints that depend on others at ``place``, with a warning."""
    if not dynamics.structure.constrained:
        return dynamics
    at = ConstraintLevels(dynamics).at(place.t, place.q, place.v)
    rows = np.concatenate([at.position_jacobian, at.velocity_jacobian])
    if not np.isfinite(rows).all() or not rows.any(axis=1).all():
        return dynamics  # the start's own check says what is wrong
    rank = constraint_rank(at.position_jacobian, at.velocity_jacobian)
    reduced = reduce_redundant(dynamics, rank.redundant) if rank.redundant else None
    if reduced is None:
        return dynamics
    warnings.warn(
        f"redundant constraints: {rank.text}. The solver works without those rows; multipliers are those of least norm.",
        UserWarning,
        stacklevel=2,
    )
    return reduced


def regular(dynamics: Dynamics, place: Place) -> Dynamics:
    """``dynamics`` itself, or augmented where its mass is singular at ``place``."""
    if not dynamics.structure.constrained or not singular_at(dynamics, place.t, place.q):
        return dynamics
    return augment(dynamics, *as_arguments(dynamics, place.t, place.q))


def undetermined(dynamics: Dynamics, place: Place) -> Failure | None:
    """Without constraints a singular mass leaves accelerations undetermined."""
    if dynamics.structure.constrained or not singular_at(dynamics, place.t, place.q):
        return None
    message = "the mass matrix is singular at the start and no constraint determines the accelerations"
    return Failure(Status.singular_iteration_matrix, f"{message}; give every coordinate a mass")


def inconsistency(levels: ConstraintLevels, place: Place, *, reduced: bool = False) -> Failure | None:
    """None for a consistent start; else the violated rows with their sizes, or the redundant rows.

    ``reduced``: the solver works without those.

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity.
    """
    at = finite_levels(levels, place.t, place.q, place.v)
    text = violations(at, place, CONSISTENT)
    if text:
        message = f"the start violates {text}; correct q0, v0 or ask for calc_initcond=True"
        return Failure(Status.inconsistent_initial, message)
    if isinstance(
        at.position_jacobian, csr_array
    ):  # a pivoted QR would be dense; dependent rows make the KKT matrix singular
        return None
    rank = constraint_rank(at.position_jacobian, at.velocity_jacobian)
    if rank.redundant and not reduced:
        return Failure(Status.redundant_constraints, f"the constraint Jacobian at the start has {rank.text}")
    return None


def violations(at: Levels, place: Place, bound: float) -> str:
    """Rows above ``bound`` in words, position level first; empty when there are none."""
    position, velocity = at.misfits(place.q, place.v)
    wrong = [row for row in position + velocity if not row.relative <= bound]
    return ", ".join(f"{row.name} = {row.value:.3g} ({row.relative:.1g} of its size)" for row in wrong)


def finite_levels(levels: ConstraintLevels, t: float, q: Vector, v: Vector) -> Levels:
    """The constraint levels at one point; raises :class:`NonFiniteValue` naming the function that is not finite."""
    at = levels.at(t, q, v)
    expect_finite("constraint", at.position, t)
    expect_finite("constraint_jacobian", at.position_jacobian, t)
    expect_finite("velocity_constraint", at.velocity, t)
    expect_finite("velocity_constraint_jacobian", at.velocity_jacobian, t)
    expect_finite("the velocity level of the constraints", at.velocity_drift, t)
    return at


def all_multipliers(
    dynamics: Dynamics, work: Work, t: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix
) -> tuple[Matrix, Matrix]:
    """Multipliers (k, m) and (k, p) of all rows, of least norm where the solver works without the redundant ones.

    Where the time budget ends before, zeros stand for the redundant ones in the rest.
    """
    whole = unreduced(dynamics)
    if whole is dynamics:
        return lam, mu
    lam, mu = padded(dynamics, lam, mu)
    levels, m = ConstraintLevels(whole), whole.structure.m
    rank = dynamics.structure.m + dynamics.structure.p
    for i in range(len(lam)):
        try:
            work.check_time()
            at = levels.at(float(t[i]), q[i], v[i])
        except BudgetSpent:
            break
        rows = np.concatenate([at.position_jacobian, at.velocity_jacobian])
        lam[i], mu[i] = np.split(minimum_norm(rows, np.concatenate([lam[i], mu[i]]), rank), [m])
    return lam, mu


Guesses = tuple[Vector | None, Vector | None]  # of lam (m,) and mu (p,)


def check_guesses(structure: Structure, guesses: Guesses) -> None:
    """Raise unless guessed multipliers have one entry per constraint."""
    for name, guess, size in (("lam_guess", guesses[0], structure.m), ("mu_guess", guesses[1], structure.p)):
        if guess is not None and guess.shape != (size,):
            raise ProblemError(f"{name} must have shape ({size},), one entry per constraint; got {guess.shape}.")


def start_acceleration(
    level: AccelerationLevel, dynamics: Dynamics, work: Work, place: Place, guesses: Guesses
) -> Acceleration | Failure:
    """Accelerations and multipliers of the start, or why there are none.

    Raises
    ------
    NonFiniteValue
        A function of the system is not finite at the start.
    """
    t, q, v = place.t, place.q, place.v
    found = level.solve(t, q, v, *guesses)
    work.add("residual_evaluations", points_of(dynamics))
    if found.singular:
        message = "the KKT matrix [[M, C^T], [C, 0]] is singular at the start: accelerations are not determined"
        return Failure(Status.singular_iteration_matrix, message)
    if not np.all(np.isfinite(found.vdot)):
        explain_nonfinite(dynamics, t, q, v)
    if not found.converged:
        message = "no multipliers satisfy the acceleration level at the start from lam_guess; give a better guess"
        return Failure(Status.newton_failed, message)
    return found


def acceleration_at(
    level: AccelerationLevel, dynamics: Dynamics, work: Work, t: float, q: Vector, v: Vector, guesses: Guesses
) -> Acceleration:
    """The acceleration level at one output time; a stray value that is not finite is tried once more."""
    for last in (False, True):
        try:
            found = level.solve(t, q, v, *guesses)
            work.add("residual_evaluations", points_of(dynamics))
            if not (np.isfinite(found.lam).all() and np.isfinite(found.mu).all()):
                explain_nonfinite(dynamics, t, q, v)
            break
        except NonFiniteValue:
            work.add("nonfinite_evaluations")
            if last:
                raise
    return found


def points_of(dynamics: Dynamics) -> int:
    """Evaluations of F to count per call of a compiled function; 0 for a NumPy system, whose callbacks are counted."""
    return 0 if route_of(dynamics) == "numpy" else 1


def budget_failure(spent: BudgetSpent, t: float) -> Failure:
    """The status of a spent budget, with the time it has lasted for."""
    status = Status.deadline if spent.budget == "seconds" else Status.evaluation_budget
    return Failure(status, f"{spent} at t = {t:.17g}; {status.text}")


def counted_dynamics(dynamics: Dynamics, work: Work) -> Dynamics:
    """A NumPy system's dynamics tells ``work`` of every callback."""
    if isinstance(dynamics, NumpyDynamics):
        return dataclasses.replace(dynamics, on_call=work.on_call)
    if isinstance(dynamics, AugmentedDynamics | ReducedDynamics) and route_of(dynamics) == "numpy":
        return dataclasses.replace(dynamics, inner=counted_dynamics(dynamics.inner, work))
    return dynamics


def empty_solution(n: int, status: Status, message: str, counters: Counters) -> Solution:
    """A Solution without rows: nothing was integrated."""
    none = np.zeros((0, 0))
    rows = np.zeros((0, n))
    return Solution(t=np.zeros(0), q=rows, v=rows, lam=none, mu=none, status=status, message=message, counters=counters)
