"""Engines that no run uses: what was prepared for a system serves its next solve, whichever HHT object asks."""

from __future__ import annotations

import threading
from collections.abc import Hashable

from hhtbench.lowering.caching import ById
from hhtbench.lowering.dynamics.derive import parameters_of
from hhtbench.protocol import NumpySystem, System
from solvers.hht.options import HHTOptions
from solvers.hht.run.engine import Engine

MOST = 16  # engines that are kept: the oldest goes first

_idle: dict[Hashable, Engine] = {}
_lock = threading.Lock()


def purpose_of(system: System | NumpySystem, options: HHTOptions, n: int, *, controlled: bool) -> Hashable:
    """What an engine for ``system`` with ``n`` coordinates depends on; parameters that their owner may change by bytes."""
    return ById(system), parameters_of(system), n, options, controlled


def take(purpose: Hashable) -> Engine | None:
    """An engine made for the same purpose, which now is the caller's alone."""
    with _lock:
        return _idle.pop(purpose, None)


def put_back(purpose: Hashable, engine: Engine) -> None:
    """A run with ``engine`` is over."""
    if not engine.reusable:
        return
    with _lock:
        while len(_idle) >= MOST:
            del _idle[next(iter(_idle))]
        _idle[purpose] = engine
