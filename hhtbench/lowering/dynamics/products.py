"""Choice between full matrices and products; plain callables always use full matrices."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hhtbench.lowering.dynamics.dynamics import Dynamics

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.matrix_free import MatrixFree

FULL = 32  # unknowns n + m + p up to which formulas of full matrices are the fastest
LARGE = 400  # unknowns n + m + p of the acceleration level from which the start works with sparse matrices too


def matrix_free(dynamics: Dynamics) -> MatrixFree | None:
    """``dynamics`` without dense matrices; None for NumPy systems, and where the mass fills or is singular."""
    if dynamics.xp is np:
        return None
    from hhtbench.lowering.dynamics.matrix_free import products_of

    return products_of(dynamics)


def large(dynamics: Dynamics) -> MatrixFree | None:
    """``dynamics`` without dense matrices where it is large enough for it, else None."""
    s = dynamics.structure
    return matrix_free(dynamics) if s.n + s.m + s.p > LARGE else None


def is_larger(dynamics: Dynamics) -> bool:
    """True if a JAX system is too large for full matrices to be fastest."""
    s = dynamics.structure
    return dynamics.xp is not np and s.n + s.m + s.p > FULL


def paying_products(dynamics: Dynamics) -> MatrixFree | None:
    """``dynamics`` without full matrices if that is possible and faster, else None."""
    return matrix_free(dynamics) if is_larger(dynamics) else None
