"""Split a motion with several systems into its phases."""

from __future__ import annotations

from typing import Any

from hhtbench.lowering import derive
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution


def phases_of(problem: Problem, solution: Solution) -> list[tuple[Problem, Solution]]:
    """Return the problem and the rows of each phase that has rows; the problem and the solution itself if it has no phases.

    The solution of a phase is a success where the whole is one, ends at its last row, and has no steps of its own.
    """
    if not solution.phases:
        return [(problem, solution)]
    if solution.phases[0].system is None:
        raise ValueError("this solution came without the systems of its phases, as from a file or a pickle; solve it again.")
    found = []
    ends = [*(phase.t for phase in solution.phases[1:]), problem.t_span[1]]
    for phase, end in zip(solution.phases, ends, strict=True):
        t = solution.t[phase.rows]
        if not t.size or phase.t == end:
            continue
        one = problem.with_system(phase.system).starting((phase.t, end), phase.q, phase.v)
        parts: dict[str, Any] = {name: getattr(solution, name)[phase.rows] for name in ("t", "q", "v", "lam", "mu")}
        structure = derive(one.system, phase.t, phase.q, phase.v).structure
        parts |= {"lam": parts["lam"][:, : structure.m], "mu": parts["mu"][:, : structure.p]}
        found.append((one, solution.but(**parts, phases=(), ends=None, carried=None, interpolant=None)))
    return found
