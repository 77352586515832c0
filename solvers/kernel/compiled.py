"""Decorators of the kernel's loops, and the source files of every solver's compiled loops."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from hhtbench.lowering.compile.loops import Shipped, entries, inner
from solvers.kernel import numbers

HERE = Path(__file__).parent
KERNEL = (
    *(HERE / f"{name}.py" for name in ("memory", "sections", "intrinsics", "numbers", "compiled")),
    *(HERE / f"{name}.py" for name in ("entries", "acceleration", "projection", "linear/band", "linear/matrix")),
)
called = entries(HERE / "compiled", *KERNEL)  #: decorator of the loops' entry points
compiled = inner()
inlined = inner(inline="always")


@lru_cache
def shipped(name: str) -> Shipped:
    """The compiled function ``name`` of the kernel, loaded without importing its source."""
    return Shipped(name, HERE / "compiled", KERNEL)


spacing = compiled(numbers.spacing)
