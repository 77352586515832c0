"""Check the energy balance and the invariants of a problem.

The balance must hold at every consistent state.  It is measured along the known motion and at synthetic states too, since
both of its sides may vanish at the start, and a motion may not be known.
"""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.checks.independent import independent
from hhtbench.checks.problem.deviation import OWN_ERROR
from hhtbench.checks.problem.reference import Probe, split
from hhtbench.checks.problem.rows import attempt, not_measured
from hhtbench.checks.problem.scales import Sizes
from hhtbench.lowering import (
    CONSISTENT,
    ConstraintLevels,
    Dynamics,
    compile_function,
)
from hhtbench.lowering.dynamics.differences import derivative_along
from hhtbench.lowering.dynamics.kkt import AccelerationLevel
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.evidence import Row
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import declared

MAX_TIMES = 8  # points of the known motion that are measured
MEASURED = ("energy", "power", "invariants")
BALANCE = 1e-9  # share of the largest term of the power balance
BY_DIFFERENCES = 1e-6  # the same for plain callables, beside the error that their differences show themselves
PROJECTIONS = 8  # onto the constraints from nearby: quadratic convergence needs 4
CONSERVED = 1e-9  # change of an invariant over its size, where the known motion is a closed solution
SLACK = 100.0  # error bars of a reference that a change of an invariant may have: it sums over the coordinates

Point = tuple[float, Vector, Vector]  # t, q, v


def conservation_rows(
    dynamics: Dynamics, problem: Problem, sizes: Sizes, states: list[Probe], faults: dict[str, str]
) -> list[Row]:
    """Return rows on the power balance at consistent states, and on the constancy of invariants along the known motion."""
    start = (problem.t_span[0], problem.q0, problem.v0)
    known = attempt(lambda: _known_motion(problem))  # where that fails, a row on the data says so
    motion = [start, *(known.value or [])]
    names = [name for name in MEASURED if declared(problem.system, name) is not None and name not in faults]
    rows = []
    finite = attempt(lambda: bool(np.isfinite(float(declared(problem.system, "energy")(*start)))))
    if "energy" in names and "power" not in faults and finite.value:
        rows.append(_balance_row(dynamics, problem, motion, sizes, states))
    conserved = [name for name in names if name == "invariants" or (name == "energy" and "power" not in names)]
    if conserved and known.value:
        rows.append(_constancy_row(problem, conserved, motion))
    return rows


def _balance_row(dynamics: Dynamics, problem: Problem, motion: list[Point], sizes: Sizes, states: list[Probe]) -> Row:
    fed = declared(problem.system, "power") is not None
    claim = "the energy changes by the declared power" if fed else "the rate of the energy is zero: no power is declared"
    limit = BALANCE if dynamics.xp is jnp else BY_DIFFERENCES
    bound = f"{limit:.0e} of the largest term of that rate"
    outcome = attempt(lambda: _imbalances(dynamics, problem, motion, sizes, states))
    if outcome.fault:
        return not_measured("energy/balance", claim, bound, outcome.fault)
    worst = max(outcome.value)
    text = f"{worst:.2g} at {len(outcome.value)} consistent states"
    return Row(id="energy/balance", claim=claim, measured=text, bound=bound, passed=worst <= limit)


def _constancy_row(problem: Problem, names: list[str], motion: list[Point]) -> Row:
    """Return the row on the relative change of the conserved quantities since the start, for the worst one."""
    claim = f"the {'closed solution' if problem.exact else 'reference'} conserves {' and '.join(names)}"
    known: Any = {} if problem.reference is None or problem.exact else problem.reference
    bars = [known["bars"][name] for name in ("q", "v")] if "bars" in known else [10.0 ** -known.get("digits", math.inf)]
    limit = max([CONSERVED, *(SLACK * float(np.max(bar)) for bar in bars)])
    outcome = attempt(lambda: _changes(problem, names, motion))
    if outcome.fault:
        return not_measured("energy/conserved", claim, f"{limit:.0e}", outcome.fault)
    worst = max(outcome.value, key=lambda name: outcome.value[name])
    text = f"{outcome.value[worst]:.2g} of its size ({worst})"
    bound = f"{limit:.0e} of its size"
    return Row(id="energy/conserved", claim=claim, measured=text, bound=bound, passed=outcome.value[worst] <= limit)


def _changes(problem: Problem, names: list[str], motion: list[Point]) -> dict[str, float]:
    """Return the largest relative change by name; the size includes that of the parts of a sum that stays zero."""

    def values(t: float, q: Vector, v: Vector) -> dict[str, float]:
        found = {"energy": declared(problem.system, "energy")(t, q, v)} if "energy" in names else {}
        found |= declared(problem.system, "invariants")(t, q, v) if "invariants" in names else {}
        return {name: float(np.asarray(value)) for name, value in found.items()}

    moving, resting = [values(*place) for place in motion], [values(t, q, 0 * v) for t, q, v in motion]
    changes = {}
    for name in moving[0]:
        found, parts = (np.array([one[name] for one in places]) for places in (moving, resting))
        size = float(np.max(np.abs(found), initial=np.max(np.abs(parts[np.isfinite(parts)]), initial=0.0)))
        changes[name] = float(np.max(np.abs(found - found[0])) / (size or 1.0))
    return changes


def _known_motion(problem: Problem) -> list[Point]:
    """Return up to ``MAX_TIMES`` points of the closed solution or the reference."""
    if problem.exact is not None:
        times = np.linspace(*problem.t_span, MAX_TIMES)[1:]
        motions = [problem.exact(float(t)) for t in times]
        return [(float(t), np.asarray(x.q), np.asarray(x.v)) for t, x in zip(times, motions, strict=True)]
    if problem.reference is None:
        return []
    t = np.asarray(problem.reference["t"])
    rows = np.unique(np.linspace(0, t.size - 1, min(MAX_TIMES, t.size)).astype(int))
    return [(float(t[i]), problem.reference["q"][i], problem.reference["v"][i]) for i in rows]


def _imbalances(dynamics: Dynamics, problem: Problem, motion: list[Point], sizes: Sizes, states: list[Probe]) -> list[float]:
    """Return |d energy/dt - power| relative to its terms, at the points of ``motion`` and at consistent ones near
    ``states``.

    Near rest the terms are roundoff; the smallest size used is the largest kinetic energy per typical time [s].
    """
    reduced, _ = independent(dynamics, *motion[0])
    dynamics = dynamics if reduced is None else reduced
    level, terms = AccelerationLevel(dynamics), compile_function(energy_terms, dynamics)
    found = []
    for i, place in enumerate([*motion, *_synthetic(dynamics, sizes, states)]):
        at = level.solve(*place, problem.lam_guess, problem.mu_guess)
        if not at.converged:  # there are no accelerations: the rows on the KKT matrix say so
            continue
        rates = np.asarray(terms(*place, at.vdot, at.lam, at.mu))
        if i < len(motion) or np.isfinite(rates).all():  # a synthetic state may lie where something is not defined
            found.append(rates)
    if not found:
        raise ValueError("the accelerations are determined at no consistent state")
    table = np.array(found)
    size = np.maximum(np.max(np.abs(table[:, :5]), axis=1), np.max(np.abs(table[:, 5])) / sizes.t)
    apart = np.maximum(np.abs(table[:, 0] - table[:, 1]) - OWN_ERROR * table[:, 6], 0.0)
    return [float(x) for x in apart / np.maximum(size, np.finfo(float).tiny)]


def _synthetic(dynamics: Dynamics, sizes: Sizes, states: list[Probe]) -> list[Point]:
    """Project the ``states`` onto the constraints; those that cannot be projected are left out."""
    levels = ConstraintLevels(dynamics, full=True)
    places = [split(dynamics.structure, state.z) for state in states]
    moved = [
        attempt(lambda a=a: _consistent(levels, float(a["t"]), a["q"], a["v"], sizes)).value  # type: ignore[misc]
        for a in places
    ]
    return [place for place in moved if place is not None]


def _consistent(levels: ConstraintLevels, t: float, q: Vector, v: Vector, sizes: Sizes) -> Point | None:
    """Project a state onto the constraints by Newton's method in typical sizes; None if it does not converge."""
    for _ in range(PROJECTIONS):
        at = levels.at(t, q, v)
        q = q - _least(at.position_jacobian, at.position, sizes.q)
    for _ in range(PROJECTIONS):
        at = levels.at(t, q, v)
        v = v - _least(at.rows, at.velocity_drift, sizes.v)
    position, velocity = levels.at(t, q, v).misfits(q, v)
    return (t, q, v) if all(row.relative <= CONSISTENT for row in position + velocity) else None


def _least(rows: Matrix, value: Vector, size: Vector) -> Vector:
    """Return the minimum-norm x, in units of ``size``, with ``rows x = value``."""
    return np.asarray(size * np.linalg.lstsq(rows * size, value)[0], dtype=np.float64)


def energy_terms(dynamics: Dynamics, t: Any, q: Any, v: Any, vdot: Any, lam: Any, mu: Any) -> Any:
    """Return (7,): d energy/dt, power, its parts by t, q and v [W], kinetic energy [J], error of the differences [W]."""
    system, xp = dynamics.system, dynamics.xp
    error: Any = 0.0
    if xp is jnp:
        t = jnp.asarray(t, dtype=float)
        along = lambda dt, dq, dv: jax.jvp(system.energy, (t, q, v), (dt, dq, dv))[1]  # noqa: E731
        parts = [along(jnp.ones_like(t), 0 * q, 0 * v), along(0 * t, v, 0 * v), along(0 * t, 0 * q, vdot)]
    else:
        moves = [(1.0, 0 * q, 0 * v), (0.0, v, 0 * v), (0.0, 0 * q, vdot)]
        parts, half = ([_rate(system.energy, t, q, v, move, size) for move in moves] for size in (1.0, 0.5))
        error = sum(abs(a - b) for a, b in zip(parts, half, strict=True))
    power = system.power(t, q, v, lam, mu) if declared(system, "power") is not None else 0.0
    kinetic = v @ dynamics.mass(t, q) @ v / 2
    return xp.stack([xp.asarray(x, dtype=float) for x in (sum(parts), power, *parts, kinetic, error)])


def _rate(energy: Any, t: float, q: Vector, v: Vector, move: tuple[float, Vector, Vector], size: float) -> float:
    """Return the rate of the energy along ``move`` of (t, q, v), by a difference with ``size`` times the usual step."""
    dt, dq, dv = (size * x for x in move)
    curve = lambda e: np.atleast_1d(energy(t + e * dt, q + e * dq, v + e * dv))  # noqa: E731
    return float(derivative_along(curve, t, q, v)[0]) / size
