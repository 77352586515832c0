"""Exceptions of the public face and the signals that pass inside a solve.

Wrong use raises :class:`ProblemError` (or ``TypeError``) before any integration.  Numerical failures are
never exceptions for the caller: they end in a :class:`~hhtbench.Status`.  The signals below
(:class:`Stop` and its children) travel from a counted callback to the solver's loop and no further.
"""

from __future__ import annotations

from collections.abc import Iterable
from difflib import get_close_matches

from hhtbench.protocol.printing import exact


class ProblemError(ValueError):
    """Wrong input; the text says what was expected, what came and what to do."""


class NotFoundError(ProblemError, LookupError):
    """A problem, solver or verification of that name does not exist; the text names the closest."""


class Stop(Exception):
    """Base of the signals that end or repeat a step; never seen by the caller of ``solve``."""


class NonFiniteValue(Stop):
    """A function of the system returned NaN or infinity."""

    def __init__(self, function: str, component: tuple[int, ...], value: float, t: float, note: str = "") -> None:
        self.function = function
        self.component = component
        self.value = value
        self.t = t
        place = f"{function}{list(component)}" if component else function
        super().__init__(f"{place} = {value} at t = {exact(t)}{note}")


class BudgetSpent(Stop):
    """Signal that the budget of residual evaluations or of seconds is used up."""

    def __init__(self, budget: str, limit: float, note: str = "") -> None:
        self.budget = budget  #: "evaluations" or "seconds"
        self.limit = limit
        super().__init__(f"the budget of {limit:g} {budget} is used up{note}")


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the hint " Did you mean ...?" with the closest of ``known``; empty string if none is close."""
    names = list(known)
    close = [other for other in names if other.lower() == name.lower()] or get_close_matches(name, names, n=1)
    return f" Did you mean {close[0]}?" if close else ""
