"""Events for every solver, found between the ends of its steps; HHT and the solvers of its loop have their own."""

from solvers.eventful.solver import WithEvents

__all__ = ["WithEvents"]
