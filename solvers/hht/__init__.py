"""The extended HHT-alpha method; THEORY.md beside this file numbers every formula."""

from solvers.hht.adapter import solver
from solvers.hht.options import HHTOptions
from solvers.hht.solver import HHT

__all__ = ["HHT", "HHTOptions", "solver"]
