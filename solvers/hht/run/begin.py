"""From a system and a place to an engine with its first state, or to the reason why there is none."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hhtbench.arguments import real_number, real_vector
from hhtbench.counting import Work
from hhtbench.errors import BudgetSpent, NonFiniteValue, ProblemError
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
from solvers.hht.options import HHTOptions
from solvers.hht.run.engine import Engine
from solvers.hht.run.make_engine import make_engine
from solvers.hht.run.start import first_state, project
from solvers.hht.step.state import State


@dataclass(frozen=True)
class Started:
    """The engine with its first state, or why there is none."""

    engine: Engine | None
    state: State | None
    failure: Failure | None
    note: str = ""


def start_values(t0: Any, q0: Any, v0: Any, lam_guess: Any, mu_guess: Any) -> tuple[Place, Guesses]:
    """The caller's start as private arrays.

    Raises
    ------
    ProblemError, TypeError
        One is no finite number or vector, or their lengths differ.
    """
    t, q = real_number("t0", t0, unit=" [s]"), real_vector("q0", q0)
    if q.size == 0:
        raise ProblemError("q0 must hold at least one coordinate; got shape (0,).")
    v = real_vector("v0", v0, q.size)
    lam = None if lam_guess is None else real_vector("lam_guess", lam_guess)
    mu = None if mu_guess is None else real_vector("mu_guess", mu_guess)
    return Place(t, q, v), (lam, mu)


def begin(
    system: System | NumpySystem,
    options: HHTOptions,
    place: Place,
    guesses: Guesses,
    h: float,
    work: Work,
    *,
    controlled: bool = False,
) -> Started:
    """Derive, check and project the start, and make the first state; one value that is not finite is tried once more.

    ``h`` [s] is the first step, or the direction of time.
    """
    failure = None
    for _ in range(2):
        try:
            made = make_engine(system, options, place, work, controlled=controlled)
            return _begin(made, place, guesses, h, project_start=options.calc_initcond)
        except NonFiniteValue as error:
            work.add("nonfinite_evaluations")
            failure = Failure(Status.nonfinite_callback, f"{error}, at the start")
        except BudgetSpent as spent:
            return Started(None, None, budget_failure(spent, place.t))
    return Started(None, None, failure)


def _begin(made: Engine, place: Place, guesses: Guesses, h: float, *, project_start: bool) -> Started:
    dynamics, s = made.dynamics, made.structure
    note = "The mass matrix is singular at the start; M + rho C^T C is used (H19)." if hasattr(dynamics, "rho") else ""
    whole, failure = unreduced(dynamics), undetermined(dynamics, place)
    if s.constrained:
        levels = ConstraintLevels(dynamics)
        if project_start:
            projected = project(dynamics, levels, place, made.work)
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
