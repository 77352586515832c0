"""Events: what a user declares, sign changes in a step, the step that ends at one."""

from solvers.hht.events.event import Event

__all__ = ["Event"]
