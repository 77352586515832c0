"""The equations of the forms, block by block: value and derivatives by the quantities at a point."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from hhtbench.lowering import Dynamics

Blocks = dict[str, Any]  # name of a quantity of Point -> derivative by it (rows, its size); None or absent: zero


@dataclass(frozen=True, kw_only=True)
class Point:
    """All quantities of the equations at one time; None for those that a form does not have."""

    dynamics: Dynamics
    t: Any  #: [s]
    q: Any  #: (n,)
    v: Any  #: (n,)
    qdot: Any = None  #: (n,) q', which is not v where eta acts
    vdot: Any = None  #: (n,)
    lam: Any = None  #: (m,)
    mu: Any = None  #: (p,)
    eta: Any = None  #: (m,) multipliers of (F1) [kg^-1 N s or what makes g_q^T eta a velocity]

    @cached_property
    def constraint_jacobian(self) -> Any:
        """g_q (m, n)."""
        return self.dynamics.constraint_jacobian(self.t, self.q)

    @cached_property
    def velocity_constraint_jacobian(self) -> Any:
        """k_v (p, n)."""
        return self.dynamics.velocity_constraint_jacobian(self.t, self.q, self.v)

    def derivative(self, function: Callable[[Any], Any], x: Any) -> Any:
        """Jacobian of ``function`` at ``x``: automatic, or by differences for plain callables."""
        return self.dynamics.jacobian(function, x, order=2)


def kinematics(at: Point) -> Any:
    """(F1) as q' - v + g_q^T eta, (n,)."""
    rate = at.qdot - at.v
    return rate if at.eta is None else rate + at.dynamics.position_column(at.t, at.q, at.eta)


def kinematics_derivatives(at: Point) -> Blocks:
    """Derivatives of (F1), by quantity."""
    eye = at.dynamics.xp.eye(at.dynamics.structure.n)
    blocks = {"qdot": eye, "v": -eye}
    if at.eta is not None:
        blocks["q"] = at.derivative(lambda q: at.eta @ at.dynamics.constraint_jacobian(at.t, q), at.q)
        blocks["eta"] = at.constraint_jacobian.T
    return blocks


def force(at: Point) -> Any:
    """(F2) as M v' - F - Q - Qk, (n,) [N, N m]."""
    inertia = at.dynamics.mass_product(at.t, at.q, at.vdot)
    return at.dynamics.residual(at.t, at.q, at.v, inertia, at.lam, at.mu)


def force_derivatives(at: Point) -> Blocks:
    """Derivatives of (F2), by quantity."""
    dynamics, s = at.dynamics, at.dynamics.structure
    force_q, force_v = dynamics.force_jacobians(at.t, at.q, at.v)
    by_q, by_v = [_minus(force_q)], [_minus(force_v)]
    blocks: Blocks = {"vdot": dynamics.mass(at.t, at.q)}
    if s.mass == "variable":
        by_q.append(dynamics.mass_product_jacobian(at.t, at.q, at.vdot))
    if s.m:
        reaction_q, reaction_v, reaction_lam = dynamics.reaction_jacobians(at.t, at.q, at.v, at.lam)
        by_q.append(_minus(reaction_q))
        by_v.append(_minus(reaction_v))
        blocks["lam"] = -reaction_lam
    if s.p:
        reaction_v, reaction_mu = dynamics.velocity_reaction_jacobians(at.t, at.q, at.v, at.mu)
        by_q.append(-at.derivative(lambda q: dynamics.velocity_reaction(at.t, q, at.v, at.mu), at.q))
        by_v.append(_minus(reaction_v))
        blocks["mu"] = -reaction_mu
    return blocks | {"q": _sum(by_q), "v": _sum(by_v)}


def position(at: Point) -> Any:
    """(F3), the position constraints g (m,)."""
    return at.dynamics.constraint(at.t, at.q)


def position_derivatives(at: Point) -> Blocks:
    """Derivatives of (F3), by quantity."""
    return {"q": at.constraint_jacobian}


def velocity(at: Point) -> Any:
    """(F4), the velocity level g_t + g_q v (m,)."""
    return at.dynamics.constraint_velocity(at.t, at.q, at.v)


def velocity_derivatives(at: Point) -> Blocks:
    """Derivatives of (F4), by quantity."""
    return {"q": at.dynamics.constraint_velocity_jacobian(at.t, at.q, at.v), "v": at.constraint_jacobian}


def acceleration(at: Point) -> Any:
    """(F5), the acceleration level g_q v' + c (m,)."""
    dynamics = at.dynamics
    return dynamics.position_row(at.t, at.q, at.vdot) + dynamics.constraint_acceleration(at.t, at.q, at.v)


def acceleration_derivatives(at: Point) -> Blocks:
    """Derivatives of (F5); dc/dv = 2 (g_tq + g_qq v) is twice the derivative of (F4) by q."""
    dynamics = at.dynamics

    def along(q: Any) -> Any:
        return dynamics.constraint_jacobian(at.t, q) @ at.vdot + dynamics.constraint_acceleration(at.t, q, at.v)

    by_v = 2.0 * dynamics.constraint_velocity_jacobian(at.t, at.q, at.v)
    return {"q": at.derivative(along, at.q), "v": by_v, "vdot": at.constraint_jacobian}


def velocity_constraint(at: Point) -> Any:
    """(F6), the velocity constraints k (p,)."""
    return at.dynamics.velocity_constraint(at.t, at.q, at.v)


def velocity_constraint_derivatives(at: Point) -> Blocks:
    """Derivatives of (F6), by quantity."""
    by_q = at.dynamics.velocity_constraint_position_jacobian(at.t, at.q, at.v)
    return {"q": by_q, "v": at.velocity_constraint_jacobian}


def velocity_constraint_rate(at: Point) -> Any:
    """(F7), the differentiated velocity constraints k_v v' + d (p,)."""
    along = at.dynamics.velocity_row(at.t, at.q, at.v, at.vdot)
    return along + at.dynamics.velocity_constraint_acceleration(at.t, at.q, at.v)


def velocity_constraint_rate_derivatives(at: Point) -> Blocks:
    """Derivatives of (F7), by quantity."""
    dynamics = at.dynamics

    def rate(q: Any, v: Any) -> Any:
        along = dynamics.velocity_constraint_jacobian(at.t, q, v) @ at.vdot
        return along + dynamics.velocity_constraint_acceleration(at.t, q, v)

    by_q = at.derivative(lambda q: rate(q, at.v), at.q)
    by_v = at.derivative(lambda v: rate(at.q, v), at.v)
    return {"q": by_q, "v": by_v, "vdot": at.velocity_constraint_jacobian}


class Row(NamedTuple):
    """Value and derivatives of one block of equations."""

    value: Callable[[Point], Any]
    derivatives: Callable[[Point], Blocks]


ROWS = {
    "kinematics": Row(kinematics, kinematics_derivatives),
    "force": Row(force, force_derivatives),
    "position": Row(position, position_derivatives),
    "velocity": Row(velocity, velocity_derivatives),
    "acceleration": Row(acceleration, acceleration_derivatives),
    "velocity_constraint": Row(velocity_constraint, velocity_constraint_derivatives),
    "velocity_constraint_rate": Row(velocity_constraint_rate, velocity_constraint_rate_derivatives),
}


def _minus(block: Any) -> Any:
    return None if block is None else -block


def _sum(blocks: list[Any]) -> Any:
    """Sum of the blocks that are not None; None if all are."""
    present = [block for block in blocks if block is not None]
    return sum(present[1:], start=present[0]) if present else None
