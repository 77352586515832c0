"""Drift of a solution: the three levels of the constraints, energy and invariants.

Many states are evaluated at once: one at a time would cost as much as the solve.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.checks.drift.energy import (
    Balance,
    Fed,
    balance,
    fed_by,
    power_needs_multipliers,
    power_of_level,
    power_of_state,
    with_middles,
)
from hhtbench.checks.drift.joined import joined
from hhtbench.checks.drift.record import Drift, Level
from hhtbench.checks.phases import phases_of
from hhtbench.checks.result.levels import Rows, at_rows, declared_sizes
from hhtbench.lowering import Dynamics, compile_function, derive
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import declared
from hhtbench.solution.result import Ends, Solution, ends_of

NO_MULTIPLIERS = "no multipliers of its own: zero by construction"
SINGULAR_MASS = "the accelerations do not follow from the multipliers: the mass is singular, or a value is not finite"
EMPTY = 1e-10  # terms that stay below this share of the largest row are roundoff
MAX_OWN = 5000  # states at which the acceleration level is measured, each by a linear system of its own
CHUNK = 256  # states per call: one compiled shape for all lengths

_names = Cache(16)  # names of invariants, by system


@dataclass(frozen=True)
class Own:
    """States with the multipliers that the solver itself computes there."""

    t: Vector  #: (r,) [s]
    q: Matrix  #: (r, n)
    v: Matrix  #: (r, n)
    lam: Matrix  #: (r, m)
    mu: Matrix  #: (r, p)


def measure_drift(problem: Problem, solution: Solution) -> Drift | None:
    """Measure the drift over all internal steps if they are known (``ends_of``), else over rows; None if there is no state.

    HHT's rows between steps are not used: they are projected onto the constraints and drift less than its steps.  Where
    events change the system, the drift of a phase is that since its start.
    """
    if solution.phases:
        return joined([found for one in phases_of(problem, solution) if (found := measure_drift(*one)) is not None])
    sampled, t, q, v = _states(solution)
    if t.size == 0:
        return None
    dynamics = derive(problem.system, float(t[0]), q[0], v[0])
    s = dynamics.structure
    names = _invariant_names(problem, float(t[0]), q[0], v[0])
    scaled, bare = _levels(problem, dynamics, (t, q, v))
    energetic = declared(problem.system, "energy") is not None
    values = _in_chunks(state_terms, dynamics, (names, energetic), (t, q, v)) if names or energetic else np.zeros((0, 2))
    energies, kept = np.split(values, [2], axis=1)
    own = own_at_steps(solution)
    acceleration, note = _acceleration(dynamics, own) if s.constrained else (None, None)
    energy = Balance(None, None)
    if energetic:
        energy = _energy(dynamics, (t, q, v), energies)
    return Drift(
        sampled=sampled,
        t=t,
        h=np.abs(np.diff(t)) if sampled == "steps" else None,
        position=np.max(scaled[:, : s.m], axis=1) if s.m else None,
        velocity=np.max(scaled[:, s.m :], axis=1) if s.constrained else None,
        absolute={
            "position_absolute": float(np.max(bare[:, : s.m])) if s.m else None,
            "velocity_absolute": float(np.max(bare[:, s.m :])) if s.constrained else None,
        },
        energy=energy.drift,
        energy_note=energy.note,
        invariants={name: _change(kept[:, i]) for i, name in enumerate(names)},
        acceleration=acceleration,
        acceleration_note=note,
    )


def _levels(problem: Problem, dynamics: Dynamics, rows: Rows) -> tuple[Matrix, Matrix]:
    """Return the violations of g, the velocity level and k at every row, (k, 2m + p), scaled and unscaled."""
    if not dynamics.structure.constrained:
        return np.zeros((0, 0)), np.zeros((0, 0))
    s_q, s_v = declared_sizes(problem)
    t, q, v = rows
    parts = [slice(i, i + CHUNK) for i in range(0, t.size, CHUNK)]
    found = [at_rows(dynamics).measured((t[part], q[part], v[part]), (s_q, s_v, s_v)) for part in parts]
    values, sizes = (np.concatenate(one) for one in zip(*found, strict=True))
    return _relative(np, values, sizes), np.abs(values)


def state_terms(dynamics: Dynamics, names: Any, energetic: bool, t: Any, q: Any, v: Any) -> Any:
    """Energy, kinetic energy and the invariants, in one vector."""
    xp = dynamics.xp
    energy = [dynamics.system.energy(t, q, v), v @ dynamics.mass(t, q) @ v / 2] if energetic else [0.0, 0.0]
    found = dynamics.system.invariants(t, q, v) if names else {}
    return xp.stack([xp.asarray(value, dtype=float) for value in [*energy, *(found[name] for name in names)]])


def row_terms(dynamics: Dynamics, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
    """Constraint violation at the acceleration level for given multipliers, followed by the size of its terms."""
    xp = dynamics.xp
    forces = -dynamics.residual(t, q, v, 0.0, lam, mu)
    vdot = xp.linalg.solve(dynamics.mass(t, q), forces)
    rows, rest = dynamics.acceleration_level(t, q, v)
    return xp.concatenate([xp.abs(rows @ vdot + rest), xp.abs(rows) @ xp.abs(vdot) + xp.abs(rest)])


def all_states(dynamics: Dynamics, terms: Any, static: Any, *rows: Any) -> Any:
    """Evaluate ``terms`` at every state; the arguments hold one row per state."""

    def one(*state: Any) -> Any:
        return terms(dynamics, *static, *state)

    if dynamics.xp is jnp:
        return jax.vmap(one)(*rows)
    return np.array([one(float(row[0]), *row[1:]) for row in zip(*rows, strict=True)])


def _in_chunks(terms: Any, dynamics: Dynamics, static: Any, varying: tuple[Any, ...]) -> Matrix:
    call = compile_function(all_states, dynamics, terms, static, route="xla")  # one loop over all states
    count, found = varying[0].shape[0], []
    for start in range(0, count, CHUNK):
        rows = np.minimum(np.arange(start, start + CHUNK), count - 1)  # the last chunk is filled up with the last state
        if dynamics.xp is np:
            rows = rows[: count - start]
        found.append(call(*(values[rows] for values in varying))[: count - start])
    return np.concatenate(found, axis=0)


def _states(solution: Solution) -> tuple[str, Vector, Matrix, Matrix]:
    """Return where the drift is measured ("steps" or "rows") and t, q, v there, up to the first value that is not finite."""
    ends = ends_of(solution)
    sampled, rows = ("rows", solution) if ends is None else ("steps", ends)
    if np.size(rows.t) == 0:
        return sampled, np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))
    t, q, v = (np.asarray(x, dtype=np.float64) for x in (rows.t, rows.q, rows.v))
    finite = np.isfinite(t) & np.isfinite(q).all(axis=1) & np.isfinite(v).all(axis=1)
    kept = t.size if finite.all() else int(np.argmin(finite))
    return sampled, t[:kept], q[:kept], v[:kept]


def own_at_rows(rows: Solution | Ends) -> Own | None:
    """Return the multipliers that the solver itself computes at ``rows``; None if it has none.

    These are not ``lam`` and ``mu``, which are recovered from the acceleration level and satisfy it by construction.
    """
    if rows.carried is None:
        return None
    carried = (np.asarray(rows.carried[name], dtype=np.float64) for name in ("lam", "mu"))
    return Own(np.asarray(rows.t), np.asarray(rows.q), np.asarray(rows.v), *carried)


def own_at_steps(solution: Solution) -> Own | None:
    """Return the solver's own multipliers at its steps if they are known, else at the rows."""
    found = own_at_rows(solution if solution.ends is None else solution.ends) or own_at_rows(solution)
    steps = solution.steps_data
    if found is not None or steps is None or steps.t.size == 0 or solution.interpolant is None:
        return found
    at = solution(steps.t)
    return Own(steps.t, at.q, at.v, steps.lam_end, steps.mu_half)


def _acceleration(dynamics: Dynamics, own: Own | None) -> tuple[Level | None, str | None]:
    """Measure the drift at the acceleration level at up to ``MAX_OWN`` states of ``own``, or return None and the reason.

    It is relative to the largest size of the row's terms in the run, since at an instant where all terms vanish, such as a
    turning point, any error is as large as they are.  A row whose terms are roundoff throughout, such as an out-of-plane
    joint of a planar motion, is relative to the terms of the largest row.
    """
    s = dynamics.structure
    if own is None:
        return None, NO_MULTIPLIERS
    if own.t.size == 0 or own.lam.shape != (own.t.size, s.m) or own.mu.shape != (own.t.size, s.p):
        return None, "the solver's own multipliers do not fit its rows"
    known = np.flatnonzero(~np.isnan(np.concatenate([own.lam, own.mu], axis=1)).any(axis=1))
    unknown = f"where its multipliers are nan, in {own.t.size - known.size} of {own.t.size} rows"
    if not known.size:
        return None, unknown
    some = known[np.unique(np.linspace(0, known.size - 1, MAX_OWN).astype(int))]
    try:
        terms = _in_chunks(row_terms, dynamics, (), tuple(part[some] for part in (own.t, own.q, own.v, own.lam, own.mu)))
    except np.linalg.LinAlgError:
        return None, SINGULAR_MASS
    if not np.isfinite(terms).all():
        return None, SINGULAR_MASS
    imbalance, sizes = np.split(terms, 2, axis=1)
    largest = sizes.max(axis=0)
    largest[largest < EMPTY * largest.max()] = largest.max()
    value = np.max(_relative(np, imbalance, largest), axis=1)
    return Level(own.t[some], value), unknown if known.size < own.t.size else None


def _energy(dynamics: Dynamics, states: tuple[Vector, Matrix, Matrix], energies: Matrix) -> Balance:
    """Return the energy balance at the ``states``; ``energies`` (k, 2) holds energy and kinetic energy."""
    t, q, v = states
    nothing = Fed(np.zeros(t.size), np.zeros(t.size))
    if declared(dynamics.system, "power") is None or np.ptp(t) == 0.0:
        return balance(energies[:, 0], energies[:, 1], nothing)
    terms: Any = power_of_state
    if power_needs_multipliers(dynamics, float(t[0]), q[0], v[0]):
        if not dynamics.structure.linear_reaction:
            return Balance(None, "the power needs multipliers, and the reaction is nonlinear in them")
        terms = power_of_level
    between = with_middles(states)
    try:
        power = _in_chunks(terms, dynamics, (), between)[:, 0]
    except np.linalg.LinAlgError:
        power = np.full(between[0].size, np.nan)
    if not np.isfinite(power).all():
        return Balance(None, "the power is not finite, or the multipliers in it are not determined")
    return balance(energies[:, 0], energies[:, 1], fed_by(t, between[0], power))


def _change(values: Vector) -> Vector:
    return np.abs(values - values[0]) / (abs(values[0]) if values[0] != 0 else 1.0)


def _invariant_names(problem: Problem, t: float, q: Vector, v: Vector) -> tuple[str, ...]:
    """Return the names of the invariants, cached: calling JAX functions without compiling takes as long as a small solve."""
    function = declared(problem.system, "invariants")
    if function is None:
        return ()
    names: tuple[str, ...] = _names.find(by_id(problem.system), lambda: tuple(sorted(function(t, q, v))))
    return names


def _relative(xp: Any, value: Any, size: Any) -> Any:
    """Return |value| / size; a row of size zero is divided by one."""
    return xp.abs(value) / xp.where(size > 0, size, 1.0)
