"""Events: their declaration, sign changes within a step, and the step that ends at one."""

from solvers.hht.events.event import Event

__all__ = ["Event"]
