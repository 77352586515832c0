"""The KKT system of the acceleration level, (H16) of THEORY.md: its residual, its matrix, and what solves it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from hhtbench.lowering.dynamics.dynamics import Dynamics
from hhtbench.protocol.arguments import Vector


@dataclass(frozen=True)
class Acceleration:
    """Result of the acceleration level at one point."""

    vdot: Vector  #: (n,) [m/s^2, rad/s^2]
    lam: Vector  #: (m,) [N, N m]
    mu: Vector  #: (p,) [N, N m]
    converged: bool  #: False: the matrix is singular, or no multipliers of a nonlinear reaction were found from the guess
    singular: bool  #: the KKT matrix is singular here
    weakest: float = 1.0  #: least pivot of a sparse KKT matrix over its largest: small where it is nearly singular


def kkt_terms(dynamics: Dynamics, t: Any, q: Any, v: Any, x: Any) -> Any:
    """Residual and matrix of the KKT system at ``x = [vdot, lam, mu]``, packed into one vector (N + N*N,)."""
    s, xp = dynamics.structure, dynamics.xp
    vdot, lam, mu = x[: s.n], x[s.n : s.n + s.m], x[s.n + s.m :]
    mass = dynamics.mass(t, q)
    rows, rest = dynamics.acceleration_level(t, q, v)
    residual = [dynamics.residual(t, q, v, mass @ vdot, lam, mu), rows @ vdot + rest]
    top = [mass]
    if s.m:
        top.append(-dynamics.reaction_columns(t, q, v, lam))
    if s.p:
        top.append(-dynamics.velocity_reaction_jacobians(t, q, v, mu)[1])
    bottom = [rows, xp.zeros((s.m + s.p, s.m + s.p))]
    matrix = xp.concatenate([xp.concatenate(top, axis=1), xp.concatenate(bottom, axis=1)])
    return xp.concatenate([*residual, matrix.ravel()])


def kkt_residual(dynamics: Dynamics, x: Any, t: Any, q: Any, v: Any) -> Any:
    """Residual (N,) of the KKT system at ``x = [vdot, lam, mu]``, N = n + m + p."""
    s = dynamics.structure
    vdot, lam, mu = x[: s.n], x[s.n : s.n + s.m], x[s.n + s.m :]
    rows = [dynamics.residual(t, q, v, dynamics.mass_product(t, q, vdot), lam, mu)]
    if s.m:
        rows.append(dynamics.position_row(t, q, vdot) + dynamics.constraint_acceleration(t, q, v))
    if s.p:
        rows.append(dynamics.velocity_row(t, q, v, vdot) + dynamics.velocity_constraint_acceleration(t, q, v))
    return dynamics.xp.concatenate(rows)
