"""One solution as text and as a file: end state, error at the end where it is known, arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
from tabulate import tabulate

from hhtbench.arguments import Vector
from hhtbench.protocol import Problem
from hhtbench.result import Solution

COMPONENTS = ("q", "v", "lam", "mu")
MOST_SHOWN = 12  # entries of a vector on the terminal; the file holds all


def end_state(solution: Solution) -> str:
    """The last row, or "" where there is none."""
    if not np.size(solution.t):
        return ""
    rows = [(name, _shown(getattr(solution, name)[-1])) for name in COMPONENTS if getattr(solution, name).shape[1]]
    return f"at t = {solution.t[-1]:.17g} s\n" + tabulate(rows, tablefmt="plain", disable_numparse=True)


def errors_at_end(problem: Problem, solution: Solution) -> str:
    """Largest error at the end against the closed solution or the reference; "" where neither reaches it."""
    if not solution.success or not np.size(solution.t) or solution.t[-1] != problem.t_span[1]:
        return ""
    source, known = _known_end(problem)
    rows = []
    for name, value in known.items():
        got = getattr(solution, name)[-1]
        want = np.asarray(value, dtype=np.float64)
        if got.size and want.shape == got.shape:
            error = np.abs(got - want)
            scaled = error / np.asarray(getattr(problem.scales, name))
            rows.append((name, f"{error.max():.3e}", f"{scaled.max():.3e}"))
    if not rows:
        return ""
    headers = ["", "largest error", "by scale"]
    return f"against the {source}\n" + tabulate(rows, headers=headers, tablefmt="plain", disable_numparse=True)


def as_dict(solution: Solution) -> dict[str, Any]:
    """Status, message, counters and rows as plain Python values but for the arrays."""
    arrays = {name: getattr(solution, name) for name in ("t", *COMPONENTS)}
    return {"status": solution.status.label, "message": solution.message, "counters": vars(solution.counters), **arrays}


def _known_end(problem: Problem) -> tuple[str, dict[str, Any]]:
    """Name and values of what is known at the end of the interval."""
    end = problem.t_span[1]
    if problem.exact is not None:
        return "exact solution", problem.exact(end)._asdict()
    if problem.reference is not None:
        rows = np.flatnonzero(np.asarray(problem.reference["t"]) == end)
        if rows.size:
            digits = problem.reference.get("digits")
            name = "reference" if digits is None else f"reference ({digits} digits)"
            return name, {key: problem.reference[key][rows[-1]] for key in COMPONENTS if key in problem.reference}
    return "", {}


def _shown(values: Vector) -> str:
    numbers = [f"{value: .15g}" for value in values[:MOST_SHOWN]]
    return "  ".join(numbers) + (f"  ... ({values.size})" if values.size > MOST_SHOWN else "")
