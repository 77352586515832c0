"""The engine pool: an engine prepared for a system is reused by its next solve, by any HHT object."""

from __future__ import annotations

import threading
from typing import Any

from hhtbench.lowering.caching import by_id
from hhtbench.lowering.dynamics.derive import parameters_of
from hhtbench.protocol.system import NumpySystem, System
from solvers.hht.options import HHTOptions
from solvers.hht.run.engine import Engine

MAX_ENGINES = 16  # in the pool; the oldest is dropped first
MAX_BYTES = 64 * 2**20  # of the pool's memory; engines in use are not counted

_pool: list[tuple[Any, Engine]] = []  # few, and compared from the newest on: to hash a purpose takes longer
_lock = threading.Lock()


def purpose_of(system: System | NumpySystem, options: HHTOptions, n: int, *, controlled: bool) -> Any:
    """Key of an engine for ``system`` with ``n`` coordinates; mutable parameters enter by their bytes."""
    return by_id(system), parameters_of(system), n, controlled, options


def take(purpose: Any) -> Engine | None:
    """Take an engine with this key out of the pool, or None."""
    with _lock:
        for i in reversed(range(len(_pool))):
            if _pool[i][0] == purpose:
                return _pool.pop(i)[1]
    return None


def put_back(purpose: Any, engine: Engine) -> None:
    """Return ``engine`` to the pool after a run."""
    if not engine.reusable:
        return
    with _lock:
        _pool.append((purpose, engine))
        while len(_pool) > MAX_ENGINES or sum(kept.nbytes for _, kept in _pool) > MAX_BYTES:
            del _pool[0]
