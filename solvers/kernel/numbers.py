"""Constants and scalar formulas shared by Python and all compiled loops."""

from __future__ import annotations

import numpy as np

EPS = float(np.finfo(np.float64).eps)
TINY = float(np.finfo(np.float64).tiny)
FULL_RANK = 16.0  # pivots below so many roundoffs of the largest do not count as rank


def spacing(x: float) -> float:
    """Distance from ``x`` >= 0 to the next larger floating-point number."""
    return max((x + 0.75 * EPS * x) - x, TINY)
