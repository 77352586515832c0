"""What a counted call of a solver costs, in evaluations of the problem's own residual: both timed in turn, alone.

A count says nothing of what is counted: a residual of IDA's is less work than an acceleration of the underlying ODE, which
solves for the multipliers.  Machine code is called in a row without Python between; functions in Python are called as they
are.  Linear algebra outside of the functions, a factorisation of IDA's for instance, is in no count and so in no cost.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection
from typing import Any

import numpy as np

from hhtbench.campaign.run import of_plugins
from hhtbench.counting import Work, timed
from hhtbench.lowering import Dynamics, compile_function, derive, repeated
from hhtbench.lowering.dynamics.jax_dynamics import matrix_free
from hhtbench.protocol import Problem, Solver
from hhtbench.request import Request

RESIDUAL = "residual_evaluations"
COUNTERS = (RESIDUAL, "jacobian_evaluations")  #: what is weighed
LEAST = 1e-3  # s of calls in a reading
READINGS = 5  # in turn over all functions, of which the least counts

Call = Callable[[int], object]  #: does something so often in a row


def call_costs(problem: Problem, solver: Solver, request: Request, counters: Collection[str]) -> dict[str, float]:
    """Counter -> its cost in evaluations of :func:`equations`; empty where the solver does not tell what it evaluates.

    Of a system of plain callables every call of the force is a residual evaluation: what a Jacobian calls counts as those.
    """
    evaluates = getattr(solver, "evaluates", None)
    if not callable(evaluates):
        return {}
    wanted = [name for name in COUNTERS if name == RESIDUAL or name in counters]
    try:
        calls = {name: evaluates(problem, request, name) for name in wanted}
        if None in calls.values():
            return {}
        own, *seconds = taken([own_residual(problem), *calls.values()])
        inside = {name: residuals_in(call) for name, call in calls.items()}
    except of_plugins():  # a plugin's or a user's: the counts stay what they are
        return {}
    spent = dict(zip(calls, seconds, strict=True))
    each = spent[RESIDUAL] / max(inside[RESIDUAL], 1)
    others = {name: max(spent[name] - inside[name] * each, 0.0) / own for name in wanted if name != RESIDUAL}
    return {RESIDUAL: each / own, **others}


def own_residual(problem: Problem) -> Call:
    """:func:`equations` at the start."""
    (t, _), q, v = problem.t_span, problem.q0, problem.v0
    dynamics = derive(problem.system, t, q, v)
    s = dynamics.structure
    function = compile_function(equations, matrix_free(dynamics) or dynamics)
    return repeated(function, float(t), np.array(q, float), np.array(v, float), *map(np.ones, (s.n, s.m, s.p)))


def equations(dynamics: Dynamics, t: Any, q: Any, v: Any, vdot: Any, lam: Any, mu: Any) -> Any:
    """What the problem declares, (n + m + p,): M vdot - F less the reactions, g(t, q) and k(t, q, v)."""
    rows = [dynamics.residual(t, q, v, dynamics.mass_product(t, q, vdot), lam, mu)]
    rows += [dynamics.constraint(t, q)] if dynamics.structure.m else []
    rows += [dynamics.velocity_constraint(t, q, v)] if dynamics.structure.p else []
    return dynamics.xp.concatenate(rows)


def taken(calls: Collection[Call]) -> list[float]:
    """Seconds of one of each call, the least of ``READINGS`` in turn."""
    times = [often_enough(call) for call in calls]
    readings = [[clocked(call, count) for call, count in zip(calls, times, strict=True)] for _ in range(READINGS)]
    return [min(own) for own in zip(*readings, strict=True)]


def often_enough(call: Call) -> int:
    """How many in a row take ``LEAST``."""
    call(1)  # what is compiled or fetched once belongs to none
    count = 1
    while count * clocked(call, count) < LEAST:
        count *= 2
    return count


def clocked(call: Call, count: int) -> float:
    """Seconds of one of ``count`` in a row."""
    begun = time.process_time_ns()
    call(count)
    return (time.process_time_ns() - begun) * 1e-9 / count


def residuals_in(call: Call) -> int:
    """Evaluations of the force that one call counts by itself."""
    with timed(None) as clock:
        clock.work = work = Work(clock=clock)
        call(1)
    return work.tally[RESIDUAL]
