"""Mass, constraints and acceleration level at the start: consistency, rank, regularity and index."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.checks.problem.reference import Probe, split
from hhtbench.checks.problem.rows import attempt, not_measured, yes_or_fault
from hhtbench.checks.problem.scales import Sizes
from hhtbench.lowering import (
    CONSISTENT,
    SYMMETRIC,
    ConstraintLevels,
    Dynamics,
    Levels,
    Misfit,
    Structure,
    asymmetry,
    mass_is_singular,
    reduce_redundant,
)
from hhtbench.lowering.dynamics.kkt import AccelerationLevel
from hhtbench.lowering.dynamics.kkt_rows import Acceleration
from hhtbench.lowering.dynamics.rank import ConstraintRank
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.evidence import Row
from hhtbench.protocol.problem import Problem

SEMIDEFINITE = 1e-12
DEPENDENT = 1e-10  # singular values below this of the scaled matrix are roundoff of dependent rows
MAX_NAMED = 6  # offending rows in one text


@dataclass(frozen=True)
class Start:
    """Results at the start; each is None if it could not be computed."""

    s: Structure
    levels: Levels | None
    rank: ConstraintRank | None
    found: Acceleration | None
    imbalance: Vector | None  #: (n + m + p,) of the acceleration level, relative to the size of each row's terms
    fault: str  #: why something is missing
    regular: bool = False  #: the KKT matrix of the independent rows is regular


def examine(dynamics: Dynamics, problem: Problem, sizes: Sizes) -> Start:
    """Compute levels, rank and accelerations at the start; errors of the user's functions become ``fault``."""
    s = dynamics.structure
    t, q, v = problem.t_span[0], problem.q0, problem.v0
    levels = attempt(lambda: ConstraintLevels(dynamics, full=True).at(t, q, v))
    rank = attempt(lambda: levels.value.rank)
    guesses = [
        guess if guess is not None and guess.size == size else None
        for guess, size in ((problem.lam_guess, s.m), (problem.mu_guess, s.p))
    ]
    solved = attempt(lambda: _accelerations(AccelerationLevel(dynamics), sizes, t, q, v, *guesses))
    found, imbalance = solved.value or (None, None)
    fault = next(filter(None, (levels.fault, rank.fault, solved.fault)), "")
    regular = found is not None and not found.singular
    if found is not None and not regular and rank.value is not None and rank.value.redundant:
        reduced = reduce_redundant(dynamics, rank.value.redundant)
        regular = reduced is not None and not AccelerationLevel(reduced).solve(t, q, v).singular
    return Start(s, levels.value, rank.value, found, imbalance, fault, regular)


def _packed(found: Acceleration) -> Vector:
    return np.concatenate([found.vdot, found.lam, found.mu])


def _accelerations(
    level: AccelerationLevel, sizes: Sizes, t: float, q: Vector, v: Vector, lam: Any, mu: Any
) -> tuple[Acceleration, Vector]:
    """Solve the acceleration level, by least squares if its matrix is singular; return the solution and its relative
    residual.
    """
    s = level.structure
    found = level.solve(t, q, v, lam, mu)
    x = _packed(found)
    if found.singular:
        residual, matrix = level.terms(t, q, v, x)
        x = x - _least_squares(matrix, residual)
        found = Acceleration(x[: s.n], x[s.n : s.n + s.m], x[s.n + s.m :], converged=False, singular=True)
    residual, matrix = level.terms(t, q, v, x)
    at_rest, _ = level.terms(t, q, v, np.zeros_like(x))
    size = np.abs(matrix) @ np.abs(x) + np.abs(at_rest)
    typical = np.concatenate([sizes.v / sizes.t, sizes.lam, sizes.mu])
    size += np.abs(matrix) @ typical  # a row may hold roundoff alone, where nothing moves or pulls
    return found, np.abs(residual) / np.where(size > 0, size, 1.0)


def _least_squares(matrix: Matrix, right: Vector) -> Vector:
    row = np.abs(matrix).max(axis=1)
    scaled = matrix / np.where(row > 0, row, 1.0)[:, None]
    return np.asarray(np.linalg.lstsq(scaled, right / np.where(row > 0, row, 1.0), rcond=DEPENDENT)[0], dtype=np.float64)


def mass_rows(dynamics: Dynamics, states: list[Probe], found: Start) -> list[Row]:
    """Return rows: the mass matrix is symmetric and positive semidefinite."""
    if dynamics.structure.mass == "identity":
        return []
    claims = (
        ("mass/symmetric", "the mass matrix is symmetric", f"{SYMMETRIC:.0e} of the diagonal entries"),
        (
            "mass/definite",
            "no mass is negative: the mass matrix is positive semidefinite",
            "smallest eigenvalue not below 0",
        ),
    )
    points = states if dynamics.structure.mass == "variable" else states[:1]
    arguments = [split(dynamics.structure, state.z) for state in points]
    outcome = attempt(lambda: [np.asarray(dynamics.mass(a["t"], a["q"])) for a in arguments])
    fault = outcome.fault or ("" if np.all(np.isfinite(outcome.value)) else "it holds NaN or infinity")
    if fault:
        return [not_measured(*claim, fault) for claim in claims]
    skew, entries = max(map(asymmetry, outcome.value))
    smallest = min(_smallest_eigenvalue(mass) for mass in outcome.value)
    ok = smallest >= -SEMIDEFINITE
    text = f"{smallest:.2g} (unit diagonal)"
    if not ok:
        least, i = min((float(mass[i, i]), i) for mass in outcome.value for i in range(len(mass)))
        text += f"; M[{i}, {i}] = {least:.4g}" if least < 0.0 else "; no diagonal entry is negative, but a combination is"
    if ok and mass_is_singular(outcome.value[0]):
        regular = found.found is not None and not found.found.singular
        text = f"singular; {'allowed, since the KKT matrix is regular' if regular else 'and the KKT matrix is not regular'}"
    return [
        Row(
            id=claims[0][0],
            claim=claims[0][1],
            measured=f"{skew:.2g}: {entries}" if entries else skew,
            bound=claims[0][2],
            passed=not entries,
        ),
        Row(id=claims[1][0], claim=claims[1][1], measured=text, bound=claims[1][2], passed=ok),
    ]


def _smallest_eigenvalue(mass: Matrix) -> float:
    """Return the smallest eigenvalue of the symmetric part scaled to unit diagonal, so that units do not matter."""
    size = np.sqrt(np.abs(np.diag(mass)))
    size = np.where(size > 0, size, np.sqrt(np.abs(mass).max() or 1.0))
    return float(np.linalg.eigvalsh((mass + mass.T) / 2 / np.outer(size, size)).min())


def consistency_rows(start: Start, problem: Problem) -> list[Row]:
    """Return rows: the start satisfies the constraints at all three levels; the first two by the solvers' own test."""
    levels = {}
    if start.s.m:
        levels["start/position"] = "the start satisfies the position constraints", "coordinate"
    if start.s.constrained:
        levels["start/velocity"] = "the start's velocities satisfy the constraints", "velocity"
    rows = []
    found = None if start.levels is None else start.levels.misfits(problem.q0, problem.v0)
    for row_id, (claim, unit) in levels.items():
        bound = f"{CONSISTENT:.0e} of the largest {unit}"
        if found is None:
            rows.append(not_measured(row_id, claim, bound, start.fault))
        else:
            rows.append(_level_row(row_id, claim, bound, found[row_id == "start/velocity"]))
    return [*rows, _acceleration_row(start)]


def _level_row(row_id: str, claim: str, bound: str, misfits: list[Misfit]) -> Row:
    """Return the row of one level; it names the violated constraints with their sizes, the largest first."""
    largest = sorted(misfits, key=lambda row: np.nan_to_num(row.relative, nan=np.inf), reverse=True)
    wrong = [f"{row.name} = {row.value:.3g}" for row in largest if not row.relative <= CONSISTENT]
    measured: str | float = float(largest[0].relative)
    if wrong:
        measured = f"{measured:.2g}: {', '.join(wrong[:MAX_NAMED])}{', ...' if len(wrong) > MAX_NAMED else ''}"
    return Row(id=row_id, claim=claim, measured=measured, bound=bound, passed=not wrong)


def _acceleration_row(start: Start) -> Row:
    claim = "accelerations and multipliers exist at the start" if start.s.constrained else "accelerations exist at the start"
    bound = f"{CONSISTENT:.0e} of each row's terms"
    if start.imbalance is None or start.found is None:
        return not_measured("start/acceleration", claim, bound, start.fault)
    s = start.s
    labels = [f"(M vdot - F - Q)[{i}]" for i in range(s.n)]
    labels += [f"d2g/dt2[{i}]" for i in range(s.m)] + [f"dk/dt[{i}]" for i in range(s.p)]
    misfits = [Misfit(name, size, size) for name, size in zip(labels, start.imbalance, strict=True)]
    row = _level_row("start/acceleration", claim, bound, misfits)
    if row.passed and start.found.singular:
        return Row(id=row.id, claim=claim, measured=f"{row.measured:.2g}, but not unique", bound=bound, passed=True)
    return row


def regularity_rows(start: Start, redundant: bool) -> list[Row]:
    """Return rows on the rank of the constraints, the KKT matrix and the index; ``redundant``: the problem has that tag."""
    rows, claim = [], "the mass matrix is regular"
    if start.s.constrained:
        claim, bound = (
            "the rows of the constraint Jacobian [g_q; k_v] are independent",
            f"rank {start.s.m + start.s.p}",
        )
        if redundant:
            claim, bound = "rows of the constraint Jacobian depend on others, as the tag redundant says", "dependent rows"
        if start.rank is None:
            rows.append(not_measured("rank", claim, bound, start.fault))
        else:
            full = start.rank.rank == start.rank.rows
            measured = f"rank {start.rank.rank}" if full else f"{start.rank.text}: {_names(start)}"
            rows.append(Row(id="rank", claim=claim, measured=measured, bound=bound, passed=full != redundant))
        claim = "the KKT matrix [[M, C^T], [C, 0]] is regular"
    if start.found is None:
        rows.append(not_measured("kkt", claim, "regular", start.fault))
    else:
        claim += ", its redundant rows left out" if redundant else ""
        regular = start.regular if redundant else not start.found.singular
        rows.append(yes_or_fault("kkt", claim, "" if regular else "singular", "regular", "regular"))
    return [*rows, _index_row(start, redundant)]


def _names(start: Start) -> str:
    assert start.rank is not None  # noqa: S101 - for the type checker
    return ", ".join(f"g[{i}]" if i < start.s.m else f"k[{i - start.s.m}]" for i in start.rank.redundant)


def _index_row(start: Start, redundant: bool) -> Row:
    claim = "the differential index is defined"
    if start.found is None or (start.rank is None and start.s.constrained):
        return not_measured("index", claim, "0, 2 or 3", start.fault)
    reason = ""
    if redundant and start.regular:
        pass
    elif start.rank is not None and start.rank.rank < start.rank.rows:
        reason = f"redundant rows {_names(start)}"
    elif start.found.singular:
        reason = "the KKT matrix is singular" if start.s.constrained else "the mass matrix is singular"
    index = "3 (position constraints)" if start.s.m else "2 (velocity constraints only)" if start.s.p else "0 (an ODE)"
    return yes_or_fault("index", claim, reason and f"not defined ({reason})", index, "0, 2 or 3")
