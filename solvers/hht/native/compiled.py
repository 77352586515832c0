"""The decorator of the compiled loops, and the laws that they share with the host engine."""

from __future__ import annotations

from hhtbench.lowering.compile.loops import inner
from solvers.hht import laws
from solvers.hht.kernels import compiled

inlined = inner(inline="always")

allowed = compiled(laws.allowed)
cubic = compiled(laws.cubic)
digits = compiled(laws.digits)
fit = compiled(laws.fit)
force_at_end = compiled(laws.force_at_end)
growth = compiled(laws.growth)
has_digit = compiled(laws.has_digit)
moves_nothing = compiled(laws.moves_nothing)
relative_part = compiled(laws.relative_part)
relative_tolerance = compiled(laws.relative_tolerance)
rescaled = compiled(laws.rescaled)
representable = compiled(laws.representable)
trapezoidal_start = compiled(laws.trapezoidal_start)
