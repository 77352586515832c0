"""Numbers and scalar formulas that all loops share: one source for Python and for compiled code."""

from __future__ import annotations

import numpy as np

EPS = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)
FULL_RANK = 16.0  # roundoffs of the largest pivot: smaller ones do not count as rank


def spacing(x: float) -> float:
    """Distance from ``x`` >= 0 to the next larger number: x and three quarters of its roundoff round to that."""
    return max((x + 0.75 * EPS * x) - x, TINY)
