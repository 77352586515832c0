"""Loops whose sources a fault has changed run as the plain Python of these sources.

The object code beside them was compiled before; that it says so would find every fault in them, and is no find.  Compiled
loops and plain Python give the same bits (``tests/hht``), so a fault shows in both alike.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from hhtbench.lowering.compile.loops import MANIFEST, Entry, content_of

STALE = "have changed since they were compiled"  # what a loop says whose object code is not of its sources
_compiled = Entry.following


def follow_the_sources() -> None:
    """Let every loop of this process be what its sources say."""
    Entry.following = _following  # type: ignore[method-assign]


def _following(self: Entry, *first: Any) -> Callable[..., int]:
    if _is_compiled(self):
        return _compiled(self, *first)

    def call(*rest: Any) -> int:
        with np.errstate(all="ignore"):  # as quietly as compiled code
            return int(self.function(*first, *rest) or 0)

    return call


@cache
def _is_compiled(entry: Entry) -> bool:
    """Whether its object code was made from its sources."""
    return bool(json.loads((entry.folder / MANIFEST).read_text())["content"] == content_of(entry.sources))
