"""Calls of machine code by its address, and parts of arrays, for compiled loops."""

from __future__ import annotations

from typing import Any

from hhtbench.lowering.compile.loops import Later

_INTRINSICS = "solvers.hht.native.intrinsics"
invoke: Any = Later(_INTRINSICS, "invoke")  #: (address, pointers) -> None
view: Any = Later(_INTRINSICS, "view")  #: (array of 8-byte entries, start, count) -> a part of it
spacing: Any = Later(_INTRINSICS, "spacing")  #: (x >= 0) -> distance to the next larger number
