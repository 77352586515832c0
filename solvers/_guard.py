"""Guarded callbacks for foreign libraries: count work, copy arrays, keep exceptions and values that are not finite."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector, all_finite
from hhtbench.protocol.errors import NonFiniteValue, Stop
from hhtbench.solution.counting import Work
from hhtbench.solution.result import Counters, Status

OF_LIBRARY = ("steps_rejected_error", "steps_rejected_newton", "newton_iterations", "factorisations", "linear_solves")


@dataclass
class LibraryWork(Work):
    """Work counters of one solve by a library."""

    library: dict[str, int] = field(default_factory=dict)  #: counts reported by the library itself
    unseen: list[str] = field(default_factory=list)  #: names of counts unknown, as compiled code does the work

    def counters(self) -> Counters:
        """The work so far; None for counts that nobody reports."""
        jacobians = self.output["jacobian_evaluations"]
        values: dict[str, Any] = dict.fromkeys(OF_LIBRARY) | self.counted_for_steps() | self.library
        values |= dict.fromkeys(self.unseen)
        more = f"; library: {', '.join(self.library)}" if self.library else ""
        more += f"; {jacobians} Jacobians for output rows left out" if jacobians else ""
        return Counters(**values, provenance=f"counted{more}; None: not reported")


class Halt(Stop):
    """Ends the integration with a status; the caller of ``solve`` never sees it."""

    def __init__(self, status: Status, message: str) -> None:
        self.status = status
        super().__init__(message)


class Guard:
    """Wraps the callbacks of one solve.

    An exception in a callback is kept, and raised again unchanged after the library has returned.  Values that are not
    finite are passed to the library, since most shrink their step then; the function that returned them is named if the
    library fails.
    """

    def __init__(self, work: Work, t_span: tuple[float, float]) -> None:
        self.work, self.t_span = work, t_span
        self.cause: BaseException | None = None  #: exception raised in a callback
        self.nonfinite: Any = None  #: first value of this step that is not finite: the error, or (t, y)
        self._nonfinite_before: Any = None  # that of the step before, since Radau fails one step late

    def time(self, t: float) -> float:
        """The problem's time [s] at ``t`` of the library's clock, which starts at 0."""
        t0, t1 = self.t_span
        return t1 if t == t1 - t0 else t0 + t

    def wrap(self, function: Callable[..., Any], shape: tuple[int, ...], **points: int) -> Callable[..., Any]:
        """Wrap ``function``: library's time converted, calls counted, arrays copied, as libraries reuse and free theirs."""
        counted = self.work.counted(function, **points)

        def call(t: float, y: Any, *more: Any) -> Any:
            t, y = self.time(float(t)), np.array(y)
            try:
                try:
                    value = np.array(counted(t, y, *(np.array(x) for x in more)))
                except NonFiniteValue as error:
                    value = np.full(shape, np.nan)
                    self._note_nonfinite(y, error)
                else:
                    if not all_finite(value):
                        self._note_nonfinite(y, (t, y))
            except BaseException as error:
                self.cause = error
                raise
            return value

        return call

    def step_taken(self) -> None:
        """Note an accepted step: earlier values that were not finite matter only if the next step fails."""
        self.nonfinite, self._nonfinite_before = None, self.nonfinite

    @property
    def blamed(self) -> Any:
        """The value to blame for a failure, or None."""
        return self._nonfinite_before if self.nonfinite is None else self.nonfinite

    def _note_nonfinite(self, y: Vector, where: Any) -> None:
        if np.isfinite(y).all():  # else the library passes on what it was given before
            self.work.add("nonfinite_evaluations")
            self.nonfinite = where if self.nonfinite is None else self.nonfinite
