"""The decorators of the kernel's loops, and the files that every solver's compiled loops are made from."""

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
called = entries(HERE / "compiled", *KERNEL)  #: what Python calls
compiled = inner()
inlined = inner(inline="always")


@lru_cache
def shipped(name: str) -> Shipped:
    """The compiled function ``name`` of the kernel, without its source, which only Python and Numba need."""
    return Shipped(name, HERE / "compiled", KERNEL)


spacing = compiled(numbers.spacing)
