"""What every solver does before its first step: derive, check the start, find its accelerations and multipliers."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol

import numpy as np
from scipy.sparse import issparse

from hhtbench.arguments import Vector, all_finite
from hhtbench.counting import Work, uncounted
from hhtbench.errors import BudgetSpent, NonFiniteValue, ProblemError
from hhtbench.lowering import (
    CONSISTENT,
    AccelerationLevel,
    ConstraintLevels,
    Dynamics,
    Levels,
    augment,
    constraint_rank,
    derive,
    reduce_redundant,
    route_of,
    singular_at,
    unreduced,
)
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.dynamics.jax_dynamics import VariableMass, large, matrix_free
from hhtbench.lowering.dynamics.kkt import Acceleration
from hhtbench.lowering.dynamics.mass import infinite_entry
from hhtbench.lowering.dynamics.regular import with_full_matrices
from hhtbench.protocol import DERIVATIVES, NumpySystem, Problem, System, declared
from hhtbench.request import Request
from hhtbench.result import Status
from solvers._finite import expect_finite, explain_nonfinite
from solvers._trust import EQUATIONS, check_sparsity, wrong_derivatives

NEARLY = 1e-7  # of unit rows: a KKT matrix tells such rows apart by the square of it, which is about roundoff
CORRECT = "correct q0, v0 or pass calc_initcond=True to solve or init_step (hhtbench solve: --calc-initcond)"
INDEPENDENT = 1e-10  # pivots of a sparse KKT matrix, of the largest, above which no row of its constraints depends on others


@dataclass(frozen=True)
class Failure:
    """How a start, a step or a run ended, in most cases: that it failed, and the cause in words."""

    status: Status
    message: str


@dataclass(frozen=True)
class Place:
    """A point of the start: [s], (n,), (n,)."""

    t: float
    q: Vector
    v: Vector


class Solving(Protocol):
    """What belongs to one solve, whoever steps."""

    dynamics: Dynamics

    @property
    def acceleration(self) -> AccelerationLevel:
        """Of the constraints that are solved with."""

    @property
    def work(self) -> Work:
        """What is counted."""


Guesses = tuple[Vector | None, Vector | None]  # of lam (m,) and mu (p,)


def tried_twice(begin: Callable[[], Any], work: Work, t: float) -> Any:
    """What ``begin`` makes of the start at ``t`` [s], or a :class:`Failure`; one value that is not finite is no cause."""
    failure = None
    for _ in range(2):
        try:
            return begin()
        except NonFiniteValue as error:
            work.add("nonfinite_evaluations")
            failure = Failure(Status.nonfinite_callback, f"{error}, at the start")
        except BudgetSpent as spent:
            return budget_failure(spent, t)
    return failure


def absolute_tolerances(problem: Problem, request: Request) -> Vector:
    """Of q and v, (2n,): those of the request, or ``rtol`` times the problem's scales where it gives none."""
    n, scales, atol = problem.q0.size, problem.scales, request.atol
    if atol is None:
        typical, rtol = np.empty(2 * n), 0.0 if request.rtol is None else request.rtol
        typical[:n], typical[n:] = scales.q, scales.v
        return typical * (rtol if type(rtol) is float else np.resize(rtol, 2 * n))
    if np.shape(atol) not in ((), (n,), (2 * n,)):
        raise ProblemError(f"atol must be a number, ({n},) or ({2 * n},) for q and v; got shape {np.shape(atol)}.")
    return np.resize(np.asarray(atol, dtype=np.float64), 2 * n)


class OfDynamics:
    """What depends on a dynamics only; looking it up takes as long as computing with it."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics, self.large = dynamics, large(dynamics) is not None
        self.declared = tuple(name for name in DERIVATIVES if declared(dynamics.system, name) is not None)  #: derivatives
        self.compared = tuple(name for name in self.declared if name in EQUATIONS)  #: of them, those of the equations

    @cached_property
    def levels(self) -> ConstraintLevels:
        """Of the constraints, sparse for large systems."""
        return ConstraintLevels(self._dynamics)

    @cached_property
    def acceleration(self) -> AccelerationLevel:
        """Likewise."""
        return AccelerationLevel(self._dynamics)


_of_dynamics = Cache(64)


def of_dynamics(dynamics: Dynamics) -> OfDynamics:
    """Remembered of a dynamics that is remembered itself."""
    found: OfDynamics = _of_dynamics.find(by_id(dynamics), lambda: OfDynamics(dynamics))
    return found


def dynamics_for(system: System | NumpySystem, place: Place, without: tuple[str, ...] = ()) -> Dynamics:
    """Derived functions with a regular mass; declared derivatives that enter the equations are compared first.

    ``without``: names of ``REDUCTIONS`` that are not made.

    A wrong force Jacobian only slows Newton down; a wrong constraint Jacobian changes the motion, so it is
    replaced, with a warning.  What is called for this is no evaluation of the motion.

    Raises
    ------
    NonFiniteValue
        A constant mass holds NaN or infinity.
    """
    with uncounted():
        dynamics: Dynamics = derive(system, place.t, place.q, place.v, without=without)
        if infinite := infinite_entry(dynamics.constant_mass):
            raise NonFiniteValue("mass_matrix", *infinite, place.t)
        check_sparsity(dynamics, place.t, place.q, place.v)
        dynamics = _with_mass_by_entries(dynamics, place)
        if of_dynamics(dynamics).large:  # its Jacobians are never full: none that is declared is called
            return usable(dynamics, place)
        wrong = wrong_derivatives(dynamics, of_dynamics(dynamics).compared, place.t, place.q, place.v)
        if wrong:
            warnings.warn(
                f"the declared {', '.join(wrong)} disagrees with the derivative of what is declared and is not used; "
                "`hhtbench check` shows the entries.",
                UserWarning,
                stacklevel=2,
            )
            dynamics = derive(system, place.t, place.q, place.v, ignored=tuple(wrong), without=without)
        return usable(dynamics, place)


def usable(dynamics: Dynamics, place: Place) -> Dynamics:
    """``dynamics`` without dependent rows and with a regular mass."""
    with uncounted():
        dynamics = _independent(dynamics, place)
        if dynamics.structure.constrained and _singular(dynamics, place):
            dynamics = augment(dynamics, place.t, place.q)
        return dynamics


def _with_mass_by_entries(dynamics: Dynamics, place: Place) -> Dynamics:
    """``dynamics``, whose variable mass, if it is known by its entries, has an inverse by them; else by full matrices."""
    products = matrix_free(dynamics) if dynamics.structure.mass == "variable" else None
    if not isinstance(products, VariableMass) or products.mass_at(place.t, place.q).inverse() is not None:
        return dynamics
    return with_full_matrices(dynamics)


def _singular(dynamics: Dynamics, place: Place) -> bool:
    """Whether the mass is; one that is known by its entries has been looked at."""
    by_entries = dynamics.structure.mass == "variable" and isinstance(matrix_free(dynamics), VariableMass)
    return not by_entries and singular_at(dynamics, place.t, place.q)


def _independent(dynamics: Dynamics, place: Place) -> Dynamics:
    """``dynamics`` itself, or without the rows of its constraints that depend on others at ``place``, with a warning."""
    if not dynamics.structure.constrained:
        return dynamics
    known = of_dynamics(dynamics)
    if known.large and known.acceleration.solve(place.t, place.q, place.v).weakest > INDEPENDENT:
        return dynamics
    at = known.levels.at(place.t, place.q, place.v)
    if not at.ranked:
        return dynamics  # the start's own check says what is wrong
    rank = at.rank
    reduced = reduce_redundant(dynamics, rank.redundant) if rank.redundant else None
    if reduced is None:
        return dynamics
    warnings.warn(
        f"redundant constraints: {rank.text}. The solver works without those rows; multipliers are those of least norm.",
        UserWarning,
        stacklevel=2,
    )
    return reduced


def check_start(dynamics: Dynamics, levels: ConstraintLevels, place: Place, guesses: Guesses) -> Failure | None:
    """Why no motion begins at ``place``; None where one does.  ``levels`` and ``guesses`` are of all rows of [g; k].

    Raises
    ------
    NonFiniteValue
        A constraint or its Jacobian holds NaN or infinity.
    ProblemError
        A guess has not one entry per constraint.
    """
    s = levels.structure
    if s.constrained:
        failure = inconsistency(levels, place, reduced=unreduced(dynamics) is not dynamics)
        if failure is not None:
            return failure
    elif _singular(dynamics, place):
        message = "the mass matrix is singular at the start and no constraint determines the accelerations"
        return Failure(Status.singular_iteration_matrix, f"{message}; give every coordinate a mass")
    for name, guess, size in (("lam_guess", guesses[0], s.m), ("mu_guess", guesses[1], s.p)):
        if guess is not None and guess.shape != (size,):
            raise ProblemError(f"{name} must have shape ({size},), one entry per constraint; got {guess.shape}.")
    return None


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
        return Failure(Status.inconsistent_initial, f"the start violates {text}; {CORRECT}")
    if issparse(at.position_jacobian):  # dependent rows make the KKT matrix singular: they are looked for only there
        return None
    if at.rank.redundant and not reduced:
        return Failure(Status.redundant_constraints, f"the constraint Jacobian at the start has {at.rank.text}")
    return None


def violations(at: Levels, place: Place, bound: float) -> str:
    """Rows above ``bound`` in words, position level first; empty when there are none."""
    if at.hold(place.q, place.v, bound):
        return ""
    position, velocity = at.misfits(place.q, place.v)
    wrong = [row for row in position + velocity if not row.relative <= bound]
    return ", ".join(f"{row.name} = {row.value:.3g} ({row.relative:.1g} of its size)" for row in wrong)


def finite_levels(levels: ConstraintLevels, t: float, q: Vector, v: Vector) -> Levels:
    """The constraint levels at one point; raises :class:`NonFiniteValue` naming the function that is not finite."""
    at = levels.at(t, q, v)
    if at.finite:
        return at
    expect_finite("constraint", at.position, t)
    expect_finite("constraint_jacobian", at.position_jacobian, t)
    expect_finite("velocity_constraint", at.velocity, t)
    expect_finite("velocity_constraint_jacobian", at.velocity_jacobian, t)
    expect_finite("the velocity level of the constraints", at.velocity_drift, t)
    return at


def start_acceleration(run: Solving, place: Place, guesses: Guesses) -> Acceleration | Failure:
    """Accelerations and multipliers of the start, or why there are none; a linear reaction looks at no guess.

    Raises
    ------
    NonFiniteValue
        A function of the system is not finite at the start.
    """
    t, q, v = place.t, place.q, place.v
    found = run.acceleration.solve(t, q, v, *guesses)
    run.work.add("residual_evaluations", points_of(run.dynamics))
    if found.singular:
        at = of_dynamics(run.dynamics).levels.at(t, q, v)
        if issparse(at.position_jacobian) and at.ranked and at.rank.redundant:
            return Failure(Status.redundant_constraints, f"the constraint Jacobian at the start has {at.rank.text}")
        message = "the KKT matrix [[M, C^T], [C, 0]] is singular at the start: accelerations are not determined"
        nearly = constraint_rank(at.rows, NEARLY) if at.ranked else None
        if nearly and nearly.redundant:
            message += f", as rows nearly depend on others: up to {NEARLY:g} of their length {nearly.text}"
            message += "; take them out, or write them so that they differ by more"
        return Failure(Status.singular_iteration_matrix, message)
    if not all_finite(found.vdot):
        explain_nonfinite(run.dynamics, t, q, v)
    if not found.converged:
        message = "no multipliers satisfy the acceleration level at the start from lam_guess; give a better guess"
        return Failure(Status.newton_failed, message)
    return found


def points_of(dynamics: Dynamics) -> int:
    """Evaluations of F to count per call of a compiled function; 0 for a NumPy system, whose callbacks are counted."""
    return 0 if route_of(dynamics) == "numpy" else 1


def budget_failure(spent: BudgetSpent, t: float) -> Failure:
    """The status of a spent budget, with the time it has lasted for."""
    status = Status.deadline if spent.budget == "seconds" else Status.evaluation_budget
    return Failure(status, f"{spent} at t = {t:.17g}; {status.text}")
