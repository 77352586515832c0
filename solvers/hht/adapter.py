"""Adapter of :class:`~solvers.hht.solver.HHT` for the bench."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, ClassVar

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.solution.request import Request, has_zero, plan_steps
from hhtbench.solution.result import Solution, Status
from solvers._start import PhasePoint, absolute_tolerances
from solvers.hht.options import make_options
from solvers.hht.run.engine import NotTaken
from solvers.hht.solver import HHT

NO_OPTIONS: Mapping[str, Any] = MappingProxyType({})  #: options of a request whose integrator has them already


@dataclass(frozen=True, eq=False)
class HHTSolver:
    """The extended HHT-alpha method as a solver of the bench: ``load_solver("hht(alpha=-0.1, b=0)")``.

    Takes prescribed steps, or tolerances; absolute ones are ``rtol`` times the problem's scales where a request gives none.
    """

    name: str
    options: Mapping[str, Any]
    integrator: type[HHT] = HHT
    events: Any = None
    smooth_error: ClassVar[bool] = True  #: True if the error is smooth in the tolerance: two runs can be extrapolated
    heeds_tolerances: ClassVar[bool] = True  #: True if different tolerances give different steps

    def __eq__(self, other: object) -> bool:
        """True if both solve alike: an option given with its default value makes no difference."""
        if not isinstance(other, HHTSolver) or self.integrator is not other.integrator or self.events is not other.events:
            return False
        ours, theirs = (make_options(x.integrator.kind, x.integrator.name, **x.options) for x in (self, other))
        return bool(ours == theirs)

    __hash__ = None  # type: ignore[assignment]

    def accepts(self, problem: Problem, request: Request) -> str | None:
        """Reason why a request is declined (unknown options, neither steps nor tolerances, ...), or None."""
        if request.options:
            known = tuple(f.name for f in fields(self.integrator.kind))
            if unknown := sorted(set(request.options) - set(known)):
                return f"unknown option {', '.join(unknown)}; known: {', '.join(known)}"
        if declined := self.integrator.declined(problem, request, {**self.options, **request.options}):
            return declined
        return self._lacks_accuracy(request)

    def _lacks_accuracy(self, request: Request) -> str | None:
        """Message if ``request`` gives neither steps nor usable tolerances, else None."""
        if not request.fixed and request.rtol is None and request.atol is None:
            return "hht takes prescribed steps or tolerances: give step, steps, or rtol (and atol)"
        if request.atol is None and request.rtol is not None and has_zero(request.rtol):
            return "rtol = 0 leaves no tolerance; give atol too"
        return None

    def solve(self, problem: Problem, request: Request) -> Solution:
        """Integrate ``problem`` over its interval."""
        if lacking := self._lacks_accuracy(request):
            raise ProblemError(f"{lacking}.")
        atol = request.atol if request.rtol is None or request.atol is not None else absolute_tolerances(problem, request)
        integrator = self.integrator(problem.system, events=self.events, **{**self.options, **request.options})
        t0, t1 = problem.t_span
        place, guesses = PhasePoint(t0, problem.q0, problem.v0), (problem.lam_guess, problem.mu_guess)
        try:
            return integrator.solve_from(place, t1, guesses, request.but(atol=atol, options=NO_OPTIONS))
        except NotTaken as reason:
            left: Solution = reason.partial_solution  # type: ignore[attr-defined]
            return left.but(status=Status.declined, message=str(reason))

    def with_events(self, events: Any) -> HHTSolver:
        """Copy of this solver with ``events``, as :class:`~solvers.hht.solver.HHT` takes them."""
        return replace(self, events=events)

    def stepper(self, problem: Problem, request: Request) -> HHT:
        """The integrator at the start of ``problem``, to be stepped by hand, saved and resumed."""
        made = self.integrator(problem.system, events=self.events, **{**self.options, **request.options})
        t0, t1 = problem.t_span
        step = plan_steps(request, t0, t1).length(0) if request.fixed else None
        atol = absolute_tolerances(problem, request) if request.atol is None and request.rtol is not None else request.atol
        more: dict[str, Any] = {
            "lam_guess": problem.lam_guess,
            "mu_guess": problem.mu_guess,
            "calc_initcond": request.calc_initcond,
        }
        made.init_step(t0, problem.q0, problem.v0, step=step, rtol=request.rtol, atol=atol, **more)
        return made

    def warm_up(self, problem: Problem, request: Request) -> None:
        """Compile what :meth:`solve` will use, by one step without budgets; nothing is counted."""
        self.solve(problem, replace(request, max_num_steps=1, max_evaluations=None, max_seconds=None))

    def evaluates(self, problem: Problem) -> tuple[str, Problem]:
        """Kind of one residual evaluation, and the problem it is of."""
        return "residual", problem


def solver(**options: Any) -> HHTSolver:
    """The extended HHT-alpha method; options as in :class:`~solvers.hht.options.HHTOptions`."""
    make_options(**options)
    return HHTSolver("hht", dict(options))
