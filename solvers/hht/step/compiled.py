"""The decorators of the loops' functions, and the formulas that they share with the Python around them."""

from __future__ import annotations

from pathlib import Path

from hhtbench.lowering.loops import entries, inner
from solvers.hht import laws

HERE = Path(__file__).parents[1]
SOURCES = (
    HERE / "step",
    *(HERE / f"{name}.py" for name in ("linear/band", "linear/matrix", "control/estimate", "control/controller")),
    *(HERE / f"{name}.py" for name in ("events/scan", "run/march", "run/recover")),
    Path(laws.__file__),
)
called = entries(HERE / "compiled", *SOURCES)  #: what Python calls
compiled = inner()
inlined = inner(inline="always")

allowed = compiled(laws.allowed)
crosses = compiled(laws.crosses)
cubic = compiled(laws.cubic)
digits = compiled(laws.digits)
fit = compiled(laws.fit)
growth = compiled(laws.growth)
has_digit = compiled(laws.has_digit)
moves_nothing = compiled(laws.moves_nothing)
relative_part = compiled(laws.relative_part)
relative_tolerance = compiled(laws.relative_tolerance)
representable = compiled(laws.representable)
rescaled = compiled(laws.rescaled)
trapezoidal_start = compiled(laws.trapezoidal_start)
