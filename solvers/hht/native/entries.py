"""Which entries Newton's matrix and the maps below it have, where the loops keep them, and a factorisation's way there."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.lowering import Native
from hhtbench.lowering.compile.patterns import Pattern
from solvers.hht.blocks import Order, find_order
from solvers.hht.layout import Layout
from solvers.hht.linear import Factor, InverseFactor
from solvers.hht.native.tables import (
    BUILT,
    COUPLINGS,
    FACTOR_H,
    INVERSE_MATRIX,
    MAPS,
    PIVOTS,
    RATE,
    SMALL,
    STORAGE,
    USES,
    Memory,
    floats,
    integers,
)
from solvers.hht.sparse import Band, BandFactor, Couplings


class Entries:
    """Newton's matrix by the entries that its code computes: blocks of bands, whatever its size."""

    kind = "band"

    def __init__(self, matrix: Native, layout: Layout) -> None:
        size = layout.size
        computed = np.zeros(matrix.size, dtype=bool)
        computed[matrix.varying] = True
        flat = np.flatnonzero(computed | (matrix.constants != 0.0))
        flat = flat[flat >= size] - size  # entries of matrix and maps, row by row
        rows, columns = flat // size, flat % size
        shape = (size + 2 * layout.structure.n, size)
        self.pattern = Pattern(shape, rows, columns, np.zeros(size, dtype=np.int32), 1)
        self.own = int(np.searchsorted(rows, size))
        self.order: Order = find_order(rows[: self.own], columns[: self.own], size)
        self.reason = f"{self.own} entries; blocks of {self.order.text} diagonals after reverse Cuthill-McKee"
        self.band = Band(self.pattern, size, self.order, self.reason)
        self.flat, self.size = flat, size
        place = np.full(matrix.size, -1)
        place[:size] = np.arange(size)
        place[size + flat] = size + np.arange(flat.size)
        self.slots = place[matrix.varying].astype(np.int64)
        self.values = np.concatenate([matrix.constants[:size], matrix.constants[size + flat]])

    def factor(self, entries: Vector, h: float) -> Factor | None:
        """For the host engine: ``entries`` are [matrix; dq1/dx; dv1/dx] (size + 2n, size), row by row."""
        return self.band.factor(np.concatenate([np.zeros(self.band.maps.rows), entries[self.flat]]), h)

    @property
    def places(self) -> dict[str, Any]:
        """Sections of integers for the compiled loops."""
        band, own = self.band, self.own
        starts = np.searchsorted(self.pattern.rows[own:] - self.size, np.arange(band.maps.rows + 1))
        named = {"slots": self.slots, "inside": band.inside, "places": band.places, "outside": band.outside}
        named |= {"starts": band.starts, "coupled": band.coupled, "rows": self.order.rows, "columns": self.order.columns}
        return named | {"blocks": self.order.blocks, "map_starts": starts, "map_columns": self.pattern.columns[own:]}

    def load(self, factor: Factor | None, z: Memory) -> int | None:
        """Put a factorisation of this analysis into slot 0; None for one of another."""
        loaded = self._load_inverse(factor, z) if z.i[SMALL] else self._load_band(factor, z)
        if factor is None or not loaded:
            return None
        floats(z, FACTOR_H)[0], floats(z, RATE)[0] = factor.h, factor.rate
        floats(z, USES)[0], floats(z, BUILT)[:] = factor.uses, 0.0
        return 0

    def _load_inverse(self, factor: Factor | None, z: Memory) -> bool:
        """Of any kind: the next error is filtered by the matrix of the step before, whoever made that."""
        if factor is None or factor.maps.shape != (self.band.maps.rows, self.size):
            return False
        units = np.eye(self.size)
        inverse = factor.inverse if isinstance(factor, InverseFactor) else np.stack([factor.solve(u) for u in units], axis=1)
        full = factor.maps.toarray() if hasattr(factor.maps, "toarray") else np.asarray(factor.maps)
        maps = full[self.pattern.rows[self.own :] - self.size, self.pattern.columns[self.own :]]
        if not (np.isfinite(inverse).all() and np.isfinite(maps).all()):
            return False
        for name, values in ((INVERSE_MATRIX, inverse.T.ravel()), (MAPS, maps)):
            floats(z, name)[: values.size] = values
        return True

    def _load_band(self, factor: Factor | None, z: Memory) -> bool:
        if not isinstance(factor, BandFactor):
            return False
        theirs, ours = factor.order, self.order
        if not (np.array_equal(theirs.rows, ours.rows) and np.array_equal(theirs.blocks, ours.blocks)):
            return False
        for name, values in ((STORAGE, factor.storage), (COUPLINGS, factor.couplings.values), (MAPS, factor.maps.data)):
            floats(z, name)[: values.size] = values
        integers(z, PIVOTS)[: self.size] = factor.pivots
        return True

    def store(self, z: Memory, slot: int) -> Factor | None:
        """The factorisation in ``slot``."""
        if slot < 0:
            return None
        inverse, storage, couplings, maps = (
            np.split(floats(z, name), 2)[slot].copy() for name in (INVERSE_MATRIX, STORAGE, COUPLINGS, MAPS)
        )
        band = self.band
        known: dict[str, Any] = {
            "maps": band.maps.matrix(np.concatenate([np.zeros(self.own), maps])),
            "h": float(floats(z, FACTOR_H)[slot]),
            "rate": float(floats(z, RATE)[slot]),
            "uses": int(floats(z, USES)[slot]),
        }
        if z.i[SMALL]:
            return InverseFactor(inverse=inverse.reshape(self.size, -1).T, **known)
        return BandFactor(
            storage=storage,
            pivots=np.split(integers(z, PIVOTS), 2)[slot].copy(),
            order=self.order,
            couplings=Couplings(band.starts, band.coupled, couplings),
            **known,
        )
