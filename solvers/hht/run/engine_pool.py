"""The engine pool: what was prepared for a system serves its next solve, whichever HHT object asks."""

from __future__ import annotations

import threading
from typing import Any

from hhtbench.lowering.caching import by_id
from hhtbench.lowering.dynamics.derive import parameters_of
from hhtbench.protocol.system import NumpySystem, System
from solvers.hht.options import HHTOptions
from solvers.hht.run.engine import Engine

MAX_ENGINES = 16  # in the pool: the oldest goes first
MAX_BYTES = 64 * 2**20  # of their memory; those in use are not counted

_pool: list[tuple[Any, Engine]] = []  # few, and compared from the newest on: to hash a purpose takes longer
_lock = threading.Lock()


def purpose_of(system: System | NumpySystem, options: HHTOptions, n: int, *, controlled: bool) -> Any:
    """What an engine for ``system`` with ``n`` coordinates depends on; parameters that their owner may change by bytes."""
    return by_id(system), parameters_of(system), n, controlled, options


def take(purpose: Any) -> Engine | None:
    """An engine made for the same purpose, which now is the caller's alone."""
    with _lock:
        for i in reversed(range(len(_pool))):
            if _pool[i][0] == purpose:
                return _pool.pop(i)[1]
    return None


def put_back(purpose: Any, engine: Engine) -> None:
    """A run with ``engine`` is over."""
    if not engine.reusable:
        return
    with _lock:
        _pool.append((purpose, engine))
        while len(_pool) > MAX_ENGINES or sum(kept.nbytes for _, kept in _pool) > MAX_BYTES:
            del _pool[0]
