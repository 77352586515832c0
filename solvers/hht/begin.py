"""From a system and a place to an engine with its first state, or to the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import ConstraintLevels, derive, unreduced
from hhtbench.protocol import DERIVATIVES, NumpySystem, System, declared
from hhtbench.result import Status
from solvers._start import (
    Failure,
    Guesses,
    Place,
    budget_failure,
    check_guesses,
    counted_dynamics,
    dynamics_for,
    inconsistency,
    independent,
    regular,
    undetermined,
)
from solvers.hht.coefficients import Method
from solvers.hht.engine import HostEngine
from solvers.hht.start import first_state, project
from solvers.hht.state import State


@dataclass(frozen=True)
class Started:
    """The engine with its first state, or why there is none."""

    engine: HostEngine | None
    state: State | None
    failure: Failure | None
    note: str = ""


def begin(
    system: System | NumpySystem,
    method: Method,
    place: Place,
    guesses: Guesses,
    h: float,
    work: Work,
    *,
    calc_initcond: bool,
    linsolver: str = "auto",
) -> Started:
    """Derive, check and project the start, and make the first state; a stray NaN is tried once more."""
    failure = None
    for _ in range(2):
        try:
            return _begin(system, method, place, guesses, h, work, calc_initcond=calc_initcond, linsolver=linsolver)
        except NonFiniteValue as error:
            work.add("nonfinite_evaluations")
            failure = Failure(Status.nonfinite_callback, f"{error}, at the start")
        except BudgetSpent as spent:
            return Started(None, None, budget_failure(spent, place.t))
    return Started(None, None, failure)


def make_engine(
    system: System | NumpySystem, method: Method, place: Place, work: Work, linsolver: str = "auto"
) -> HostEngine:
    """The engine for runs that begin at ``place``, without a look at the start."""
    dynamics = counted_dynamics(dynamics_for(system, place), work)
    return HostEngine(dynamics, method, work, _fallback(system, place, work), linsolver=linsolver)


def _begin(
    system: System | NumpySystem,
    method: Method,
    place: Place,
    guesses: Guesses,
    h: float,
    work: Work,
    *,
    calc_initcond: bool,
    linsolver: str = "auto",
) -> Started:
    engine = make_engine(system, method, place, work, linsolver)
    dynamics, s = engine.dynamics, engine.structure
    note = "The mass matrix is singular at the start; M + rho C^T C is used (H19)." if hasattr(dynamics, "rho") else ""
    whole, failure = unreduced(dynamics), undetermined(dynamics, place)
    if s.constrained:
        levels = ConstraintLevels(dynamics)
        if calc_initcond:
            projected = project(dynamics, levels, place, work)
            if isinstance(projected, Failure):
                return Started(None, None, projected)
            place, moved = projected
            note = f"{note} {moved}.".strip()
        failure = inconsistency(ConstraintLevels(whole), place, reduced=whole is not dynamics)
    if failure:
        return Started(None, None, failure)
    check_guesses(whole.structure, guesses)
    guesses = guesses if whole is dynamics else (None, None)  # its reaction is linear: no guess picks a root
    state = first_state(engine, place, *guesses, h)
    if isinstance(state, Failure):
        return Started(None, None, state)
    return Started(engine, state, None, note)


def _fallback(system: System | NumpySystem, place: Place, work: Work) -> Any:
    names = tuple(name for name in DERIVATIVES if name != "sparsity" and declared(system, name) is not None)
    if not names:
        return None
    return lambda: counted_dynamics(
        regular(independent(derive(system, place.t, place.q, place.v, ignored=names), place), place), work
    )
