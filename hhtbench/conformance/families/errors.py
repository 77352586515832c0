"""Errors of a solution against its closed solution, the levels of its constraints or its energy."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hhtbench.conformance.cell import Error, Expected
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution


def motion(most: float) -> dict[str, Expected]:
    """Expect scaled q and v of the closed solution at every row."""
    return {"motion": Expected(error=off, most=most)}


REACTION = 10.0  # error of multipliers over that of the motion: they hold accelerations
HALF = 0.5  # error over the multipliers' scale from which a reaction does not act, or acts twice


def reacting(most: float, rows: Matrix | None = None) -> dict[str, Expected]:
    """Expect q and v of the closed solution, and multipliers ten times less exactly, at every row but the first.

    The first row may be before a jump.  If the ``rows`` (m, p) of p constraints share a reaction, only their sum is known.
    """

    def error(problem: Problem, found: Solution) -> float:
        missed = ((exact(problem, found, "lam") - found.lam) / problem.scales.lam)[1:]
        return float(np.max(np.abs(missed if rows is None else missed @ rows)))

    return motion(most) | {"reaction": Expected(error=error, most=min(REACTION * most, HALF))}


def off(problem: Problem, found: Solution, *further: Solution) -> float:
    """Largest scaled error of q and v over the rows."""
    parts = ((exact(problem, found, name) - getattr(found, name)) / getattr(problem.scales, name) for name in ("q", "v"))
    return float(np.max([np.max(np.abs(part)) for part in parts]))


def exact(problem: Problem, found: Solution, name: str) -> Matrix:
    """``q``, ``v`` or ``lam`` of the closed solution at the rows, (k, n) or (k, m)."""
    if problem.exact is None:
        raise ValueError(f"{problem.name} has no closed solution")
    return np.array([getattr(problem.exact(float(t)), name) for t in found.t])


def along(direction: Any) -> Error:
    """Return the error function of scaled q and v along a unit ``direction`` (n,)."""
    u = np.asarray(direction, dtype=np.float64)

    def error(problem: Problem, found: Solution) -> float:
        q, v = (np.abs((exact(problem, found, name) - getattr(found, name)) @ u) for name in ("q", "v"))
        return float(np.max([np.max(q) / np.max(problem.scales.q), np.max(v) / np.max(problem.scales.v)]))

    return error


def at_the_end(problem: Problem, found: Solution) -> float:
    """Largest scaled error of q at the last row, against the closed solution or else the certified reference."""
    known = known_motion(problem, found.t[-1:]).q[-1]
    return float(np.max(np.abs(known - found.q[-1]) / problem.scales.q))


class KnownMotion(NamedTuple):
    """Known motion of a problem at some times."""

    t: Vector  #: (k,) [s]
    q: Matrix  #: (k, n)
    v: Matrix  #: (k, n)


def known_motion(problem: Problem, times: Vector) -> KnownMotion:
    """The closed solution at ``times``, or the rows of the certified reference within the interval."""
    if problem.exact is not None:
        motions = [problem.exact(float(t)) for t in times]
        return KnownMotion(times, np.array([x.q for x in motions]), np.array([x.v for x in motions]))
    if problem.reference is None:
        raise ValueError(f"nothing is known of the motion of {problem.name}")
    t, q, v = (np.asarray(problem.reference[name], dtype=np.float64) for name in ("t", "q", "v"))
    inside = (t >= min(problem.t_span)) & (t <= max(problem.t_span))
    return KnownMotion(t[inside], q[inside], v[inside])


def held(violated: Callable[[float, Vector, Vector], Any]) -> Error:
    """Return the error function for the largest violation of constraints over the rows, in their own units."""

    def error(problem: Problem, found: Solution, *further: Solution) -> float:
        return float(np.max([np.max(np.abs(violated(*row))) for row in zip(found.t, found.q, found.v, strict=True)]))

    return error


def kept(quantity: Callable[[Vector, Vector], float], size: float) -> Error:
    """Return the error function for the largest change of ``quantity(q, v)`` over the rows, divided by ``size``."""

    def error(problem: Problem, found: Solution) -> float:
        values = np.array([quantity(q, v) for q, v in zip(found.q, found.v, strict=True)])
        return float(np.max(np.abs(values - values[0])) / size)

    return error
