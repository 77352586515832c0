"""Loops whose sources a fault has changed run as the plain Python of these sources.

The object code beside them was compiled before; that it says so would find every fault in them, and is no find.  Compiled
loops and plain Python give the same bits (``tests/hht``), so a fault shows in both alike.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from importlib import import_module
from typing import Any

import numpy as np

from hhtbench.lowering.compile.loops import ENTRIES, MANIFEST, Shipped, content_of

STALE = "have changed since they were compiled"  # what a loop says whose object code is not of its sources
KERNEL = ("solvers.kernel.acceleration", "solvers.kernel.projection")  # sources of functions that are called without them
_compiled = Shipped.following


def follow_the_sources() -> None:
    """Let every loop of this process be what its sources say."""
    Shipped.following = _following  # type: ignore[method-assign]


def _following(self: Shipped, *first: Any) -> Callable[..., int]:
    if _is_compiled(self):
        return _compiled(self, *first)
    function = _source_of(self)

    def call(*rest: Any) -> int:
        with np.errstate(all="ignore"):  # as quietly as compiled code
            return int(function(*first, *rest) or 0)

    return call


def _source_of(entry: Shipped) -> Callable[..., Any]:
    """The function that its object code was made from."""
    for name in KERNEL:
        import_module(name)
    names = entry.folder, entry.__name__
    return next(known.function for known in ENTRIES if (known.folder, known.__name__) == names)


@cache
def _is_compiled(entry: Shipped) -> bool:
    """Whether its object code was made from its sources."""
    return bool(json.loads((entry.folder / MANIFEST).read_text())["content"] == content_of(entry.sources))
