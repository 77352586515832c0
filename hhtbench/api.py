"""One call from a problem and a request to a solution."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.counting import Clock, handed_over
from hhtbench.errors import BudgetSpent
from hhtbench.protocol import Problem, Solver
from hhtbench.registry import load_problem, load_solver
from hhtbench.request import check_output_times, make_request
from hhtbench.result import Solution, Status

RTOL = 1e-4  #: where a request has neither tolerances nor steps: plain engineering accuracy


def solve(problem: Problem | str, solver: Solver | str = "hht", **request: Any) -> Solution:
    """Integrate ``problem`` with ``solver``.

    Parameters
    ----------
    problem
        A Problem or a spec such as ``planar_chain(n_links=100)``.
    solver
        A solver or a spec such as ``hht(alpha=-0.1)``.
    request
        Fields of :class:`~hhtbench.request.Request`: ``rtol, atol, step, steps, t_eval, max_seconds, ...``; with neither
        tolerances nor steps ``rtol = 1e-4``, which the message says.

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
    asked, note = make_request(**request), ""
    if not asked.fixed and asked.rtol is None and asked.atol is None:
        asked, note = replace(asked, rtol=RTOL), f"No tolerance was given: rtol = {RTOL:g} was taken."
    clock = Clock(asked.max_seconds, began)  # it runs while problem and solver are imported, which nothing else can end
    loaded, chosen = load_problem(problem), load_solver(solver)
    clock.note_preparation("importing problem and solver", time.perf_counter() - began)
    if asked.t_eval is not None:
        check_output_times(asked.t_eval, *loaded.t_span)
    with handed_over(clock):
        try:
            reason = chosen.accepts(loaded, asked)
            found = chosen.solve(loaded, asked) if reason is None else _nothing(loaded, Status.declined, reason)
        except BudgetSpent as spent:
            return _nothing(loaded, Status.deadline, f"{spent} before the first step; {Status.deadline.text}")
    return replace(found, message=f"{found.message} {note}") if note and found.status is not Status.declined else found


def _nothing(problem: Problem, status: Status, message: str) -> Solution:
    """A solution without rows; no function of the system is called for it."""
    n = problem.q0.size
    m, p = (np.size(guess) if guess is not None else 0 for guess in (problem.lam_guess, problem.mu_guess))
    q, v, lam, mu = (np.empty((0, width)) for width in (n, n, m, p))
    return Solution(t=np.empty(0), q=q, v=v, lam=lam, mu=mu, status=status, message=message)
