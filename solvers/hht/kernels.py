"""Band LU and its solves, block after block, in compiled loops.

LAPACK's ``dgbtrs`` spends 40 ns a column on calls of BLAS for the three numbers that a chain has below its diagonal;
these loops take a third of it, and a whole solve with its couplings is one call.  Algorithms of ``dgbtf2`` and ``dgbtrs``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hhtbench.lowering.compile.loops import FloatArray, IntArray, ShortArray, entries, inner
from solvers.hht import laws

HERE = Path(__file__).parent
called = entries(HERE / "compiled", HERE / "native", Path(laws.__file__), Path(__file__))  #: what Python calls
compiled = inner()


@called
def factor_blocks(values: FloatArray, places: IntArray, storage: FloatArray, pivots: IntArray, blocks: IntArray) -> int:
    """LU with partial pivoting of every block in ``storage``, filled from ``values`` (entries,) at ``places`` first.

    ``blocks`` (4 k,): first column, columns before the next block, lower and upper diagonals; a block's columns follow one
    another in ``storage``, each with ``2 lower + upper + 1`` numbers.  Returns 0, or the place of a zero pivot, from 1.
    """
    for k in range(places.size):
        storage[places[k]] = values[k]
    return factor_filled(storage, pivots, blocks)


@compiled
def factor_filled(storage: Any, pivots: Any, blocks: Any) -> int:
    """The same of a ``storage`` that holds the entries already."""
    offset = 0
    for k in range(0, blocks.size, 4):
        start, count, lower, upper = blocks[k], blocks[k + 1], blocks[k + 2], blocks[k + 3]
        height, main = 2 * lower + upper + 1, lower + upper
        reach = 0
        for j in range(count):
            column = offset + j * height + main
            below = min(lower, count - 1 - j)
            pivot, largest = 0, abs(storage[column])
            for i in range(1, below + 1):
                if abs(storage[column + i]) > largest:
                    pivot, largest = i, abs(storage[column + i])
            pivots[start + j] = pivot
            if not largest > 0.0:
                return start + j + 1
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
    return 0


@called
def solve_blocks(
    right: FloatArray,
    rows: IntArray,
    columns: IntArray,
    storage: FloatArray,
    pivots: IntArray,
    blocks: IntArray,
    starts: IntArray,
    places: IntArray,
    couplings: FloatArray,
    y: FloatArray,
    x: FloatArray,
) -> None:
    """Solve with the factors of :func:`factor_blocks`, block after block, into ``x`` (size,), with ``y`` to work in.

    Place i holds row ``rows[i]`` and column ``columns[i]`` of the matrix.  ``starts``, ``places``, ``couplings``: sparse
    rows of what a block takes from unknowns of earlier blocks.
    """
    solve_into(right, rows, columns, storage, pivots, blocks, starts, places, couplings, y, x)


@compiled
def solve_into(
    right: Any,
    rows: Any,
    columns: Any,
    storage: Any,
    pivots: Any,
    blocks: Any,
    starts: Any,
    places: Any,
    couplings: Any,
    y: Any,
    x: Any,
) -> None:
    """The same into ``x`` (size,), with ``y`` (size,) to work in."""
    offset = 0
    for k in range(0, blocks.size, 4):
        start, count, lower, upper = blocks[k], blocks[k + 1], blocks[k + 2], blocks[k + 3]
        height, main = 2 * lower + upper + 1, lower + upper
        for i in range(start, start + count):
            value = right[rows[i]]
            for e in range(starts[i], starts[i + 1]):
                value -= couplings[e] * y[places[e]]
            y[i] = value
        for j in range(count):
            pivot, at = pivots[start + j], start + j
            if pivot:
                y[at], y[at + pivot] = y[at + pivot], y[at]
            value = y[at]
            column = offset + j * height + main
            for i in range(1, min(lower, count - 1 - j) + 1):
                y[at + i] -= value * storage[column + i]
        for j in range(count - 1, -1, -1):
            at, column = start + j, offset + j * height + main
            value = y[at] * storage[column]
            y[at] = value
            for i in range(1, min(main, j) + 1):
                y[at - i] -= value * storage[column - i]
        offset += count * height
    for i in range(right.size):
        x[columns[i]] = y[i]


@compiled
def solve_pair_into(
    right: Any,
    rows: Any,
    columns: Any,
    storage: Any,
    pivots: Any,
    blocks: Any,
    starts: Any,
    places: Any,
    couplings: Any,
    y: Any,
    x: Any,
) -> None:
    """:func:`solve_into` for two right-hand sides, entry beside entry (2 size,), in little more time than for one."""
    offset = 0
    for k in range(0, blocks.size, 4):
        start, count, lower, upper = blocks[k], blocks[k + 1], blocks[k + 2], blocks[k + 3]
        height, main = 2 * lower + upper + 1, lower + upper
        for i in range(start, start + count):
            first, second = right[2 * rows[i]], right[2 * rows[i] + 1]
            for e in range(starts[i], starts[i + 1]):
                first -= couplings[e] * y[2 * places[e]]
                second -= couplings[e] * y[2 * places[e] + 1]
            y[2 * i], y[2 * i + 1] = first, second
        for j in range(count):
            other, at = 2 * pivots[start + j], 2 * (start + j)
            if other:
                y[at], y[at + other] = y[at + other], y[at]
                y[at + 1], y[at + other + 1] = y[at + other + 1], y[at + 1]
            first, second, column = y[at], y[at + 1], offset + j * height + main
            for i in range(1, min(lower, count - 1 - j) + 1):
                y[at + 2 * i] -= first * storage[column + i]
                y[at + 2 * i + 1] -= second * storage[column + i]
        for j in range(count - 1, -1, -1):
            at, column = 2 * (start + j), offset + j * height + main
            first, second = y[at] * storage[column], y[at + 1] * storage[column]
            y[at], y[at + 1] = first, second
            for i in range(1, min(main, j) + 1):
                y[at - 2 * i] -= first * storage[column - i]
                y[at - 2 * i + 1] -= second * storage[column - i]
        offset += count * height
    for i in range(rows.size):
        x[2 * columns[i]], x[2 * columns[i] + 1] = y[2 * i], y[2 * i + 1]


@called
def largest_change(
    starts: ShortArray, columns: ShortArray, values: FloatArray, increment: FloatArray, n: int, found: FloatArray
) -> None:
    """Largest magnitudes among the first ``n`` rows of a sparse product and among the others, NaN if there is one.

    Into ``found`` (2,).
    """
    top, bottom = 0.0, 0.0
    for i in range(starts.size - 1):
        total = 0.0
        for e in range(starts[i], starts[i + 1]):
            total += values[e] * increment[columns[e]]
        size = abs(total)
        if i < n:
            if not size <= top:
                top = size
        elif not size <= bottom:
            bottom = size
        if size != size:
            top = bottom = size
            break
    found[0], found[1] = top, bottom
