"""Counts the work of one solve and stops it at its budgets."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from hhtbench.errors import BudgetSpent
from hhtbench.result import Counters


@dataclass
class Work:
    """Tally of one solve.  The one mutable object of a solve; a solver reads it through :meth:`counters`.

    ``calls`` counts the callbacks of a NumPy system by name; a JAX system has none to count, its compiled
    functions state how many points they evaluate.
    """

    max_evaluations: int | None = None
    max_seconds: float | None = None  #: [s]
    started: float = field(default_factory=time.perf_counter)
    tally: Counter[str] = field(default_factory=Counter)
    calls: Counter[str] = field(default_factory=Counter)

    def add(self, name: str, amount: int = 1) -> None:
        """Raise the counter ``name`` of :class:`~hhtbench.result.Counters`."""
        self.tally[name] += amount

    def on_call(self, name: str) -> None:
        """Before a callback of a NumPy system: count it, and stop when a budget is spent."""
        self.calls[name] += 1
        if name == "force":
            self._spend_residual()

    def counted(self, function: Callable[..., Any], *, residuals: int = 0, jacobians: int = 0) -> Callable[..., Any]:
        """``function`` with its points counted: ``residuals`` evaluations of F and ``jacobians`` per call."""

        def call(*arguments: Any) -> Any:
            for _ in range(residuals):
                self._spend_residual()
            self.tally["jacobian_evaluations"] += jacobians
            return function(*arguments)

        return call

    def check_time(self) -> None:
        """Raise :class:`BudgetSpent` when the time budget is used up."""
        if self.max_seconds is not None and time.perf_counter() - self.started > self.max_seconds:
            raise BudgetSpent("seconds", self.max_seconds)

    def lift_budgets(self) -> None:
        """Go on counting without limits: what is left is to hand over what was computed."""
        self.max_evaluations = self.max_seconds = None

    def counters(self) -> Counters:
        """The tally, frozen."""
        counted: dict[str, Any] = dict(self.tally)
        return Counters(**counted)

    def _spend_residual(self) -> None:
        if self.max_evaluations is not None and self.tally["residual_evaluations"] >= self.max_evaluations:
            raise BudgetSpent("evaluations", self.max_evaluations)
        self.check_time()
        self.tally["residual_evaluations"] += 1
