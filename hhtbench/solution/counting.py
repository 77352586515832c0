"""Count the evaluations of one solve and stop it at its budgets of evaluations and seconds."""

from __future__ import annotations

import time
from collections import defaultdict
from collections.abc import Callable
from contextvars import ContextVar, Token
from dataclasses import dataclass, field
from typing import Any

from hhtbench.protocol.errors import BudgetSpent
from hhtbench.protocol.system import SIGNATURES
from hhtbench.runtime.terminal import announced_when_slow
from hhtbench.solution.result import Counters

OF_OUTPUT = ("residual_evaluations", "jacobian_evaluations")  # counters that output rows add to
NOTHING = vars(Counters())  # all counters zero
INSTEAD = {  # callback -> derivatives that save its differences, the first that is not declared
    "force": ("force_jacobians",),
    "constraint": ("constraint_jacobian", "constraint_time_derivative", "constraint_acceleration"),
    "constraint_jacobian": ("constraint_acceleration",),
    "velocity_constraint": ("velocity_constraint_jacobian",),
    "reaction": ("reaction_jacobians",),
}
MAX_DIFFERENCE_SHARE = 0.5  # of a solve's callback calls; if differences take more, a message names the derivative
LATE, LATE_SECONDS = 0.1, 0.1  # overrun of a time budget (share of it, and [s]) for the multipliers of rows reached


@dataclass
class Clock:
    """Wall-clock budget of one solve, from the user's call on, with the time of imports, tracing and compilation."""

    limit: float | None = None  #: [s]
    started: float = field(default_factory=time.perf_counter)
    prepared: dict[str, float] = field(default_factory=dict)  #: what was traced or compiled -> [s]
    in_use: bool = False  #: a solver has taken it
    late: float = 0.0  #: beyond the limit [s]
    kept_back: float = 0.0  #: part of the limit reserved for returning what was computed [s]
    passed_in: str = ""  #: note on the preparation during which the time ended
    work: Work | None = None  #: counts the callbacks of a NumPy system while the solve runs
    kept: dict[Any, Any] = field(default_factory=dict)  #: difference derivatives at the latest (t, q, v)
    callback: str = ""  #: the callback of a NumPy system called last
    in_difference: bool = False  #: whether callbacks are called for differences
    calls: int = 0  #: number of calls of a NumPy system's callbacks
    differences: dict[str, int] = field(default_factory=dict)  #: derivative to declare -> calls for its differences

    def left(self) -> float:
        """Return the seconds until the limit; infinity without a limit."""
        if self.limit is None:
            return float("inf")
        return self.limit + self.late - self.kept_back - (time.perf_counter() - self.started)

    def check(self) -> None:
        """Raise :class:`BudgetSpent` when the budget is used up."""
        if self.limit is not None and self.left() < 0.0:
            raise BudgetSpent("seconds", self.limit, self._note())

    def note_preparation(self, what: str, seconds: float) -> None:
        """Record that ``what`` (a trace, compilation or import) took ``seconds``."""
        self.prepared[what] = self.prepared.get(what, 0.0) + seconds
        if -seconds < self.left() < 0.0:
            self.passed_in = f", while {what}, {seconds:.2g} s that cannot be interrupted"

    def note_of_differences(self) -> str:
        """Return a hint which derivative to declare if finite differences took most of the calls; empty string otherwise.

        Calls are counted, not their time, so that the same solve always has the same message.
        """
        taken, name = sum(self.differences.values()), max(self.differences, key=self.differences.__getitem__, default="")
        if not taken > MAX_DIFFERENCE_SHARE * self.calls or not name:
            return ""
        call = f"{name}({', '.join(SIGNATURES[name].arguments)})"
        return f"Differences took {100 * taken / self.calls:.0f} % of the calls of its functions: declare {call}."

    def _note(self) -> str:
        """Return a note on the time spent on preparations if it is 10 % of the budget or more; empty string otherwise."""
        total = sum(self.prepared.values())
        if not self.passed_in and total < 0.1 * (self.limit or 0.0):
            return ""
        return f"{self.passed_in} ({total:.2g} s for preparations in all: imports, traces, compilations)"


_clock: ContextVar[Clock | None] = ContextVar("clock", default=None)


def check_time() -> None:
    """Raise :class:`BudgetSpent` if the running solve, if there is one, has used up its time."""
    clock = _clock.get()
    if clock is not None:
        clock.check()


def note_callback(name: str) -> None:
    """Count one call of a NumPy system's callback for the running solve; raise :class:`BudgetSpent` if a budget is used up.

    Calls of ``force`` and all calls for finite differences count as residual evaluations.  The running solve is found by a
    context variable, since the dynamics of one system serve many solves.
    """
    clock = _clock.get()
    if clock is None:
        return
    clock.callback = name
    clock.calls += 1
    if clock.work is not None and (name == "force" or clock.in_difference):
        clock.work.spend_residual()
    else:
        clock.check()


def kept_of_solve() -> dict[Any, Any]:
    """Return the running solve's cache of difference derivatives; an empty dictionary outside a solve."""
    clock = _clock.get()
    return {} if clock is None else clock.kept


class differencing:
    """Context manager around the callbacks that one derivative by finite differences needs.

    Their calls are booked under the derivative whose declaration would save them.  ``gives(name)`` is True if the system
    declares the derivative ``name``.
    """

    def __init__(self, gives: Callable[[str], bool]) -> None:
        self._gives, self._clock = gives, _clock.get()

    def __enter__(self) -> None:
        clock = self._clock
        if clock is not None and (clock.in_difference or clock.work is None):
            self._clock = None  # it is part of another one, or of no motion
        elif clock is not None:
            clock.in_difference, self._before = True, clock.calls

    def __exit__(self, *_: object) -> None:
        clock = self._clock
        if clock is not None:
            clock.in_difference = False
            names = INSTEAD.get(clock.callback, ())
            name = next((name for name in names if not self._gives(name)), "")
            clock.differences[name] = clock.differences.get(name, 0) + clock.calls - self._before


class uncounted:
    """Context manager around callbacks that are not counted as work of the solve, such as those that determine sizes."""

    def __enter__(self) -> None:
        self._clock = clock = _clock.get()
        if clock is not None:
            self._work, clock.work = clock.work, None

    def __exit__(self, *_: object) -> None:
        if self._clock is not None:
            self._clock.work = self._work


class timed:
    """Context manager that returns the clock of one solve: the one that the caller handed over, or a new one.

    A class, since a generator would write to the traceback of an exception whose class is frozen.
    """

    def __init__(self, limit: float | None, began: float | None = None) -> None:
        """Set the ``limit`` [s] or None, and when the call ``began`` by ``time.perf_counter`` (None: now)."""
        self._limit, self._began = limit, began
        self._token: Token[Clock | None] | None = None

    def __enter__(self) -> Clock:
        clock = _clock.get()
        if clock is None or clock.in_use or clock.limit != self._limit:
            clock = Clock(self._limit, time.perf_counter() if self._began is None else self._began)
        clock.in_use = True
        self._token = _clock.set(clock)
        return clock

    def __exit__(self, *_: object) -> None:
        if self._token is not None:
            if (clock := _clock.get()) is not None:
                clock.work = None
            _clock.reset(self._token)


class handed_over:
    """Context manager that hands ``clock`` over to the solver called inside."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def __enter__(self) -> None:
        self._token = _clock.set(self._clock)

    def __exit__(self, *_: object) -> None:
        _clock.reset(self._token)


class preparing:
    """Context manager around work that cannot be interrupted, ``preparing("tracing force")``; the clock records its time.

    A line is printed on a terminal if it takes long.  Entering raises :class:`BudgetSpent` if the running solve has used up
    its time.
    """

    def __init__(self, what: str) -> None:
        self._what, self._clock = what, _clock.get()
        self._terminal = announced_when_slow(what)

    def __enter__(self) -> None:
        if self._clock is not None:
            self._clock.check()
        self._terminal.__enter__()
        self._began = time.perf_counter()

    def __exit__(self, *_: object) -> None:
        self._terminal.__exit__()
        if self._clock is not None:
            self._clock.note_preparation(self._what, time.perf_counter() - self._began)


@dataclass
class Work:
    """Tally of the evaluations of one solve, the only mutable object of a solve; read it by :meth:`counters`."""

    max_evaluations: int | None = None
    clock: Clock = field(default_factory=Clock)
    tally: dict[str, int] = field(default_factory=lambda: defaultdict(int))  #: by the names of ``Counters``
    output: dict[str, int] = field(default_factory=lambda: defaultdict(int))  #: part of ``tally`` that output rows have cost

    def add(self, name: str, amount: int = 1) -> None:
        """Raise the counter ``name`` of :class:`~hhtbench.Counters`."""
        self.tally[name] += amount

    def counted(self, function: Callable[..., Any], *, residuals: int = 0, jacobians: int = 0) -> Callable[..., Any]:
        """Wrap ``function`` so that each call counts ``residuals`` evaluations of F and ``jacobians`` Jacobians."""

        def call(*arguments: Any) -> Any:
            for _ in range(residuals):
                self.spend_residual()
            self.tally["jacobian_evaluations"] += jacobians
            return function(*arguments)

        return call

    def check_time(self) -> None:
        """Raise :class:`BudgetSpent` when the time budget is used up."""
        self.clock.check()

    def only_output_is_left(self) -> None:
        """Lift the evaluation budget and extend the time budget a little, to return what was already computed."""
        self.max_evaluations, self.clock.kept_back = None, 0.0
        self.clock.late = LATE * (self.clock.limit or 0.0) + LATE_SECONDS

    def for_output(self) -> ForOutput:
        """Return a context manager in which evaluations count as ``output_evaluations``; budgets still count them."""
        return ForOutput(self)

    def counted_for_steps(self) -> dict[str, Any]:
        """Return the tally without the cost of output rows, and that cost as ``output_evaluations``."""
        spent, output = self.tally.copy(), self.output
        for name, count in output.items():
            spent[name] -= count
        return spent | {"output_evaluations": output["residual_evaluations"]}

    def counters(self) -> Counters:
        """Return the tally as frozen :class:`~hhtbench.Counters`."""
        return Counters.of(NOTHING | self.counted_for_steps())

    def spend_residual(self) -> None:
        """Count one evaluation of F; raises :class:`BudgetSpent` when a budget is used up."""
        if self.max_evaluations is not None and self.tally["residual_evaluations"] >= self.max_evaluations:
            raise BudgetSpent("evaluations", self.max_evaluations)
        self.check_time()
        self.tally["residual_evaluations"] += 1


class ForOutput:
    """Context manager of :meth:`Work.for_output`: books what ``work`` counts inside as cost of output rows."""

    def __init__(self, work: Work) -> None:
        self._work, self._before = work, [work.tally.get(name, 0) for name in OF_OUTPUT]

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        tally, output = self._work.tally, self._work.output
        for name, count in zip(OF_OUTPUT, self._before, strict=True):
            if tally.get(name, 0) > count:
                output[name] += tally[name] - count
