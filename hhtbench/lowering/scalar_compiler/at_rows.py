"""Machine code of ``f(t, q, v)`` at many rows in one call from Python."""

from __future__ import annotations

import ctypes
import struct
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.compiler import Native
from hhtbench.lowering.scalar_compiler.machine import generate, host, load
from hhtbench.runtime.disk_cache import kept_on_disk

ENTRY = "hhtbench_at_rows"
# The loop does not depend on the function: it finds its address, and those of the arrays with their strides, in a block.
WORDS = ("function", "parameters", "count", "out", "out_stride", "t", "t_stride", "q", "q_stride", "v", "v_stride")
_CALL, _PACK = ctypes.PYFUNCTYPE(None, ctypes.c_char_p), struct.Struct(f"{len(WORDS)}q").pack
POINTERS = "function", "parameters", "out", "t", "q", "v"


def at_rows(native: Native) -> Callable[[Any, Any, Any], Any]:
    """Callable that evaluates ``native`` at rows t (k,), q and v (k, n); returns (k, size).

    The rows are arrays of float64; those of q and v may be views of longer ones.
    """
    loop, size = _CALL(_loop()), native.size
    function, parameters = native.pair

    def call(t: Any, q: Any, v: Any, _kept: Any = native) -> Any:
        count = len(t)
        out = np.empty((count, size))
        words = [function, parameters, count]
        for array in (out, t, q, v):
            words += array.__array_interface__["data"][0], array.strides[0]
        loop(_PACK(*words))
        return out

    return call


@cache
def _loop() -> int:
    """The address of the loop over rows."""
    text = _assembly()
    code = kept_on_disk(f"{host()}\0{text}".encode(), "code", lambda: generate(text, "", 0))
    return load(code, ENTRY)[0]


def _assembly() -> str:
    lines = [f"define void @{ENTRY}(ptr %block) nounwind {{", "start:"]
    for i, name in enumerate(WORDS):
        kind = "ptr" if name in POINTERS else "i64"
        lines += [f"  %at.{name} = getelementptr i64, ptr %block, i64 {i}", f"  %{name} = load {kind}, ptr %at.{name}"]
    lines += ["  %any = icmp sgt i64 %count, 0", "  br i1 %any, label %row, label %end", "row:"]
    lines.append("  %i = phi i64 [ 0, %start ], [ %next, %row ]")
    for name in ("out", "t", "q", "v"):
        lines.append(f"  %{name}.offset = mul i64 %i, %{name}_stride")
        lines.append(f"  %{name}.row = getelementptr i8, ptr %{name}, i64 %{name}.offset")
    lines += [
        "  call void %function(ptr %out.row, ptr %parameters, ptr %t.row, ptr %q.row, ptr %v.row)",
        "  %next = add i64 %i, 1",
        "  %more = icmp slt i64 %next, %count",
        "  br i1 %more, label %row, label %end",
        "end:",
        "  ret void",
        "}",
    ]
    return "\n".join(lines)
