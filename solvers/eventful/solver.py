"""A solver with events: runs of the solver itself, ended where an event stops them or changes the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hhtbench.protocol.events import Event, make_events
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.solution.counting import timed
from hhtbench.solution.request import Request
from hhtbench.solution.result import Solution
from solvers.eventful.run import Run


@dataclass(frozen=True)
class WithEvents:
    """``solver`` with ``events``.

    The solver runs as without events, at its own tolerance.  A quintic between the ends of its steps shows where an event
    function changes its sign; the solver then goes from the start of that step to the event, so that its own error is in
    the event's time.  After a change of state it starts again; constant steps then count from there.
    """

    solver: Any
    events: tuple[Event, ...]

    @classmethod
    def of(cls, solver: Solver, events: Any) -> WithEvents:
        """The solver with events as the user gives them: one or a list, :class:`hhtbench.Event` or callables."""
        return cls(solver, make_events(events))

    @property
    def name(self) -> str:
        """Name of the solver."""
        return str(self.solver.name)

    @property
    def heeds_tolerances(self) -> bool:
        """True if the solver controls its error by the tolerances."""
        return bool(getattr(self.solver, "heeds_tolerances", False))

    def accepts(self, problem: Problem, request: Request) -> str | None:
        """Reason why the solver cannot take the problem or request, or None."""
        if lost := self._never_looked_for(problem):
            what = f"event {lost!r} is looked for during a system that is not in this motion"
            return f"{what}: during must be the problem's own system object, or one that another event begins by then"
        if problem.t_span[1] < problem.t_span[0] and any(event.restitution is not None for event in self.events):
            return "an event with a restitution has no motion backward in time; give its inverse as a change"
        if request.fixed and not isinstance(request.steps, int | None):
            return f"{self.name} takes these events with tolerances or constant steps: give rtol, step, or steps=N"
        reason: str | None = self.solver.accepts(problem, request)
        return reason

    def _never_looked_for(self, problem: Problem) -> str:
        """Name of an event whose ``during`` the motion never reaches, or ""."""
        systems = [problem.system]
        for system in systems:  # grows
            begun = [event.then for event in self.events if event.then is not None and event.happens_in(system)]
            systems += [one for one in begun if not any(one is known for known in systems)]
        return next((event.name for event in self.events if not any(map(event.happens_in, systems))), "")

    def solve(self, problem: Problem, request: Request) -> Solution:
        """Integrate ``problem``."""
        with timed(request.max_seconds) as clock:
            return Run(self.solver, self.events, problem, request, clock).solution()
