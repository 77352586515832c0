"""The KKT system of the acceleration level by the entries of its matrix, (H16), in bands where these pay."""

from __future__ import annotations

from typing import Any

from solvers.kernel import memory as mem
from solvers.kernel.compiled import compiled
from solvers.kernel.linear.matrix import factor, solve
from solvers.kernel.sections import address, call, finite, indices, part


@compiled
def by_entries(z: Any) -> Any:
    """True if the memory is laid out for the entries of the KKT matrix."""
    return indices(z, mem.ENTRY_ROWS).size > 0


@compiled
def compute_entries(z: Any) -> None:
    """Evaluate residual and matrix at PLACE and the unknowns [v', lam, mu] in X, into COMPUTED."""
    at = address(z, mem.PLACE)
    call(z, mem.C_MATRIX, mem.COMPUTED, (at, at + 8, at + 8 + 8 * z.i[mem.N], address(z, mem.X)))


@compiled
def add_row_sizes(z: Any, typical: Any) -> None:
    """Add the sums of magnitudes of each row of [g_q; k_v] times ``typical`` sizes (n,) to ROW_SIZES."""
    n, size, rows, columns = z.i[mem.N], z.i[mem.SIZE], indices(z, mem.ENTRY_ROWS), indices(z, mem.ENTRY_COLUMNS)
    computed, targets, sizes = part(z, mem.COMPUTED), indices(z, mem.TARGETS), part(z, mem.ROW_SIZES)
    for k in range(rows.size):
        if rows[k] >= n and columns[k] < n:
            sizes[rows[k] - n] += abs(computed[targets[size + k]]) * typical[columns[k]]


@compiled
def factor_entries(z: Any, first: Any) -> Any:
    """Factorise the matrix in COMPUTED with columns and rows scaled; False if it is singular, or not finite.

    Only its ``first`` rows and columns are used; the others are replaced by those of the identity.
    """
    terms, computed, targets, size = part(z, mem.VALUES), part(z, mem.COMPUTED), indices(z, mem.TARGETS), z.i[mem.SIZE]
    of_column = part(z, mem.RIGHT)
    entries, rows, columns = terms[size:], indices(z, mem.ENTRY_ROWS), indices(z, mem.ENTRY_COLUMNS)
    for k in range(targets.size):
        terms[k] = computed[targets[k]]
    for k in range(rows.size):
        if max(rows[k], columns[k]) >= first:
            entries[k] = 1.0 if rows[k] == columns[k] else 0.0
        elif rows[k] == columns[k] >= z.i[mem.N]:
            entries[k] = 0.0  # there for the identity only
    if not finite(terms):
        return False
    scale_columns(entries, columns, of_column)
    for i in range(size):
        if of_column[i] == 0.0:
            return False
    return factor(z, 0, entries) == mem.CONVERGED and part(z, mem.RECORD)[mem.RANK] >= size


@compiled
def solve_entries(z: Any) -> Any:
    """Solve for the residual in COMPUTED with these factors, into INCREMENT; True if it is finite."""
    increment, of_column, size = part(z, mem.INCREMENT), part(z, mem.RIGHT), z.i[mem.SIZE]
    solve(z, 0, part(z, mem.COMPUTED)[:size], increment)
    for j in range(size):
        increment[j] /= of_column[j]
    return finite(increment[:size])


@compiled
def scale_columns(entries: Any, columns: Any, largest_of: Any) -> None:
    """Divide ``entries`` by the largest magnitude of their column, which is stored in ``largest_of``."""
    for i in range(largest_of.size):
        largest_of[i] = 0.0
    for k in range(entries.size):
        largest_of[columns[k]] = max(largest_of[columns[k]], abs(entries[k]))
    for k in range(entries.size):
        if entries[k] != 0.0:
            entries[k] /= largest_of[columns[k]]
