"""Base class of the adapters of foreign libraries: options, requests they accept, and one solve.

A library is driven one accepted step at a time.  :class:`~solvers._run.Run` hands it the equations of a form as callbacks,
each counted and guarded, and takes the steps; the subclass of :class:`Adapter` holds what differs between libraries.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from difflib import get_close_matches
from typing import Any, ClassVar

import numpy as np

from hhtbench.lowering import Structure, derive
from hhtbench.protocol.errors import ProblemError, did_you_mean
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import PHYSICS, System, declared, reaction_takes_velocity
from hhtbench.solution.counting import timed
from hhtbench.solution.request import Request
from hhtbench.solution.result import Counters, Solution, Status
from solvers import forms
from solvers._ending import empty_solution, solved
from solvers._run import Run
from solvers._start import Failure


def choose(solver: str, options: Mapping[str, Any], known: Mapping[str, tuple[str, ...]]) -> dict[str, str]:
    """Values of all ``known`` options; the first possible value of each is its default.

    Raises
    ------
    TypeError
        An option is unknown.
    ProblemError
        A value is unknown; the message names the closest.
    """
    unknown = sorted(set(options) - set(known))
    if unknown:
        hint = did_you_mean(unknown[0], known)
        raise TypeError(f"{solver} does not know {', '.join(unknown)}; known: {', '.join(known)}.{hint}")
    for name, value in options.items():
        if value not in known[name]:
            by_letters = {x.lower(): x for x in known[name]}
            close = get_close_matches(str(value).lower(), by_letters, n=1)
            hint = f" Did you mean {by_letters[close[0]]}?" if close else ""
            raise ProblemError(f"{solver} has no {name} {value!r}.{hint} Known: {', '.join(known[name])}.")
    return {name: options.get(name, values[0]) for name, values in known.items()}


@dataclass(frozen=True)
class Adapter:
    """One library with one form and method, as a solver of the bench.

    Relative tolerances are the request's; absolute ones too, or ``rtol`` times the problem's scales of q and v where the
    request gives none.  Multipliers are not in the error test.  Output at ``t_eval`` leaves the steps unchanged and is as
    accurate: interpolated by multistep methods, by a shorter step from the same start for one-step methods.  With
    ``dense_output=True`` the library's own interpolant is kept, which costs work at every step.  Rows and dense output
    are not projected onto the constraints: their drift is what the bench measures.
    """

    name: str
    form: str
    method: str
    library: ClassVar[str]
    installed: ClassVar[bool] = True
    interpolates: ClassVar[bool] = True  #: True if it has dense output
    heeds_tolerances: ClassVar[bool] = True  #: True if different tolerances give different steps

    def accepts(self, problem: Problem, request: Request) -> str | None:
        """Reason why this solver cannot take the problem or request, or None; evaluates no function of a system."""
        if not self.installed:
            return f"skipped, {self.library} is not installed"
        if request.options:
            return f"unknown option {', '.join(sorted(request.options))}; {self.name} takes its options where it is named"
        if request.fixed:
            return f"{self.name} chooses its own steps: give rtol (and atol), not step or steps"
        if request.rtol is None:
            return f"{self.name} controls its error: give rtol (and atol)"
        if np.ndim(request.rtol) > 0:
            return f"{self.name} takes one relative tolerance for all components; give a number"
        if request.rtol == 0 and request.atol is None:
            return "rtol = 0 leaves no tolerance; give atol too"
        if request.dense_output and not self.interpolates:
            return f"{self.name} has no dense output: its interpolant ignores the projection of steps; give t_eval"
        structure = _structure(problem)
        return None if structure is None else forms.refusal(self.form, structure)

    def solve(self, problem: Problem, request: Request) -> Solution:
        """Integrate ``problem``; an exception of its functions is raised again, with ``.partial_solution``."""
        with timed(request.max_seconds) as clock:
            reason = self.accepts(problem, request)
            if reason is not None:
                declined = Failure(Status.declined, reason)
                return empty_solution(problem.q0.size, declined, Counters(provenance="nothing was called"))
            run = Run(self.name, problem, request, self.form, clock)
            return solved(lambda: run.solution(self.drive), run.left_over)

    def warm_up(self, problem: Problem, request: Request) -> None:
        """Compile what :meth:`solve` will use, by one step without budgets; nothing is counted."""
        self.solve(problem, replace(request, max_num_steps=1, max_evaluations=None, max_seconds=None))

    def evaluates(self, problem: Problem) -> tuple[str, Problem]:
        """Kind of one residual evaluation ("acceleration" for form ode, else "residual"), and the problem it is of."""
        return "acceleration" if self.form == "ode" else "residual", problem

    def drive(self, run: Run) -> None:
        """Step the library from ``run.t`` to ``run.t1``, passing every step to ``run.accept``."""
        raise NotImplementedError


def _structure(problem: Problem) -> Structure | None:
    """The structure as far as known without evaluating anything; None if a declaration is faulty."""
    system = problem.system
    if issubclass(type(system), System):  # isinstance is slow: it asks equinox
        try:
            return derive(system, problem.t_span[0], problem.q0, problem.v0).structure
        except Exception:  # noqa: BLE001 - whatever tracing raises, solve raises again where it belongs
            return None
    there = {name: declared(system, name) is not None for name in PHYSICS}
    linear = not there["reaction"] and not there["velocity_reaction"]
    m, p = int(there["constraint"]), int(there["velocity_constraint"])  # how many, only the functions know
    uses_v = reaction_takes_velocity(system)
    return Structure(n=problem.q0.size, m=m, p=p, mass="variable", linear_reaction=linear, reaction_uses_v=uses_v)
