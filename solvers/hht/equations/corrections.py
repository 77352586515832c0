"""One step of the compiled loops as pure array functions of the state before it.

The loops keep the state as one vector; the state after the step follows from it in straight lines, in the same order.
Systems so small that their inverse matrix pays are given whole corrections: a product with an inverse of some ten rows takes
less time than two triangles and the loops around them.
"""

from __future__ import annotations

from typing import Any

from hhtbench.lowering import Dynamics
from hhtbench.lowering.compile.coloured import Pattern, by_pattern
from hhtbench.lowering.compile.inverse import inverse
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.discretise import unpack_matrix
from solvers.hht.equations.known import Layout
from solvers.hht.equations.methods import equations_of

CONSTRAINED = "lam0", "lam1", "mu"  #: unknowns in whose places the rows of constraints stand
SMALL = 12  #: unknowns up to which that is so


def state_size(layout: Layout) -> int:
    """Length of what :func:`state_after` returns."""
    s = layout.structure
    return (7 if s.m else 5) * s.n + s.m + s.p


def residual_of(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """The residual of the method's equations alone, (size,)."""
    return equations_of(method).residual_and_ends(dynamics, method, layout, x, given)[: layout.size]


def residual_and_end(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """:func:`residual_of` (size,), its constraint rows alone (size,), then :func:`state_after`."""
    residual = residual_of(dynamics, method, layout, x, given)
    rows = of_constraints(layout, residual, dynamics.xp)
    return dynamics.xp.concatenate([residual, rows, state_after(dynamics, method, layout, x, given)])


def constraint_residual(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """:func:`of_constraints` of the step's residual."""
    return of_constraints(layout, residual_of(dynamics, method, layout, x, given), dynamics.xp)


def of_constraints(layout: Layout, residual: Any, xp: Any) -> Any:
    """``residual`` (size,) with zeros in the rows of forces and reactions, as (H35) takes it."""
    rows = layout.split(residual)
    return xp.concatenate([rows[name] if name in CONSTRAINED else xp.zeros(size) for name, size in layout.unknowns.items()])


def residual_and_entries(dynamics: Dynamics, method: Method, layout: Layout, pattern: Pattern, x: Any, given: Any) -> Any:
    """The residual (size,), then the entries of [matrix; dq1/dx; dv1/dx] in ``pattern``, (H14)."""
    packed = by_pattern(dynamics, pattern, equations_of(method).residual_and_ends, (method, layout), x, given)
    return dynamics.xp.concatenate([packed[: layout.size], packed[pattern.shape[0] :]])


def state_after(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """q, v, a, f, lam, mu, (v1 - v0)/h at the end of the step; with position constraints R0, R1 too."""
    return equations_of(method).state_after(dynamics, method, layout, x, given)


def fresh_correction(
    dynamics: Dynamics, method: Method, layout: Layout, entries: tuple[int, ...], x: Any, given: Any
) -> Any:
    """A correction with the matrix at the iterate ``x`` (size,), and what a stored matrix needs, (H14).

    ``entries`` are the flat places of dq1/dx over dv1/dx (2n, size) that can differ from zero.

    Returns
    -------
    array (size + 2 + size*size + entries + 1,)
        :func:`_sized`; the inverse matrix, column by column; the entries; the largest magnitude of all that went in.
    """
    xp = dynamics.xp
    residual, blocks = unpack_matrix(layout, equations_of(method).residual_and_matrix(dynamics, method, layout, x, given))
    inverted, maps = inverse(blocks[: layout.size]), blocks[layout.size :]
    own = maps.ravel()[xp.asarray(entries)]
    largest = xp.maximum(xp.abs(residual).max(keepdims=True), xp.abs(blocks).max(keepdims=True).ravel())
    return xp.concatenate([_sized(dynamics, layout, inverted @ residual, maps), inverted.T.ravel(), own, largest])


def stored_correction_and_end(
    dynamics: Dynamics, method: Method, layout: Layout, entries: tuple[int, ...], x: Any, inverted: Any, own: Any, given: Any
) -> Any:
    """Corrections with the matrix of an earlier :func:`fresh_correction`, and the state after the step.

    Returns
    -------
    array (3*size + 4 + state,)
        :func:`_sized` and the residual; :func:`_sized` of its constraint rows alone; :func:`state_after`.
    """
    xp, size = dynamics.xp, layout.size
    flat = xp.zeros(2 * layout.structure.n * size).at[xp.asarray(entries)].set(own)
    matrices = inverted.reshape(size, size).T, flat.reshape(-1, size)
    residual = residual_of(dynamics, method, layout, x, given)
    of_all = _sized(dynamics, layout, matrices[0] @ residual, matrices[1])
    alone = _sized(dynamics, layout, matrices[0] @ of_constraints(layout, residual, xp), matrices[1])
    return xp.concatenate([of_all, residual, alone, state_after(dynamics, method, layout, x, given)])


def _sized(dynamics: Dynamics, layout: Layout, correction: Any, maps: Any) -> Any:
    """The correction (size,), and the largest changes of q1 and of v1 that it makes; NaN if there is one."""
    xp, n = dynamics.xp, layout.structure.n
    moved = xp.abs(maps @ correction)
    return xp.concatenate([correction, moved[:n].max(keepdims=True), moved[n:].max(keepdims=True)])
