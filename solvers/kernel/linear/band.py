"""LU factorisation of narrow bands, one for each block of a block triangular matrix, and solves.

LAPACK's ``dgbtrs`` spends 40 ns a column on calls of BLAS for the three numbers that a chain has below its diagonal;
these loops take a third of it, and a solve with all couplings is one call.  Algorithms of ``dgbtf2`` and ``dgbtrs``.
"""

from __future__ import annotations

import math
from typing import Any

from solvers.kernel import memory as mem
from solvers.kernel.compiled import compiled
from solvers.kernel.sections import indices, part


@compiled
def factor_blocks(storage: Any, pivots: Any, blocks: Any) -> Any:
    """LU with partial pivoting of every block in ``storage``; returns the least and largest pivot, zeros at a zero pivot.

    ``blocks`` (4 k,): first column, number of columns, lower and upper diagonals; a block's columns are consecutive in
    ``storage``, each with ``2 lower + upper + 1`` numbers.
    """
    offset, least, most = 0, math.inf, 0.0
    for k in range(0, blocks.size, 4):
        start, count, lower, upper = blocks[k], blocks[k + 1], blocks[k + 2], blocks[k + 3]
        height, main = 2 * lower + upper + 1, lower + upper
        reach = 0
        for j in range(count):
            column = offset + j * height + main
            below = min(lower, count - 1 - j)
            pivot, size = 0, abs(storage[column])
            for i in range(1, below + 1):
                if abs(storage[column + i]) > size:
                    pivot, size = i, abs(storage[column + i])
            pivots[start + j] = pivot
            if not size > 0.0:
                return 0.0, 0.0
            least, most = min(least, size), max(most, size)
            reach = max(reach, min(j + upper + pivot, count - 1))
            if pivot:
                for c in range(j, reach + 1):
                    at = offset + c * height + main + j - c
                    storage[at], storage[at + pivot] = storage[at + pivot], storage[at]
            inverse = 1.0 / storage[column]
            storage[column] = inverse  # solves multiply: a division takes as long as ten products
            for i in range(1, below + 1):
                storage[column + i] *= inverse
            for c in range(j + 1, reach + 1):
                at = offset + c * height + main + j - c
                factor = storage[at]
                if factor != 0.0:
                    for i in range(1, below + 1):
                        storage[at + i] -= factor * storage[column + i]
        offset += count * height
    return least, most


@compiled
def count_pivots(storage: Any, blocks: Any, bound: Any) -> Any:
    """Number of pivots of :func:`factor_blocks` larger than ``bound``."""
    offset, count = 0, 0
    for k in range(0, blocks.size, 4):
        height, main = 2 * blocks[k + 2] + blocks[k + 3] + 1, blocks[k + 2] + blocks[k + 3]
        for j in range(blocks[k + 1]):
            count += 1 if bound * abs(storage[offset + j * height + main]) < 1.0 else 0  # inverses are stored
        offset += blocks[k + 1] * height
    return count


@compiled
def solve_blocks(z: Any, lu: Any, right: Any, y: Any, x: Any) -> None:
    """Solve with the factors of :func:`factor_blocks`, block after block, into ``x``; ``y`` is work space.

    Position i holds the scaled row ``rows[i]`` and column ``columns[i]`` of the matrix.  ``starts``, ``places``,
    ``couplings``: sparse rows of the coupling to unknowns of earlier blocks.
    """
    rows, columns, blocks = indices(z, mem.ROWS), indices(z, mem.COLUMNS), indices(z, mem.BLOCKS)
    starts, places, couplings = indices(z, mem.STARTS), indices(z, mem.COUPLED), part(z, mem.COUPLINGS + lu)
    storage, pivots, scales = part(z, mem.STORAGE + lu), indices(z, mem.PIVOTS + lu), part(z, mem.ROW_SCALES + lu)
    offset = 0
    for k in range(0, blocks.size, 4):
        start, count, lower, upper = blocks[k], blocks[k + 1], blocks[k + 2], blocks[k + 3]
        height = 2 * lower + upper + 1
        for i in range(start, start + count):
            value = scales[rows[i]] * right[rows[i]]
            for e in range(starts[i], starts[i + 1]):
                value -= couplings[e] * y[places[e]]
            y[i] = value
        if lower + upper == 0:  # a diagonal, whose inverse is kept
            for i in range(count):
                y[start + i] *= storage[offset + i]
        else:
            substitute(storage[offset : offset + count * height], pivots[start : start + count], lower, upper, y[start:])
        offset += count * height
    for i in range(rows.size):
        x[columns[i]] = y[i]


@compiled
def substitute(storage: Any, pivots: Any, lower: Any, upper: Any, y: Any) -> None:
    """Solve with the factors of one block, overwriting its right-hand side in the first entries of ``y``."""
    count, height, main, moved = pivots.size, 2 * lower + upper + 1, lower + upper, 0
    carried = y[0]  # the next entry is kept in a register: storing and loading takes as long as the product
    for j in range(count):
        column, pivot, first = j * height + main, pivots[j], carried
        moved = max(moved, pivot)
        if pivot:
            first, y[j + pivot] = y[j + pivot], first
        below = min(lower, count - 1 - j)
        if below:
            carried = y[j + 1] - first * storage[column + 1]
        elif j + 1 < count:
            carried = y[j + 1]
        for i in range(2, below + 1):
            y[j + i] -= first * storage[column + i]
        y[j] = first
    carried = y[count - 1]
    for j in range(count - 1, -1, -1):
        column = j * height + main
        first = carried * storage[column]
        above = min(upper + moved, j)  # as far as exchanged rows reach
        if above:
            carried = y[j - 1] - first * storage[column - 1]
        elif j:
            carried = y[j - 1]
        for i in range(2, above + 1):
            y[j - i] -= first * storage[column - i]
        y[j] = first
