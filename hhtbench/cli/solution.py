"""Print one solution: end state, error at the end where it is known; and the same with all rows for a file."""

from __future__ import annotations

from typing import Any

import numpy as np
from tabulate import tabulate

from hhtbench.campaign.accuracy import COMPONENTS, compare
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.printing import exact
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution

MOST_SHOWN = 12  # entries of a vector on the terminal; the file holds all


def end_state(solution: Solution) -> str:
    """Format the last row of the solution; "" if it has no rows."""
    if not np.size(solution.t):
        return ""
    rows = [(name, _shown(getattr(solution, name)[-1])) for name in COMPONENTS if getattr(solution, name).shape[1]]
    return f"at t = {exact(solution.t[-1])} s\n" + tabulate(rows, tablefmt="plain", disable_numparse=True)


def errors_at_end(problem: Problem, solution: Solution) -> str:
    """Format the largest errors at the end against the exact solution or the reference; "" if neither is known there."""
    source, errors = _errors(problem, solution)
    if not errors:
        return ""
    rows = [(name, f"{largest:.3e}", f"{scaled:.3e}") for name, (largest, scaled) in errors.items()]
    headers = ["", "largest error", "by scale"]
    return f"against the {source}\n" + tabulate(rows, headers=headers, tablefmt="plain", disable_numparse=True)


def as_dict(problem: Problem, solution: Solution) -> dict[str, Any]:
    """Return status, message, counters, rows and known errors as plain Python values and arrays.

    ``error`` and ``extrapolated`` are those of the solution, None without ``accuracy``; ``at_end`` holds the errors that
    :func:`errors_at_end` prints.
    """
    arrays = {name: getattr(solution, name) for name in ("t", *COMPONENTS)}
    source, errors = _errors(problem, solution)
    known = {name: {"largest": largest, "by_scale": scaled} for name, (largest, scaled) in errors.items()}
    return {
        "status": solution.status.label,
        "message": solution.message,
        "counters": vars(solution.counters),
        "error": None if solution.error is None else vars(solution.error),
        "extrapolated": None if solution.extrapolated is None else solution.extrapolated._asdict(),
        "at_end": {"against": source, **known} if known else None,
        **arrays,
    }


def _errors(problem: Problem, solution: Solution) -> tuple[str, dict[str, tuple[float, float]]]:
    """Return what the end is compared with and the largest error of each part, in its units and scaled; empty if unknown."""
    found = compare(problem, solution) if solution.success else None
    if found is None or not found.at_end:
        return "", {}
    entries = found.metrics()
    digits = "" if found.digits is None else f" ({found.digits} digits)"
    source = "exact solution" if found.against == "exact" else f"reference{digits}"
    return source, {name: (entries[name]["end"], entries[name]["end_scaled"]) for name in COMPONENTS if name in entries}


def _shown(values: Vector) -> str:
    numbers = [f"{value: .15g}" for value in values[:MOST_SHOWN]]
    return "  ".join(numbers) + (f"  ... ({values.size})" if values.size > MOST_SHOWN else "")
