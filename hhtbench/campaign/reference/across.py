"""Solve piecewise between jumps of a prescribed velocity, with the impulse of the constraints at each jump."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from hhtbench.api import solve
from hhtbench.checks.jumps import Jumps
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution

SHORTEST_BUDGET = 1e-3  # s: of a piece that begins when the time is up, and ends with that status


def solve_across(
    problem: Problem, solver: str, jumps: Jumps, times: Vector, *, rtol: float, seconds: float | None
) -> Solution:
    """Integrate from jump to jump with output at ``times`` (k,), none of which is a jump's, within ``seconds`` [s].

    ``times`` run in the direction of the motion.  If a piece fails, its own solution is returned.
    """
    if not jumps.times.size:
        return solve(problem, solver, rtol=rtol, t_eval=times, max_seconds=seconds)
    began, rows, sign = time.perf_counter(), list[dict[str, Any]](), np.sign(problem.t_span[1] - problem.t_span[0])
    t, q, v = problem.t_span[0], problem.q0, problem.v0
    for i, inside in enumerate(np.split(times, np.searchsorted(sign * times, sign * jumps.times))):
        crossed = i < jumps.times.size
        end = float(jumps.before[i]) if crossed else problem.t_span[1]
        asked = np.append(inside, end) if crossed else inside
        if sign * (end - t) > 0.0 and asked.size:
            left = None if seconds is None else max(seconds - (time.perf_counter() - began), SHORTEST_BUDGET)
            found = solve(problem, solver, t_span=(t, end), q0=q, v0=v, rtol=rtol, t_eval=asked, max_seconds=left)
            if not found.success:
                return found
            rows.append({name: getattr(found, name)[: inside.size] for name in ("t", "q", "v", "lam", "mu")})
            q, v = found.q[-1], found.v[-1]
        if crossed:
            t, v = float(jumps.after[i]), jumps.velocities(i, q, v)[0]
    return found.but(**{name: np.concatenate([piece[name] for piece in rows]) for name in rows[0]})
