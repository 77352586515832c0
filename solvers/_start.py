"""The start of a run for every solver: initial point, derived dynamics, and their cached properties."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hhtbench.lowering import (
    ConstraintLevels,
    Dynamics,
    Levels,
    derive,
    reduce_redundant,
    route_of,
    singular_at,
)
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.routes import too_large
from hhtbench.lowering.dynamics.mass import infinite_entry, plain_mass
from hhtbench.lowering.dynamics.products import large, matrix_free
from hhtbench.lowering.dynamics.regular import with_full_matrices
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue, ProblemError
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import DERIVATIVES, NumpySystem, System, declared
from hhtbench.solution.counting import Work, uncounted
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers._finite import expect_finite

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.kkt import AccelerationLevel
    from hhtbench.lowering.dynamics.kkt_rows import Acceleration
    from solvers.kernel.level import CompiledLevel

EQUATIONS = tuple(name for name in DERIVATIVES if name != "force_jacobians")  # derivatives that enter the equations
CORRECT = "correct q0, v0 or pass calc_initcond=True to solve or init_step (hhtbench solve: --calc-initcond)"
INDEPENDENT = 1e-10  # relative pivots of a sparse KKT matrix above which its constraint rows are independent


@dataclass(frozen=True)
class Failure:
    """How a start, a step or a run ended, usually a failure: its status, and the cause as a sentence."""

    status: Status
    message: str


@dataclass(frozen=True)
class PhasePoint:
    """A point (t, q, v) of the motion: [s], (n,), (n,)."""

    t: float
    q: Vector
    v: Vector


class Solving(Protocol):
    """One solve in progress, by HHT or by a library."""

    dynamics: Dynamics

    @property
    def work(self) -> Work:
        """Counters of the work done."""


Guesses = tuple[Vector | None, Vector | None]  # starting values of lam (m,) and mu (p,)


def tried_twice(begin: Callable[[], Any], work: Work, t: float) -> Any:
    """Call ``begin`` for the start at ``t`` [s], once more after a value that is not finite; its result or a Failure."""
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


def typical_sizes(problem: Problem) -> Vector:
    """Typical sizes of q and v, (2n,): the problem's scales."""
    n, sizes = problem.q0.size, np.empty(2 * problem.q0.size)
    sizes[:n], sizes[n:] = problem.scales.q, problem.scales.v
    return sizes


def absolute_tolerances(problem: Problem, request: Request) -> Vector:
    """Absolute tolerances of q and v, (2n,): the request's, or ``rtol`` times the problem's scales without one."""
    n, atol = problem.q0.size, request.atol
    if atol is None:
        rtol = 0.0 if request.rtol is None else request.rtol
        return typical_sizes(problem) * (rtol if type(rtol) is float else np.resize(rtol, 2 * n))
    if np.shape(atol) not in ((), (n,), (2 * n,)):
        raise ProblemError(f"atol must be a number, ({n},) or ({2 * n},) for q and v; got shape {np.shape(atol)}.")
    return np.resize(np.asarray(atol, dtype=np.float64), 2 * n)


class OfDynamics:
    """Properties derived from one dynamics and cached, since deriving them takes long."""

    def __init__(self, dynamics: Dynamics) -> None:
        self._dynamics, self.large = dynamics, large(dynamics) is not None
        self.declared = tuple(name for name in DERIVATIVES if declared(dynamics.system, name) is not None)  #: derivatives
        self.compared = tuple(name for name in self.declared if name in EQUATIONS)  #: those that enter the equations

    @cached_property
    def levels(self) -> ConstraintLevels:
        """The constraint levels; sparse for large systems."""
        return ConstraintLevels(self._dynamics)

    @cached_property
    def acceleration(self) -> AccelerationLevel:
        """Solver of the acceleration level, (H16)."""
        from hhtbench.lowering.dynamics.kkt import AccelerationLevel  # small systems have machine code for it

        return AccelerationLevel(self._dynamics)

    @cached_property
    def compiled(self) -> CompiledLevel | None:
        """Machine code of the acceleration level; None for a large system or functions that are no machine code.

        Depends on the system only, so that results do not depend on what was solved before.
        """
        dynamics = self._dynamics
        if route_of(dynamics) == "numpy" or not dynamics.matrices or too_large(dynamics) is not None:
            return None
        from solvers.kernel.level import compiled_level  # plain callables do without the loops

        return compiled_level(dynamics)

    @cached_property
    def plain(self) -> bool:
        """True if a start can be checked by its point alone: plain mass, no declared derivatives or patterns to compare."""
        return plain_mass(self._dynamics) and not self.compared and not declared(self._dynamics.system, "sparsity")


_of_dynamics = Cache(64)


def of_dynamics(dynamics: Dynamics) -> OfDynamics:
    """The cached properties of a dynamics."""
    found: OfDynamics = _of_dynamics.find(by_id(dynamics), lambda: OfDynamics(dynamics))
    return found


class Begun(NamedTuple):
    """The start of a run."""

    dynamics: Dynamics
    place: PhasePoint
    found: Acceleration
    note: str  #: by how much ``calc_initcond`` moved the start, or ""


def plain_start(system: System | NumpySystem, place: PhasePoint, guesses: Guesses, work: Work) -> Begun | None:
    """The start at ``place`` by machine code; None if there is none or the start needs the full checks."""
    if not issubclass(type(system), System):
        return None
    with uncounted():
        dynamics: Dynamics = derive(system, place.t, place.q, place.v)
    known = of_dynamics(dynamics)
    found = known.compiled.at(place, guesses) if known.plain and known.compiled is not None else None
    if found is None:
        return None
    work.add("residual_evaluations")
    return Begun(dynamics, place, found, "")


def dynamics_for(system: System | NumpySystem, place: PhasePoint, without: tuple[str, ...] = ()) -> Dynamics:
    """Derived functions with a regular mass; declared derivatives that enter the equations are checked first.

    ``without``: names of ``REDUCTIONS`` to switch off.
    A wrong force Jacobian only slows Newton down; a wrong constraint Jacobian changes the motion, so it is
    replaced, with a warning.  Calls made here are not counted as evaluations.

    Raises
    ------
    NonFiniteValue
        A constant mass holds NaN or infinity.
    """
    with uncounted():
        dynamics: Dynamics = derive(system, place.t, place.q, place.v, without=without)
        if infinite := infinite_entry(dynamics.constant_mass):
            raise NonFiniteValue("mass_matrix", *infinite, place.t)
        if declared(system, "sparsity") is not None:
            from solvers._declared import check_sparsity  # most systems declare nothing to be compared

            check_sparsity(dynamics, place.t, place.q, place.v)
        dynamics = _with_mass_by_entries(dynamics, place)
        if of_dynamics(dynamics).large:  # its Jacobians are never full: none that is declared is called
            return usable(dynamics, place)
        wrong = _wrong_derivatives(dynamics, place)
        if wrong:
            warnings.warn(
                f"the declared {', '.join(wrong)} disagrees with the derivative of what is declared and is not used; "
                "`hhtbench check` shows the entries.",
                UserWarning,
                stacklevel=2,
            )
            dynamics = derive(system, place.t, place.q, place.v, ignored=tuple(wrong), without=without)
        return usable(dynamics, place)


def _wrong_derivatives(dynamics: Dynamics, place: PhasePoint) -> list[str]:
    compared = of_dynamics(dynamics).compared
    if not compared:
        return []
    from solvers._declared import wrong_derivatives  # likewise

    return wrong_derivatives(dynamics, compared, place.t, place.q, place.v)


def usable(dynamics: Dynamics, place: PhasePoint) -> Dynamics:
    """``dynamics`` without dependent constraint rows and with a regular mass."""
    with uncounted():
        dynamics = _independent(dynamics, place)
        if dynamics.structure.constrained and singular_mass(dynamics, place):
            from hhtbench.lowering.dynamics.augmented import augment  # few masses are singular

            dynamics = augment(dynamics, place.t, place.q)
        return dynamics


def _with_mass_by_entries(dynamics: Dynamics, place: PhasePoint) -> Dynamics:
    """``dynamics`` if its variable mass can be inverted by its entries, else with full matrices."""
    products = matrix_free(dynamics) if dynamics.structure.mass == "variable" else None
    if products is None or products.entries is None or products.mass_at(place.t, place.q).inverse() is not None:
        return dynamics
    return with_full_matrices(dynamics)


def singular_mass(dynamics: Dynamics, place: PhasePoint) -> bool:
    """True if the mass is singular; one known by its entries has been checked before."""
    products = matrix_free(dynamics) if dynamics.structure.mass == "variable" else None
    return (products is None or products.entries is None) and singular_at(dynamics, place.t, place.q)


def _independent(dynamics: Dynamics, place: PhasePoint) -> Dynamics:
    """``dynamics``, without constraint rows that depend on others at ``place``, of which it warns."""
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


def violations(at: Levels, place: PhasePoint, bound: float) -> str:
    """Text naming the constraint rows violated by more than ``bound``, position level first; empty if there are none."""
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


def points_of(dynamics: Dynamics) -> int:
    """Evaluations of F to count per call of a compiled function; 0 for a NumPy system, whose callbacks are counted."""
    return 0 if route_of(dynamics) == "numpy" else 1


def budget_failure(spent: BudgetSpent, t: float) -> Failure:
    """Failure for a spent budget, naming the time ``t`` [s] reached."""
    status = Status.deadline if spent.budget == "seconds" else Status.evaluation_budget
    return Failure(status, f"{spent} at t = {exact(t)}; {status.text}")
