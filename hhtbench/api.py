"""The function ``solve``: integrate a problem with a solver and check the result."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

import numpy as np

from hhtbench.catalogue.registry import load_problem, load_solver, with_events
from hhtbench.checks.result.success import check_success
from hhtbench.protocol.errors import BudgetSpent
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.protocol.system import declared
from hhtbench.solution.counting import Clock, handed_over
from hhtbench.solution.request import Request, check_output_times, make_request, with_tolerance
from hhtbench.solution.result import Counters, Solution, Status


def solve(
    problem: Problem | str,
    solver: Solver | str = "hht",
    *,
    accuracy: float | None = None,
    events: Any = None,
    t_span: tuple[float, float] | None = None,
    q0: Any = None,
    v0: Any = None,
    **request: Any,
) -> Solution:
    """Integrate ``problem`` with ``solver`` and check the result.

    Every success is checked, whoever wrote the solver: shapes, times, counters, constraints.  ``solution.verify()`` checks
    also that the equations of motion hold between the rows, as campaigns do.

    Parameters
    ----------
    problem
        A Problem or a spec such as ``planar_chain(n_links=100)``.
    solver
        A solver or a spec such as ``hht(alpha=-0.1)``.
    accuracy
        Largest error of q and v, scaled by the problem's scales, at the output times: the solver is repeated with finer
        settings until they show that it is met (:func:`hhtbench.checks.accuracy.solve_to`).  None: one run with the
        requested tolerances or steps.
    events
        :class:`hhtbench.Event` or callables ``(t, q, v)``, one or a list; None: those of the problem.  HHT and the solvers
        that share its loop have their own; for others they are found between the ends of their steps.
    t_span, q0, v0
        Replace the problem's interval or start; its reference and closed solution are then not used.
    request
        Fields of :class:`~hhtbench.Request`: ``rtol, atol, step, steps, t_eval, max_seconds, ...``; with neither
        tolerances nor steps ``rtol = 1e-4``, which the message says.  ``steps=solution`` takes the steps of an earlier
        solution again: then the result is smooth in the parameters, as fits need it.

    Returns
    -------
    Solution
        Numerical failures end in its ``status``.  A solver that cannot take the problem or request gives
        ``Status.declined``, no rows, and the reason as ``message``.

    Raises
    ------
    ProblemError, TypeError
        Wrong use, before any function of the system is called.
    """
    began = time.perf_counter()
    asked, note = make_request(("accuracy", "events", "t_span", "q0", "v0"), **request), ""
    if accuracy is None:
        asked, note = with_tolerance(asked)
    clock = Clock(asked.max_seconds, began)  # imports count too: nothing interrupts them
    loaded, chosen = load_problem(problem).starting(t_span, q0, v0), load_solver(solver)
    clock.note_preparation("importing problem and solver", time.perf_counter() - began)
    if asked.t_eval is not None:
        check_output_times(asked.t_eval, *loaded.t_span)
    chosen = with_events(chosen, loaded, events)
    with handed_over(clock):
        try:
            if accuracy is not None:
                from hhtbench.checks.accuracy import solve_to  # few solves need it: its checks are another thousand lines

                found = solve_to(loaded, chosen, accuracy, asked, partial(_once, loaded, chosen, clock=clock))
            else:
                found = _once(loaded, chosen, asked, clock)
        except BudgetSpent as spent:
            return _nothing(loaded, Status.deadline, f"{spent} before the first step; {Status.deadline.text}")
    if not note or found.status is Status.declined:
        return found
    said = str(found.message or "").rstrip(".")  # a plugin's may be None
    return found.but(message=f"{said}. {note}" if said else note)


def _once(problem: Problem, solver: Solver, request: Request, clock: Clock) -> Solution:
    """Run the solver once: declined, or checked and set to ``unreliable`` if the reported success fails the check."""
    reason = solver.accepts(problem, request)
    if reason is not None:
        return _nothing(problem, Status.declined, reason)
    try:
        found = solver.solve(problem, request)
    except (TypeError, ValueError) as error:
        from hhtbench.protocol.wrong_use import raise_wrong_use

        raise_wrong_use(problem, error)
        raise
    try:
        doubt = check_success(problem, request, found, clock)
    except BaseException as error:
        BaseException.__setattr__(error, "partial_solution", found)  # also where the class is frozen
        raise
    if not isinstance(found, Solution):
        return _nothing(problem, Status.unreliable, doubt)
    tools = {"judge_of": partial(_judged, problem, request), "drift_of": partial(_drifted, problem)}
    tools["layout"] = declared(problem.system, "layout")
    return found.but(status=Status.unreliable, message=doubt, **tools) if doubt else found.but(**tools)


def _judged(problem: Problem, request: Request, solution: Solution, **options: Any) -> Any:
    """Check ``solution``; called by ``solution.verify()`` and imported only then."""
    from hhtbench.checks.result.judge import judge

    return judge(problem, request, solution, **options)


def _drifted(problem: Problem, solution: Solution) -> Any:
    """Measure the drift of ``solution``; called by ``solution.drift()`` and imported only then."""
    from hhtbench.checks.drift import measure_drift

    return measure_drift(problem, solution)


def _nothing(problem: Problem, status: Status, message: str) -> Solution:
    """Return a Solution without rows, with ``status`` and ``message``; calls no function of the system."""
    n = problem.q0.size
    m, p = (np.size(guess) if guess is not None else 0 for guess in (problem.lam_guess, problem.mu_guess))
    q, v, lam, mu = (np.empty((0, width)) for width in (n, n, m, p))
    none = np.empty(0)
    return Solution(t=none, q=q, v=v, lam=lam, mu=mu, status=status, message=message, counters=Counters())
