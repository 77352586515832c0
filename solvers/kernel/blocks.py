"""Many rows of output in several calls of the loops, between which budgets and the user's interrupt count."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

FEW = 20  # rows below which their multipliers are found one by one, where no code is there for them
FIRST = 512  # rows of the first call, and FEW of a NumPy system
SLOW = 0.05  # [s] of one call, at most: budgets and the user's interrupt are checked between


def in_blocks(count: int, block: int, work_on: Callable[[slice], Any], going: Callable[[], bool]) -> None:
    """``work_on`` all of ``count`` rows, ``block`` of them first, then in longer blocks, while it is ``going`` on."""
    first = 0
    while first < count and going():
        began = time.perf_counter()
        work_on(slice(first, first + block))
        first, block = first + block, 2 * block if time.perf_counter() - began < SLOW / 4 else block
