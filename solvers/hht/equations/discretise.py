"""One step of the extended HHT-alpha method for (H1) as pure array functions, formulas (H4) to (H14) of THEORY.md.

Backend-neutral: the functions use operators and the array namespace ``dynamics.xp`` only, so that every engine traces
or calls the same lines.  Nothing here branches on a value, only on what a system declares (:class:`Layout`).

The step and the state before it travel in one vector, everything unknown in another.  The unknowns are accelerations and
multipliers, not positions: the Newton matrix then stays bounded as h goes to 0.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import nullcontext
from functools import reduce
from operator import add
from typing import Any, NamedTuple

import jax
import numpy as np

from hhtbench.lowering import Dynamics, Structure
from hhtbench.lowering.dynamics.mixed import Predicted, mixed
from solvers.hht.equations.applied import applied_force, applied_jacobians, whole
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.known import Layout, known_values, start_of


class Stages(NamedTuple):
    """The end of a step and its reactions, as functions of the unknowns."""

    q1: Any  #: (n,)
    v1: Any  #: (n,)
    end: Any  #: (n,) q at which the end reaction is evaluated, or None without position constraints
    end_velocity: Any  #: (n,) v at which it is evaluated, or None if no reaction depends on v
    start_reaction: Any  #: (n,) R0, or None
    end_reaction: Any  #: (n,) R1, or None


def stages(dynamics: Dynamics, layout: Layout, unknown: Mapping[str, Any], known: Mapping[str, Any]) -> Stages:
    """q1 and v1 from accelerations and reactions, (H4) and (H5)."""
    h, s = known["h"], layout.structure
    q1 = known["q_known"] + known["q_a"] * unknown["a"]  # (H4)
    v1 = known["v_known"] + known["v_a"] * unknown["a"]  # (H5)
    end = start_reaction = end_reaction = None
    if s.p:
        q1 = q1 + 0.5 * h * h * unknown["Rk"]  # (H10)
        v1 = v1 + h * unknown["Rk"]  # (H10)
    if s.m:
        start_reaction = unknown["R0"] if layout.start_unknown else _start_reaction(dynamics, unknown["lam0"], known)
        q1 = q1 + known["q_R0"] * start_reaction
        v1 = v1 + known["v_R0"] * start_reaction
        end = known["q_stage"]  # (H8)
        if layout.end_unknown or not layout.moving:
            end_reaction = unknown["R1"] if layout.end_unknown else _end_reaction(dynamics, end, unknown["lam1"], known)
            q1 = q1 + known["q_R1"] * end_reaction
        if layout.moving:
            end = end + known["theta"] * q1  # (H8)
        if end_reaction is None:
            end_reaction = _end_reaction(dynamics, end, unknown["lam1"], known)
        v1 = v1 + known["v_R1"] * end_reaction
    end_velocity = known["v_stage"] + known["theta_v"] * v1 if s.reaction_uses_v else None  # (H50)
    return Stages(q1, v1, end, end_velocity, start_reaction, end_reaction)


def layout(structure: Structure, method: Method) -> Layout:
    """The unknowns of ``method``'s steps."""
    moving = method.reaction in ("implicit", "midpoint")
    unknown = structure.mass == "sparse" or (moving and (method.coefficients.b != 0.0 or structure.mass == "variable"))
    extrapolated = method.extrapolated and structure.m > 0
    return Layout(structure, moving, unknown or structure.reaction_uses_v, extrapolated=extrapolated)  # (H50)


def step_residual_and_ends(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """Residual, q1 and v1, (size + 2n,), for sparse differentiation, (H14).

    The residual is the imbalance of forces and of the constraint levels at the end of one step, (H6), (H7), (H13).  Force
    rows are multiplied by the inverse mass at the start of the step, the position rows by ``2 / h**2`` and the velocity
    rows by ``1 / h``: all rows are accelerations and stay of similar size as h shrinks.
    """
    unknown, known = layout.split(x), known_values(dynamics, method, layout, given)
    place = stages(dynamics, layout, unknown, known)
    return dynamics.xp.concatenate([*_rows(dynamics, layout, unknown, known, place), place.q1, place.v1])


def step_residual_and_matrix(dynamics: Dynamics, method: Method, layout: Layout, x: Any, previous: Any, given: Any) -> Any:
    """:func:`residual_and_matrix` with known values computed from the state in ``given``, and tensions as in (H61)."""
    with _mixed(dynamics, method, layout, x, previous, given):
        return residual_and_matrix(dynamics, layout, x, known_values(dynamics, method, layout, given))


def step_to_differentiate(dynamics: Dynamics, method: Method, layout: Layout, x: Any, previous: Any, given: Any) -> Any:
    """:func:`step_residual_and_ends`, whose derivative by ``x`` takes tensions as in (H61)."""
    with _mixed(dynamics, method, layout, x, previous, given):
        return step_residual_and_ends(dynamics, method, layout, x, given)


def _mixed(dynamics: Dynamics, method: Method, layout: Layout, x: Any, previous: Any, given: Any) -> Any:
    """Context in which derivatives of forces take tensions predicted from the ``previous`` iterate, (H61).

    ``previous``: 1, then that iterate (size,); or 0, then anything: the tensions are those before the step.
    """
    if not layout.structure.force_uses_q or dynamics.xp is np:
        return nullcontext()
    x, previous = jax.lax.stop_gradient((x, previous))
    known, xp = known_values(dynamics, method, layout, given), dynamics.xp
    last, now = (stages(dynamics, layout, layout.split(iterate), known) for iterate in (previous[1:], x))
    before, seen = start_of(layout, given, xp), previous[0] > 0.0
    q, v = xp.where(seen, last.q1, before["q"]), xp.where(seen, last.v1, before["v"])
    changes = (xp.where(seen, end - first, 0.0) for end, first in ((now.q1, last.q1), (now.v1, last.v1)))
    return mixed(dynamics, Predicted(xp.where(seen, known["t1"], before["t"]), q, v, *changes))


def state_after(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """q, v, a, f, lam, mu, (v1 - v0)/h at the end of the step, then R0, R1 with position constraints."""
    known, unknown = known_values(dynamics, method, layout, given), layout.split(x)
    place, before = stages(dynamics, layout, unknown, known), start_of(layout, given, dynamics.xp)
    parts = [place.q1, place.v1, unknown["a"], _rate(unknown, known) / known["end"]]  # (H6): no evaluation is needed
    parts += [whole(unknown, known, name) for name in ("lam1", "mu") if name in unknown]
    parts.append((place.v1 - before["v"]) / known["h"])
    if layout.structure.m:
        parts += [place.start_reaction, place.end_reaction]
    return dynamics.xp.concatenate(parts)


def _rate(unknown: Any, known: Any) -> Any:
    """(1 + alpha) f1 at the solution, (H6), (H45)."""
    return known["rate_a"] * unknown["a"] + known["rate_known"]


def _rows(dynamics: Dynamics, layout: Layout, unknown: Any, known: Any, place: Stages) -> list[Any]:
    s, h, t1 = layout.structure, known["h"], known["t1"]
    force = applied_force(dynamics, known, t1, place.q1, place.v1)
    balance = dynamics.mass_product(t1, place.q1, _rate(unknown, known)) - known["end"] * force  # (H6)
    rows = [scaled_rows(dynamics, known, balance)]
    if s.m and layout.start_unknown:
        inertia = dynamics.mass_product(known["t0"], known["q0"], unknown["R0"])
        reaction = dynamics.reaction(known["t0"], known["q0"], known["v0"], unknown["lam0"])
        rows.append(scaled_rows(dynamics, known, inertia - reaction))  # (H8)
    if s.m and layout.end_unknown:
        reaction = dynamics.reaction(known["t_stage"], place.end, place.end_velocity, unknown["lam1"])
        inertia = dynamics.mass_product(known["t_stage"], place.end, unknown["R1"])
        rows.append(scaled_rows(dynamics, known, inertia - reaction))  # (H8)
    if s.m:
        rows.append(dynamics.constraint(t1, place.q1) * (2.0 / (h * h)))  # (H7)
        rows.append(dynamics.constraint_velocity(t1, place.q1, place.v1) / h)  # (H7)
    if s.p:
        half = 0.5 * (known["v0"] + place.v1)
        reaction = dynamics.velocity_reaction(known["t_half"], known["q_half"], half, unknown["mu"])
        inertia = dynamics.mass_product(known["t_half"], known["q_half"], unknown["Rk"])
        rows.append(scaled_rows(dynamics, known, inertia - reaction))  # (H10)
        rows.append(dynamics.velocity_constraint(t1, place.q1, place.v1) / h)  # (H10)
    return rows


def residual_and_matrix(dynamics: Dynamics, layout: Layout, x: Any, known: Mapping[str, Any]) -> Any:
    """Residual, exact Newton matrix and the derivatives of q1 and v1 by the unknowns, (H14).

    Returns
    -------
    array (size + size*size + 2*n*size,)
        Residual, matrix, dq1/dx and dv1/dx, each in row-major order; unpack with :func:`unpack_matrix`.
    """
    xp, unknown = dynamics.xp, layout.split(x)
    place = stages(dynamics, layout, unknown, known)
    q_x, v_x = _end_derivatives(dynamics, layout, unknown, known, place)
    residual = xp.concatenate(_rows(dynamics, layout, unknown, known, place))
    matrix = xp.concatenate(_matrix_rows(dynamics, layout, unknown, known, place, q_x, v_x), axis=0)
    return xp.concatenate([residual, matrix.ravel(), q_x.ravel(), v_x.ravel()])


def unpack_matrix(layout: Layout, packed: Any) -> tuple[Any, Any]:
    """Split the result of :func:`residual_and_matrix`: residual (size,), [matrix; dq1/dx; dv1/dx] (size + 2n, size)."""
    size = layout.size
    return packed[:size], packed[size:].reshape(-1, size)


def _matrix_rows(
    dynamics: Dynamics, layout: Layout, unknown: Any, known: Any, place: Stages, q_x: Any, v_x: Any
) -> list[Any]:
    """Rows of Newton's matrix, (H14), by the chain rule through q1 and v1."""
    s, h, t1, end = layout.structure, known["h"], known["t1"], known["end"]
    by_q, by_v = applied_jacobians(dynamics, known, t1, place.q1, place.v1)
    by_q = None if by_q is None else -end * by_q
    by_v = None if by_v is None else -end * by_v
    if s.mass == "variable":
        mass_q = dynamics.mass_product_jacobian(t1, place.q1, _rate(unknown, known))
        by_q = mass_q if by_q is None else by_q + mass_q
    parts = [by @ by_x for by, by_x in ((by_q, q_x), (by_v, v_x)) if by is not None]
    row = accelerate(dynamics, known, reduce(add, parts) if parts else None)
    rows = [columns(dynamics, layout, row, a=known["rate_a"] * scaled_mass(dynamics, known, t1, place.q1))]
    if s.m and layout.end_unknown:
        rows.append(_end_reaction_row(dynamics, layout, unknown, known, place, q_x, v_x))
    if s.m:
        jacobian = dynamics.constraint_rows(t1, place.q1)
        velocity_q = dynamics.constraint_velocity_jacobian(t1, place.q1, place.v1)
        rows.append((2.0 / (h * h)) * (jacobian @ q_x))
        rows.append((velocity_q @ q_x + jacobian @ v_x) / h)
    if s.p:
        rows += _velocity_constraint_rows(dynamics, layout, unknown, known, place, q_x, v_x)
    return rows


def _end_reaction_row(
    dynamics: Dynamics, layout: Layout, unknown: Any, known: Any, place: Stages, q_x: Any, v_x: Any
) -> Any:
    t, at = known["t_stage"], (place.end, place.end_velocity, unknown["lam1"])
    reaction_q, reaction_v, reaction_lam = dynamics.reaction_jacobians(t, *at)
    by_q = -reaction_q
    if layout.structure.mass == "variable":
        by_q = by_q + dynamics.mass_product_jacobian(t, place.end, unknown["R1"])
    row = known["theta"] * (by_q @ q_x) if layout.moving else None
    if reaction_v is not None:
        by_v = -known["theta_v"] * (reaction_v @ v_x)  # (H50)
        row = by_v if row is None else row + by_v
    scaled, own = accelerate(dynamics, known, row), scaled_mass(dynamics, known, t, place.end)
    return columns(dynamics, layout, scaled, R1=own, lam1=-accelerate(dynamics, known, reaction_lam))


def _velocity_constraint_rows(
    dynamics: Dynamics, layout: Layout, unknown: Any, known: Any, place: Stages, q_x: Any, v_x: Any
) -> list[Any]:
    t, q, half = known["t_half"], known["q_half"], 0.5 * (known["v0"] + place.v1)
    by_v, by_mu = dynamics.velocity_reaction_jacobians(t, q, half, unknown["mu"])
    row = None if by_v is None else accelerate(dynamics, known, -0.5 * (by_v @ v_x))
    own = scaled_mass(dynamics, known, t, q)
    reaction = columns(dynamics, layout, row, Rk=own, mu=-accelerate(dynamics, known, by_mu))
    k_q = dynamics.velocity_constraint_position_jacobian(known["t1"], place.q1, place.v1)
    k_v = dynamics.velocity_constraint_rows(known["t1"], place.q1, place.v1)
    return [reaction, (k_q @ q_x + k_v @ v_x) / known["h"]]


def _end_derivatives(dynamics: Dynamics, layout: Layout, unknown: Any, known: Any, place: Stages) -> tuple[Any, Any]:
    """dq1/dx and dv1/dx, (n, size) each, of (H4), (H5)."""
    s, h = layout.structure, known["h"]
    eye = dynamics.xp.eye(s.n)
    q_blocks, v_blocks = {"a": known["q_a"] * eye}, {"a": known["v_a"] * eye}
    if s.p:
        q_blocks["Rk"], v_blocks["Rk"] = 0.5 * h * h * eye, h * eye
    if s.m:
        at_start = dynamics.reaction_columns(known["t0"], known["q0"], known["v0"], unknown["lam0"])
        at_start = accelerate(dynamics, known, at_start)
        q_blocks["lam0"], v_blocks["lam0"] = known["q_R0"] * at_start, known["v_R0"] * at_start
    if s.m and layout.end_unknown:
        q_blocks["R1"], v_blocks["R1"] = known["q_R1"] * eye, known["v_R1"] * eye
    elif s.m:
        by_q, _, by_lam = dynamics.reaction_jacobians(known["t_stage"], place.end, None, unknown["lam1"])
        at_end = accelerate(dynamics, known, by_lam, "inverse_mass_stage")
        v_blocks["lam1"] = known["v_R1"] * at_end
        if layout.moving:
            q_x = columns(dynamics, layout, None, **q_blocks)
            moved = accelerate(dynamics, known, by_q, "inverse_mass_stage") @ q_x
            return q_x, columns(dynamics, layout, known["v_R1"] * known["theta"] * moved, **v_blocks)
        q_blocks["lam1"] = known["q_R1"] * at_end
    return columns(dynamics, layout, None, **q_blocks), columns(dynamics, layout, None, **v_blocks)


def columns(dynamics: Dynamics, layout: Layout, row: Any, **blocks: Any) -> Any:
    """Rows of a matrix: ``row`` (rows, size) or None for zero, plus the ``blocks`` in the columns of their unknowns."""
    height = next(iter(blocks.values())).shape[0]
    zeros = dynamics.xp.zeros
    direct = [blocks.get(name, zeros((height, size))) for name, size in layout.unknowns.items()]
    placed = dynamics.xp.concatenate(direct, axis=1)
    return placed if row is None else row + placed


def _start_reaction(dynamics: Dynamics, lam: Any, known: Any) -> Any:
    return accelerate(dynamics, known, dynamics.reaction(known["t0"], known["q0"], known["v0"], lam))  # (H8)


def _end_reaction(dynamics: Dynamics, q: Any, lam: Any, known: Any) -> Any:
    reaction = dynamics.reaction(known["t_stage"], q, None, lam)  # one that has v is an unknown
    return accelerate(dynamics, known, reaction, "inverse_mass_stage")  # (H8)


def accelerate(dynamics: Dynamics, known: Any, x: Any, name: str = "inverse_mass") -> Any:
    """M^-1 x, (H13), by the inverse mass ``known[name]`` or a constant one, (H2).  None stays None."""
    inverse = known.get(name)
    if inverse is None:
        inverse = dynamics.inverse_mass
    return x if x is None or inverse is None else inverse @ x


def scaled_rows(dynamics: Dynamics, known: Any, x: Any) -> Any:
    """Force rows ``x`` (n,) [N] as accelerations, (H13): M^-1 x, or x over the diagonal of M where M^-1 is full."""
    return x / known["mass_diagonal"] if dynamics.structure.mass == "sparse" else accelerate(dynamics, known, x)


def scaled_mass(dynamics: Dynamics, known: Any, t: Any, q: Any) -> Any:
    """M^-1 M(t, q) (n, n), with M^-1 of the step's start as in :func:`accelerate`."""
    s = dynamics.structure
    return accelerate(dynamics, known, dynamics.mass(t, q)) if s.mass == "variable" else dynamics.xp.eye(s.n)
