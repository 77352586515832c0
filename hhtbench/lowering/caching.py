"""Caches of values in memory."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from functools import partial
from types import MethodType
from typing import Any

same = partial(MethodType, id)  #: :func:`by_id` of a value that is not None


def by_id(value: Any) -> Hashable:
    """Wrap ``value`` for a key, so that it is compared by identity and stays alive with the key.

    A bound method: Python hashes and compares these by the identity of their object, without calling a function.
    """
    return None if value is None else same(value)


class Cache:
    """Thread-safe cache of at most ``size`` values by key; the oldest is dropped first."""

    def __init__(self, size: int) -> None:
        self._size = size
        self._values: dict[Hashable, Any] = {}
        self._lock = threading.Lock()

    def find(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """The value of ``key``, made by ``make()`` if missing, without the lock, as it may call the user's code."""
        with self._lock:
            if key in self._values:
                return self._values[key]
        made = make()
        with self._lock:
            while len(self._values) >= self._size:
                self._values.pop(next(iter(self._values)))
            return self._values.setdefault(key, made)

    def values(self) -> list[Any]:
        """All values in the cache."""
        with self._lock:
            return list(self._values.values())
