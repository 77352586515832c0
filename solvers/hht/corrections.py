"""Newton's correction of one step as one pure array function, for systems so small that their inverse matrix pays.

A product with an inverse of some ten rows takes less time than two triangles and the loops around them; the compiled
engine writes it, the residual before it and the size of the correction behind it, as straight lines.
"""

from __future__ import annotations

from typing import Any

from hhtbench.lowering.inverse import inverse
from solvers.hht.discretise import step_residual, step_residual_and_matrix, unpack_matrix
from solvers.hht.layout import Layout

SMALL = 12  #: unknowns up to which that is so


def fresh_correction(dynamics: Any, layout: Layout, entries: tuple[int, ...], x: Any, packed: Any) -> Any:
    """A correction with the matrix at the iterate ``x`` (size,), and what is kept of that matrix, (H14).

    ``entries`` are the flat places of dq1/dx over dv1/dx (2n, size) that can differ from zero.

    Returns
    -------
    array (size + 2 + size*size + entries,)
        :func:`_sized`; the inverse matrix, column by column; the entries.
    """
    xp = dynamics.xp
    residual, blocks = unpack_matrix(layout, step_residual_and_matrix(dynamics, layout, x, packed))
    inverted, maps = inverse(blocks[: layout.size]), blocks[layout.size :]
    kept = maps.ravel()[xp.asarray(entries)]
    return xp.concatenate([_sized(dynamics, layout, inverted @ residual, maps), inverted.T.ravel(), kept])


def kept_correction(
    dynamics: Any, layout: Layout, entries: tuple[int, ...], x: Any, inverted: Any, kept: Any, packed: Any
) -> Any:
    """A correction with what :func:`fresh_correction` left of an earlier matrix: :func:`_sized`, (size + 2,)."""
    xp, size = dynamics.xp, layout.size
    residual = step_residual(dynamics, layout, x, packed)
    flat = xp.zeros(2 * layout.structure.n * size).at[xp.asarray(entries)].set(kept)
    return _sized(dynamics, layout, inverted.reshape(size, size).T @ residual, flat.reshape(-1, size))


def _sized(dynamics: Any, layout: Layout, correction: Any, maps: Any) -> Any:
    """The correction (size,), and the largest changes of q1 and of v1 that it makes; NaN if there is one."""
    xp, n = dynamics.xp, layout.structure.n
    moved = xp.abs(maps @ correction)
    return xp.concatenate([correction, moved[:n].max(keepdims=True), moved[n:].max(keepdims=True)])
