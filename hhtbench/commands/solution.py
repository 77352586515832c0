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
    source, errors = _errors(problem, solution)
    if not errors:
        return ""
    rows = [(name, f"{largest:.3e}", f"{scaled:.3e}") for name, (largest, scaled) in errors.items()]
    headers = ["", "largest error", "by scale"]
    return f"against the {source}\n" + tabulate(rows, headers=headers, tablefmt="plain", disable_numparse=True)


def as_dict(problem: Problem, solution: Solution) -> dict[str, Any]:
    """Status, message, counters, rows, and what is known of their error, as plain Python values but for the arrays.

    ``error`` and ``extrapolated`` are those of the solution, None without ``accuracy``; ``at_end`` what
    :func:`errors_at_end` tells.
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
    """What the end is held against, and the largest error of each part, in its units and scaled; none where not known."""
    if not solution.success or not np.size(solution.t) or solution.t[-1] != problem.t_span[1]:
        return "", {}
    source, known = _known_end(problem)
    found = {}
    for name, value in known.items():
        got = getattr(solution, name)[-1]
        want = np.asarray(value, dtype=np.float64)
        if got.size and want.shape == got.shape:
            error = np.abs(got - want)
            found[name] = float(error.max()), float(np.max(error / np.asarray(getattr(problem.scales, name))))
    return source, found


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
