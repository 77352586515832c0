"""The decorators of the loops' functions, and the formulas that they share with the Python around them."""

from __future__ import annotations

from pathlib import Path

from hhtbench.lowering.compile.loops import entries, inner
from solvers.hht.equations import formulas

HERE = Path(__file__).parents[1]
SOURCES = (
    HERE / "loops",
    *(HERE / "linear" / f"{name}.py" for name in ("band", "matrix")),
    *(HERE / "step" / f"{name}.py" for name in ("stopping", "newton", "acceleration", "entries", "projection", "attempt")),
    *(HERE / "control" / f"{name}.py" for name in ("estimate", "controller", "first_step")),
    *(HERE / f"{name}.py" for name in ("events/scan", "run/march", "run/interpolate")),
    Path(formulas.__file__),
)
called = entries(HERE / "compiled", *SOURCES)  #: what Python calls
compiled = inner()
inlined = inner(inline="always")

allowed = compiled(formulas.allowed)
crosses = compiled(formulas.crosses)
cubic = compiled(formulas.cubic)
fit = compiled(formulas.fit)
growth = compiled(formulas.growth)
relative_part = compiled(formulas.relative_part)
relative_tolerance = compiled(formulas.relative_tolerance)
representable = compiled(formulas.representable)
rescaled = compiled(formulas.rescaled)
roundoff_of = compiled(formulas.roundoff_of)
spacing = compiled(formulas.spacing)
tells_multipliers = compiled(formulas.tells_multipliers)
third_difference = compiled(formulas.third_difference)
trapezoidal_start = compiled(formulas.trapezoidal_start)
