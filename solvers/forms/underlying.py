"""The underlying ODE for y = [q; v], with multipliers eliminated by (F9)."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics
from hhtbench.lowering.dynamics.kkt_rows import kkt_residual, kkt_terms
from hhtbench.protocol.errors import ProblemError
from solvers.forms.rows import ROWS, Point


def rhs_function(dynamics: Dynamics, t: Any, y: Any) -> Any:
    """y' = [v; v'] (2n,) of ``y = [q; v]``; pure, so that JAX can trace it."""
    n = dynamics.structure.n
    right, matrix = _acceleration_level(dynamics, t, y[:n], y[n:])
    return dynamics.xp.concatenate([y[n:], _solve(dynamics, matrix, right)[:n]])


def rhs_along(dynamics: Dynamics, y: Any, t: Any) -> Any:
    """:func:`rhs_function` with y as first argument, for differentiation by it."""
    return rhs_function(dynamics, t, y)


def kkt_along(dynamics: Any, z: Any, t: Any) -> Any:
    """Residual (N,) of (F9) at ``z = [q; v; v'; lam; mu]`` (2n + N,)."""
    n = dynamics.structure.n
    return kkt_residual(dynamics, z[2 * n :], t, z[:n], z[n : 2 * n])


def rhs_jacobian_function(dynamics: Dynamics, t: Any, y: Any) -> Any:
    """Derivative of :func:`rhs_function` by y, (2n, 2n), from the differentiated system (F9)."""
    n = dynamics.structure.n
    right, matrix = _acceleration_level(dynamics, t, y[:n], y[n:])
    return _differentiated(dynamics, matrix, _solve(dynamics, matrix, right), t, y)


def rhs_jacobian_at(dynamics: Dynamics, t: Any, y: Any, x: Any) -> Any:
    """dy'/dy (2n, 2n) where ``x`` = [v'; lam; mu] (N,) is known, for reactions nonlinear in the multipliers."""
    n = dynamics.structure.n
    matrix = kkt_terms(dynamics, t, y[:n], y[n:], x)[x.size :].reshape(x.size, x.size)
    return _differentiated(dynamics, matrix, x, t, y)


def _differentiated(dynamics: Dynamics, matrix: Any, x: Any, t: Any, y: Any) -> Any:
    s, xp = dynamics.structure, dynamics.xp
    q, v = y[: s.n], y[s.n :]
    at = Point(dynamics=dynamics, t=t, q=q, v=v, vdot=x[: s.n], lam=x[s.n : s.n + s.m], mu=x[s.n + s.m :])
    names = ["force"] + ["acceleration"] * bool(s.m) + ["velocity_constraint_rate"] * bool(s.p)
    zero, rows = xp.zeros((s.n, s.n)), []
    for name in names:
        blocks = ROWS[name].derivatives(at)
        rows.append(xp.concatenate([zero if blocks[by] is None else blocks[by] for by in ("q", "v")], axis=1))
    change = -_solve(dynamics, matrix, xp.concatenate(rows, axis=0))[: s.n]
    return xp.concatenate([xp.concatenate([zero, xp.eye(s.n)], axis=1), change], axis=0)


def _acceleration_level(dynamics: Dynamics, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
    """Right-hand side (N,) and matrix (N, N) of (F9); without constraints F (n,) and M, None for a constant one."""
    s = dynamics.structure
    if not s.constrained:
        return dynamics.force(t, q, v), dynamics.mass(t, q) if s.mass == "variable" else None
    if not s.linear_reaction:
        raise ProblemError(
            "a reaction nonlinear in lam needs Newton's iteration for the underlying ODE, which code of XLA cannot call "
            "where the system's functions are no machine code; take another solver than diffrax, or another method of it."
        )
    size = s.n + s.m + s.p
    packed = kkt_terms(dynamics, t, q, v, dynamics.xp.zeros(size))  # linear reactions: one solve from zero is exact
    return -packed[:size], packed[size:].reshape(size, size)


def _solve(dynamics: Dynamics, matrix: Any, right: Any) -> Any:
    """Solve the system with the matrix of (F9) for ``right`` (N,) or (N, columns); not finite where it is singular.

    Rows and columns are not scaled first: with masses over fifteen decades that gained one digit and a half.
    """
    if matrix is None:
        return right if dynamics.structure.mass == "identity" else dynamics.inverse_mass @ right
    try:
        return dynamics.xp.linalg.solve(matrix, right)
    except np.linalg.LinAlgError:  # compiled code raises nothing
        return np.full_like(right, np.nan)
