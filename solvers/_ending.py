"""What one solve by a foreign library hands over: rows believed, with multipliers, or what is left when something raises."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhtbench.errors import BudgetSpent
from hhtbench.lowering import padded
from hhtbench.result import Solution, Status
from hhtbench.trust import unresolved
from solvers._rows import Rows, carried, doubt_about, own_multipliers, recover_multipliers
from solvers._start import Failure, all_multipliers, budget_failure, empty_solution

if TYPE_CHECKING:
    from solvers._run import Run


def assembled(run: Run, end: Failure) -> Solution:
    """The Solution: rows believed, multipliers from the acceleration level."""
    rows = run.rows()
    found_end = judged(run, rows, end)
    status, message = found_end.status, found_end.message
    with run.for_output():
        found = recover_multipliers(run.level, run.dynamics, run.work, run.form, run.first, rows)
        kept = len(found.lam)
        every = rows.t[:kept], rows.q[:kept], rows.v[:kept]
        lam, mu = all_multipliers(run.dynamics, run.work, *every, found.lam, found.mu)
    if found.instead is not None and status is Status.success:
        status = found.instead
    own = carried(run.form, rows, run.dynamics)
    return Solution(
        t=every[0],
        q=every[1],
        v=every[2],
        lam=lam,
        mu=mu,
        status=status,
        message=f"{message} {found.note}".strip(),
        counters=run.counters(),
        carried=None if own is None else {name: values[:kept] for name, values in own.items()},
    )


def judged(run: Run, rows: Rows, end: Failure) -> Failure:
    """How the run ended, after a look at what speaks against a success."""
    if end.status is not Status.success:
        return end
    if run.t != run.t1:
        doubt = f"It stopped at t = {run.now:.17g} and not at {run.time(run.t1):.17g}."
        return Failure(Status.unreliable, f"{Status.unreliable.text} {doubt}")
    try:
        doubt = doubt_about(rows, run.levels, run.problem.scales, run.work, run.request.t_eval)
    except BudgetSpent as spent:
        return budget_failure(spent, run.now)
    coarse = unresolved(run.problem.t_span, run.steps, run.rtol, run.t - run.t0)
    if doubt:
        return Failure(Status.unreliable, f"{Status.unreliable.text} {doubt}")
    return Failure(Status.time_resolution, coarse) if coarse else end


def left_over(run: Run, error: BaseException) -> Solution:
    """What was accepted before an exception; no function of the system is called for it."""
    status = Status.interrupted if isinstance(error, KeyboardInterrupt) else Status.user_exception
    message = f"{type(error).__name__}: {error}."
    if not hasattr(run, "start"):
        return empty_solution(run.problem.q0.size, status, message, run.counters())
    rows = run.rows()
    s = run.dynamics.structure
    none = np.full(s.m, np.nan), np.full(s.p, np.nan)
    own = [own_multipliers(run.form, y, none) for y in rows.y]
    reduced = (np.array([pair[i] for pair in own]).reshape(len(rows.t), none[i].size) for i in range(2))
    lam, mu = padded(run.dynamics, *reduced)
    return Solution(
        t=rows.t,
        q=rows.q,
        v=rows.v,
        lam=lam,
        mu=mu,
        status=status,
        message=f"{message} The multipliers are those of the form, NaN where it has none.",
        counters=run.counters(),
        carried=carried(run.form, rows, run.dynamics),
    )
