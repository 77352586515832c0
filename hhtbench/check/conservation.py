"""Energy and invariants along the known motion: what is declared to be conserved is, what is fed is fed by ``power``."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Vector
from hhtbench.check.rows import attempt, not_measured
from hhtbench.check.scales import Sizes
from hhtbench.evidence import Row
from hhtbench.lowering import AccelerationLevel, ConstraintLevels, compile_function, constraint_rank, reduce_redundant
from hhtbench.lowering.differences import derivative_along
from hhtbench.protocol import Problem, declared

MOST_TIMES = 8  # points of the known motion that are looked at
MEASURED = ("energy", "power", "invariants")
BALANCE = 1e-9  # of the largest term of the power balance
BY_DIFFERENCES = 1e-6  # the same for plain callables
CONSERVED = 1e-9  # of the size, where the known motion is a closed solution
SLACK = 100.0  # error bars of a reference that a change of an invariant may have: it sums over the coordinates

Point = tuple[float, Vector, Vector]  # t, q, v


def conservation_rows(dynamics: Any, problem: Problem, sizes: Sizes, faults: dict[str, str]) -> list[Row]:
    """Power balance at points of the known motion, and constancy of what is conserved along it."""
    start = (problem.t_span[0], problem.q0, problem.v0)
    known = attempt(lambda: _known_motion(problem))  # where that fails, a row on the data says so
    motion = [start, *(known.value or [])]
    names = [name for name in MEASURED if declared(problem.system, name) is not None and name not in faults]
    rows = []
    finite = attempt(lambda: bool(np.isfinite(float(declared(problem.system, "energy")(*start)))))
    if "energy" in names and "power" not in faults and finite.value:
        rows.append(_balance_row(dynamics, problem, motion, sizes))
    conserved = [name for name in names if name == "invariants" or (name == "energy" and "power" not in names)]
    if conserved and known.value:
        rows.append(_constancy_row(problem, conserved, motion))
    return rows


def _balance_row(dynamics: Any, problem: Problem, motion: list[Point], sizes: Sizes) -> Row:
    fed = declared(problem.system, "power") is not None
    claim = "the energy changes by the declared power" if fed else "the rate of the energy is zero: no power is declared"
    limit = BALANCE if dynamics.xp is jnp else BY_DIFFERENCES
    bound = f"{limit:.0e} of the largest term of that rate"
    outcome = attempt(lambda: _imbalances(dynamics, problem, motion, sizes.t))
    if outcome.fault:
        return not_measured("energy/balance", claim, bound, outcome.fault)
    worst = max(outcome.value)
    text = f"{worst:.2g} at {len(motion)} points of the known motion"
    return Row(id="energy/balance", claim=claim, measured=text, bound=bound, passed=worst <= limit)


def _constancy_row(problem: Problem, names: list[str], motion: list[Point]) -> Row:
    """Change since the start over the size, for the worst of what is conserved."""
    claim = f"the {'closed solution' if problem.exact else 'reference'} conserves {' and '.join(names)}"
    bars = [] if problem.reference is None or problem.exact else [problem.reference["bars"][name] for name in ("q", "v")]
    limit = max([CONSERVED, *(SLACK * float(np.max(bar)) for bar in bars)])
    outcome = attempt(lambda: _changes(problem, names, motion))
    if outcome.fault:
        return not_measured("energy/conserved", claim, f"{limit:.0e}", outcome.fault)
    worst = max(outcome.value, key=lambda name: outcome.value[name])
    text = f"{outcome.value[worst]:.2g} of its size ({worst})"
    bound = f"{limit:.0e} of its size"
    return Row(id="energy/conserved", claim=claim, measured=text, bound=bound, passed=outcome.value[worst] <= limit)


def _changes(problem: Problem, names: list[str], motion: list[Point]) -> dict[str, float]:
    """Largest change over the size, by name; what v adds counts too: a sum that stays zero has the size of its parts."""
    found: dict[str, list[float]] = {}
    parts: dict[str, float] = {}
    kinetic = 0.0
    for t, q, v in motion:
        if "energy" in names:
            energy = declared(problem.system, "energy")
            found.setdefault("energy", []).append(float(energy(t, q, v)))
            kinetic = max(kinetic, abs(float(energy(t, q, v)) - float(energy(t, q, 0 * v))))
        if "invariants" in names:
            at_rest = declared(problem.system, "invariants")(t, q, 0 * v)
            for name, value in declared(problem.system, "invariants")(t, q, v).items():
                found.setdefault(name, []).append(float(np.asarray(value)))
                part = abs(float(np.asarray(at_rest[name])))
                parts[name] = max(parts.get(name, 0.0), part if np.isfinite(part) else 0.0)
    changes = {}
    for name, values in found.items():
        size = max(*np.abs(values), kinetic if name == "energy" else parts.get(name, 0.0))
        changes[name] = float(np.max(np.abs(np.array(values) - values[0])) / (size or 1.0))
    return changes


def _known_motion(problem: Problem) -> list[Point]:
    """Points of the closed solution or the reference."""
    if problem.exact is not None:
        times = np.linspace(*problem.t_span, MOST_TIMES)[1:]
        motions = [problem.exact(float(t)) for t in times]
        return [(float(t), np.asarray(x.q), np.asarray(x.v)) for t, x in zip(times, motions, strict=True)]
    if problem.reference is None:
        return []
    t = np.asarray(problem.reference["t"])
    rows = np.unique(np.linspace(0, t.size - 1, min(MOST_TIMES, t.size)).astype(int))
    return [(float(t[i]), problem.reference["q"][i], problem.reference["v"][i]) for i in rows]


def _imbalances(dynamics: Any, problem: Problem, motion: list[Point], time: float) -> list[float]:
    """|d energy/dt - power| over the size of its terms, at consistent states.

    Near rest the terms are roundoff; the largest kinetic energy per typical ``time`` [s] is the least size.
    """
    dynamics = _independent(dynamics, motion[0])
    level, terms = AccelerationLevel(dynamics), compile_function(energy_terms, dynamics)
    found = []
    for t, q, v in motion:
        at = level.solve(t, q, v, problem.lam_guess, problem.mu_guess)
        if not at.singular and not at.residual > 0:  # else there are no accelerations: the rows on the KKT matrix say so
            found.append(np.asarray(terms(t, q, v, at.vdot, at.lam, at.mu)))
    if not found:
        raise ValueError("the accelerations are determined at no point of the known motion")
    rates = np.array(found).reshape(-1, 6)
    size = np.maximum(np.max(np.abs(rates[:, :5]), axis=1), np.max(np.abs(rates[:, 5]), initial=0.0) / time)
    return [float(x) for x in np.abs(rates[:, 0] - rates[:, 1]) / np.maximum(size, np.finfo(float).tiny)]


def _independent(dynamics: Any, place: Point) -> Any:
    """The dynamics without redundant rows, whose multipliers no power can depend on; itself where there are none."""
    if not dynamics.structure.constrained:
        return dynamics
    at = ConstraintLevels(dynamics, full=True).at(*place)
    rank = constraint_rank(at.position_jacobian, at.velocity_jacobian)
    reduced = reduce_redundant(dynamics, rank.redundant) if rank.redundant else None
    return dynamics if reduced is None else reduced


def energy_terms(dynamics: Any, t: Any, q: Any, v: Any, vdot: Any, lam: Any, mu: Any) -> Any:
    """d energy/dt, power, the three rates that the first consists of (by t, q and v) [W]; kinetic energy [J]: (6,)."""
    system, xp = dynamics.system, dynamics.xp
    if xp is jnp:
        t = jnp.asarray(t, dtype=float)
        along = lambda dt, dq, dv: jax.jvp(system.energy, (t, q, v), (dt, dq, dv))[1]  # noqa: E731
        parts = [along(jnp.ones_like(t), 0 * q, 0 * v), along(0 * t, v, 0 * v), along(0 * t, 0 * q, vdot)]
    else:

        def along(dt: float, by_q: Any, by_v: Any) -> Any:
            curve = lambda e: np.atleast_1d(system.energy(t + e * dt, q + e * by_q, v + e * by_v))  # noqa: E731
            return derivative_along(curve, t, q, v)[0]

        parts = [along(1.0, 0 * q, 0 * v), along(0.0, v, 0 * v), along(0.0, 0 * q, vdot)]
    power = system.power(t, q, v, lam, mu) if declared(system, "power") is not None else 0.0
    return xp.stack([xp.asarray(x, dtype=float) for x in (sum(parts), power, *parts, v @ dynamics.mass(t, q) @ v / 2)])
