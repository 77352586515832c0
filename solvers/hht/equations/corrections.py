"""One step of the compiled loops as pure array functions of the state before it.

The loops keep the state as one vector; the state after the step follows from it in straight lines, in the same order.
Systems so small that their inverse matrix pays are given whole corrections: a product with an inverse of some ten rows takes
less time than two triangles and the loops around them.
"""

from __future__ import annotations

from typing import Any

from hhtbench.lowering import Dynamics
from hhtbench.lowering.compile.inverse import inverse
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.discretise import unpack_matrix
from solvers.hht.equations.known import Layout
from solvers.hht.equations.methods import equations_of

SMALL = 12  #: unknowns up to which that is so


def state_size(layout: Layout) -> int:
    """Length of what :func:`state_after` returns."""
    s = layout.structure
    return (7 if s.m else 5) * s.n + s.m + s.p


def residual_of(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """The residual of the method's equations alone, (size,)."""
    return equations_of(method).residual_and_ends(dynamics, method, layout, x, given)[: layout.size]


def residual_and_end(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """:func:`residual_of` (size,), then :func:`state_after`."""
    residual = residual_of(dynamics, method, layout, x, given)
    return dynamics.xp.concatenate([residual, state_after(dynamics, method, layout, x, given)])


def state_after(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any) -> Any:
    """q, v, a, f, lam, mu, (v1 - v0)/h at the end of the step; with position constraints R0, R1 too."""
    return equations_of(method).state_after(dynamics, method, layout, x, given)


def fresh_correction(
    dynamics: Dynamics, method: Method, layout: Layout, entries: tuple[int, ...], x: Any, given: Any
) -> Any:
    """A correction with the matrix at the iterate ``x`` (size,), and what a lagged matrix needs, (H14).

    ``entries`` are the flat places of dq1/dx over dv1/dx (2n, size) that can differ from zero.

    Returns
    -------
    array (2*size + 2 + size*size + entries + 1,)
        :func:`_sized`; the inverse matrix, column by column; the entries; the largest magnitude of all that went in.
    """
    xp = dynamics.xp
    residual, blocks = unpack_matrix(layout, equations_of(method).residual_and_matrix(dynamics, method, layout, x, given))
    inverted, maps = inverse(blocks[: layout.size]), blocks[layout.size :]
    own = maps.ravel()[xp.asarray(entries)]
    largest = xp.maximum(xp.abs(residual).max(keepdims=True), xp.abs(blocks).max(keepdims=True).ravel())
    return xp.concatenate([_sized(dynamics, layout, inverted, residual, maps), inverted.T.ravel(), own, largest])


def lagged_correction_and_end(
    dynamics: Dynamics, method: Method, layout: Layout, entries: tuple[int, ...], x: Any, inverted: Any, own: Any, given: Any
) -> Any:
    """A correction with the matrix of an earlier :func:`fresh_correction`, :func:`_sized`, then :func:`state_after`."""
    xp, size = dynamics.xp, layout.size
    residual = residual_of(dynamics, method, layout, x, given)
    flat = xp.zeros(2 * layout.structure.n * size).at[xp.asarray(entries)].set(own)
    sized = _sized(dynamics, layout, inverted.reshape(size, size).T, residual, flat.reshape(-1, size))
    return xp.concatenate([sized, state_after(dynamics, method, layout, x, given)])


def _sized(dynamics: Dynamics, layout: Layout, inverted: Any, residual: Any, maps: Any) -> Any:
    """The correction (size,), the largest changes of q1 and of v1 that it makes, NaN if there is one, and the residual."""
    xp, n, correction = dynamics.xp, layout.structure.n, inverted @ residual
    moved = xp.abs(maps @ correction)
    return xp.concatenate([correction, moved[:n].max(keepdims=True), moved[n:].max(keepdims=True), residual])
