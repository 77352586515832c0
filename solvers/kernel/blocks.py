"""Split work on many output rows into blocks, between which budgets and the user's interrupt are checked."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

FEW = 20  # rows from which compiling code to recover multipliers pays
FIRST = 512  # rows of the first call; of a NumPy system FEW
MAX_CALL_TIME = 0.05  # [s] of one call: budgets and the user's interrupt are checked between calls


def in_blocks(count: int, block: int, work_on: Callable[[slice], Any], going: Callable[[], bool]) -> None:
    """Call ``work_on`` for slices of ``count`` rows, ``block`` rows first, then more, while ``going()``."""
    first = 0
    while first < count and going():
        began = time.perf_counter()
        work_on(slice(first, first + block))
        first, block = first + block, 2 * block if time.perf_counter() - began < MAX_CALL_TIME / 4 else block
