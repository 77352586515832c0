"""The extended HHT-alpha method; THEORY.md beside this file numbers every formula."""

from solvers.hht.solver import HHT, solver

__all__ = ["HHT", "solver"]
