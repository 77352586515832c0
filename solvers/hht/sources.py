"""Source files of HHT's compiled loops, and compiled versions of the formulas shared with Python."""

from __future__ import annotations

from pathlib import Path

from hhtbench.lowering.compile.loops import entries
from solvers.hht.equations import formulas
from solvers.kernel.compiled import KERNEL, compiled

HERE = Path(__file__).parent
SOURCES = (
    *KERNEL,
    *(HERE / "step" / f"{name}.py" for name in ("stopping", "newton", "attempt")),
    *(HERE / "control" / f"{name}.py" for name in ("estimate", "controller", "first_step")),
    *(HERE / f"{name}.py" for name in ("events/scan", "run/march", "run/interpolate")),
    Path(formulas.__file__),
)
called = entries(HERE / "compiled", *SOURCES)  #: decorator of the loops' entry points

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
smooth_rise = compiled(formulas.smooth_rise)
tells_multipliers = compiled(formulas.tells_multipliers)
third_difference = compiled(formulas.third_difference)
trapezoidal_start = compiled(formulas.trapezoidal_start)
