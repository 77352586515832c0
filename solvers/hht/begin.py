"""From a system and a place to an engine with its first state, or to the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass

from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import ConstraintLevels, unreduced
from hhtbench.protocol import NumpySystem, System
from hhtbench.result import Status
from solvers._start import (
    Failure,
    Guesses,
    Place,
    budget_failure,
    check_guesses,
    inconsistency,
    undetermined,
)
from solvers.hht.coefficients import Method
from solvers.hht.engine import HostEngine
from solvers.hht.engines import make_engine
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
    engine: str = "auto",
) -> Started:
    """Derive, check and project the start, and make the first state; a stray NaN is tried once more."""
    failure = None
    for _ in range(2):
        try:
            return _begin(
                system, method, place, guesses, h, work, calc_initcond=calc_initcond, linsolver=linsolver, engine=engine
            )
        except NonFiniteValue as error:
            work.add("nonfinite_evaluations")
            failure = Failure(Status.nonfinite_callback, f"{error}, at the start")
        except BudgetSpent as spent:
            return Started(None, None, budget_failure(spent, place.t))
    return Started(None, None, failure)


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
    engine: str = "auto",
) -> Started:
    made = make_engine(system, method, place, work, linsolver=linsolver, engine=engine)
    dynamics, s = made.dynamics, made.structure
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
    state = first_state(made, place, *guesses, h)
    if isinstance(state, Failure):
        return Started(None, None, state)
    return Started(made, state, None, note)
