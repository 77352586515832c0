"""Functions that the compiled loops call in a step: residual, Newton corrections, and the state after the step.

The loops keep the state as one vector, in the order of :func:`state_after`.  Small systems get whole corrections from an
explicit inverse: its product takes less time than two triangular solves in loops for some ten rows.
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

CONSTRAINED = "lam0", "lam1", "mu"  #: unknowns whose positions in the residual hold the constraint rows
SMALL = 12  #: unknowns up to which the explicit inverse is used


def state_size(layout: Layout) -> int:
    """Length of the vector that :func:`state_after` returns."""
    s = layout.structure
    return (7 if s.m else 5) * s.n + s.m + s.p


def residual_of(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """Residual of the method's equations, (size,)."""
    return equations_of(method).residual_and_ends(dynamics, method, layout, x, given)[: layout.size]


def residual_and_end(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """:func:`residual_of` (size,), its constraint rows alone (size,), then :func:`state_after`."""
    residual = residual_of(dynamics, method, layout, x, given)
    rows = of_constraints(layout, residual, dynamics.xp)
    return dynamics.xp.concatenate([residual, rows, state_after(dynamics, method, layout, x, given)])


def constraint_residual(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """The step's residual with only its constraint rows, (size,), for (H35)."""
    return of_constraints(layout, residual_of(dynamics, method, layout, x, given), dynamics.xp)


def of_constraints(layout: Layout, residual: Any, xp: Any) -> Any:
    """``residual`` (size,) with zeros in the rows of forces and reactions, for (H35)."""
    rows = layout.split(residual)
    return xp.concatenate([rows[name] if name in CONSTRAINED else xp.zeros(size) for name, size in layout.unknowns.items()])


def residual_and_entries(
    dynamics: Dynamics, method: Method, layout: Layout, pattern: Pattern, x: Any, previous: Any, given: Any
) -> Any:
    """Residual (size,), then the entries of [matrix; dq1/dx; dv1/dx] in ``pattern``, (H14)."""
    packed = by_pattern(dynamics, pattern, equations_of(method).to_differentiate, (method, layout), x, previous, given)
    return dynamics.xp.concatenate([packed[: layout.size], packed[pattern.shape[0] :]])


def state_after(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """q, v, a, f, lam, mu, (v1 - v0)/h at the end of the step, then R0, R1 with position constraints."""
    return equations_of(method).state_after(dynamics, method, layout, x, given)


def fresh_correction(
    dynamics: Dynamics, method: Method, layout: Layout, entries: tuple[int, ...], x: Any, previous: Any, given: Any
) -> Any:
    """Newton correction with the matrix at the iterate ``x`` (size,), and the data to reuse this matrix, (H14).

    ``entries``: flat indices of dq1/dx over dv1/dx (2n, size) that can differ from zero.

    Returns
    -------
    array (size + 2 + size*size + entries + 1,)
        :func:`_sized`; the inverse matrix, column by column; the entries; the largest magnitude of all inputs.
    """
    xp = dynamics.xp
    packed = equations_of(method).residual_and_matrix(dynamics, method, layout, x, previous, given)
    residual, blocks = unpack_matrix(layout, packed)
    inverted, maps = inverse(blocks[: layout.size]), blocks[layout.size :]
    own = maps.ravel()[xp.asarray(entries)]
    largest = xp.maximum(xp.abs(residual).max(keepdims=True), xp.abs(blocks).max(keepdims=True).ravel())
    return xp.concatenate([_sized(dynamics, layout, inverted @ residual, maps), inverted.T.ravel(), own, largest])


def stored_correction_and_end(
    dynamics: Dynamics, method: Method, layout: Layout, entries: tuple[int, ...], x: Any, inverted: Any, own: Any, given: Any
) -> Any:
    """Newton corrections with the matrix of an earlier :func:`fresh_correction`, and the state after the step.

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
    """The correction (size,) followed by its largest changes of q1 and of v1; NaN if any is."""
    xp, n = dynamics.xp, layout.structure.n
    moved = xp.abs(maps @ correction)
    return xp.concatenate([correction, moved[:n].max(keepdims=True), moved[n:].max(keepdims=True)])
