"""The decorators of the kernel's loops, and the files that every solver's compiled loops are made from."""

from __future__ import annotations

from pathlib import Path

from hhtbench.lowering.compile.loops import entries, inner
from solvers.kernel import numbers

HERE = Path(__file__).parent
KERNEL = (
    *(HERE / f"{name}.py" for name in ("memory", "sections", "intrinsics", "numbers", "compiled")),
    *(HERE / f"{name}.py" for name in ("entries", "acceleration", "projection", "linear/band", "linear/matrix")),
)
called = entries(HERE / "compiled", *KERNEL)  #: what Python calls
compiled = inner()
inlined = inner(inline="always")

spacing = compiled(numbers.spacing)
