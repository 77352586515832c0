"""Counts the work of one solve and stops it at its budgets."""

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

OF_OUTPUT = ("residual_evaluations", "jacobian_evaluations")  # what output rows cost
NOTHING = vars(Counters())  # counted
INSTEAD = {  # callback -> derivatives that save its differences, the first that is not declared
    "force": ("force_jacobians",),
    "constraint": ("constraint_jacobian", "constraint_time_derivative", "constraint_acceleration"),
    "constraint_jacobian": ("constraint_acceleration",),
    "velocity_constraint": ("velocity_constraint_jacobian",),
    "reaction": ("reaction_jacobians",),
}
MOST = 0.5  # of a solve's calls of plain callables: a message names differences that take more
LATE, LATE_SECONDS = 0.1, 0.1  # beyond a time budget, of it and [s]: for the multipliers of rows that were reached


@dataclass
class Clock:
    """The time budget of one solve, which runs from the caller's call on, and what of it went into preparing functions."""

    limit: float | None = None  #: [s]
    started: float = field(default_factory=time.perf_counter)
    prepared: dict[str, float] = field(default_factory=dict)  #: what was traced or compiled -> [s]
    in_use: bool = False  #: a solver has taken it
    late: float = 0.0  #: beyond the limit [s]
    kept_back: float = 0.0  #: of the limit, for handing over what was computed [s]
    passed_in: str = ""  #: what was being prepared when the time ended
    work: Work | None = None  #: what counts the callbacks of plain callables while the solve runs
    kept: dict[Any, Any] = field(default_factory=dict)  #: derivatives by differences at the last places
    callback: str = ""  #: the last callback of plain callables
    in_difference: bool = False  #: whether callbacks are called for differences
    calls: int = 0  #: of plain callables
    differences: dict[str, int] = field(default_factory=dict)  #: the derivative to declare instead -> calls of them

    def left(self) -> float:
        """Seconds until the limit."""
        if self.limit is None:
            return float("inf")
        return self.limit + self.late - self.kept_back - (time.perf_counter() - self.started)

    def check(self) -> None:
        """Raise :class:`BudgetSpent` when the budget is used up."""
        if self.limit is not None and self.left() < 0.0:
            raise BudgetSpent("seconds", self.limit, self._note())

    def note_preparation(self, what: str, seconds: float) -> None:
        """``what`` has just been prepared in so many seconds."""
        self.prepared[what] = self.prepared.get(what, 0.0) + seconds
        if -seconds < self.left() < 0.0:
            self.passed_in = f", while {what}, {seconds:.2g} s that cannot be interrupted"

    def note_of_differences(self) -> str:
        """Which derivative to declare, if differences took most of the calls; else empty.

        Calls are counted, and not their time, so that the same solve has the same message.
        """
        taken, name = sum(self.differences.values()), max(self.differences, key=self.differences.__getitem__, default="")
        if not taken > MOST * self.calls or not name:
            return ""
        call = f"{name}({', '.join(SIGNATURES[name].arguments)})"
        return f"Differences took {100 * taken / self.calls:.0f} % of the calls of its functions: declare {call}."

    def _note(self) -> str:
        """Where the time went, if much of it went into preparing functions."""
        total = sum(self.prepared.values())
        if not self.passed_in and total < 0.1 * (self.limit or 0.0):
            return ""
        return f"{self.passed_in} ({total:.2g} s for preparations in all: imports, traces, compilations)"


_clock: ContextVar[Clock | None] = ContextVar("clock", default=None)


def check_time() -> None:
    """Raise :class:`BudgetSpent` where the solve that runs here, if one does, has used up its time."""
    clock = _clock.get()
    if clock is not None:
        clock.check()


def note_callback(name: str) -> None:
    """Count a callback of a NumPy system for the solve that runs here, which may be out of time.

    Counted are those of the force, and all that differences take.  The system's dynamics serve many solves, and so know of
    none.
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
    """What the solve that runs here keeps of the last places; an empty dictionary outside of a solve."""
    clock = _clock.get()
    return {} if clock is None else clock.kept


class differencing:
    """``with differencing(gives):`` around the callbacks of one derivative by differences; ``gives``: what is declared.

    Their calls count as those of the derivative whose declaration would save them.
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
    """``with uncounted():`` around callbacks that belong to no point of the motion, as those that find out sizes."""

    def __enter__(self) -> None:
        self._clock = clock = _clock.get()
        if clock is not None:
            self._work, clock.work = clock.work, None

    def __exit__(self, *_: object) -> None:
        if self._clock is not None:
            self._clock.work = self._work


class timed:
    """``with timed(limit) as clock``: the clock of one solve; a solver takes the one that its caller hands over.

    A class, since a generator would write to the traceback of an exception whose class is frozen.
    """

    def __init__(self, limit: float | None, began: float | None = None) -> None:
        """``began``: when the call did, where that is not now."""
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
    """``with handed_over(clock)``: the clock for the solver that is called inside."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def __enter__(self) -> None:
        self._token = _clock.set(self._clock)

    def __exit__(self, *_: object) -> None:
        _clock.reset(self._token)


class preparing:
    """``with preparing("tracing force")``: around what cannot be interrupted; the clock in use notes its time.

    It is printed at a terminal if it takes long.  Entering raises :class:`BudgetSpent` where the budget of
    the solve that needs it is used up.
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
    """Tally of one solve.  The one mutable object of a solve; a solver reads it through :meth:`counters`."""

    max_evaluations: int | None = None
    clock: Clock = field(default_factory=Clock)
    tally: dict[str, int] = field(default_factory=lambda: defaultdict(int))  #: by the names of ``Counters``
    output: dict[str, int] = field(default_factory=lambda: defaultdict(int))  #: of ``tally``, what output rows have cost

    def add(self, name: str, amount: int = 1) -> None:
        """Raise the counter ``name`` of :class:`~hhtbench.Counters`."""
        self.tally[name] += amount

    def counted(self, function: Callable[..., Any], *, residuals: int = 0, jacobians: int = 0) -> Callable[..., Any]:
        """``function`` with its points counted: ``residuals`` evaluations of F and ``jacobians`` per call."""

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
        """What was computed is handed over: evaluations are counted without a limit, and a little more time is given."""
        self.max_evaluations, self.clock.kept_back = None, 0.0
        self.clock.late = LATE * (self.clock.limit or 0.0) + LATE_SECONDS

    def for_output(self) -> ForOutput:
        """``with work.for_output():`` what is evaluated inside is for output rows, not for the steps; budgets count it."""
        return ForOutput(self)

    def counted_for_steps(self) -> dict[str, Any]:
        """The tally without what output rows have cost, which is ``output_evaluations``."""
        spent, output = self.tally.copy(), self.output
        for name, count in output.items():
            spent[name] -= count
        return spent | {"output_evaluations": output["residual_evaluations"]}

    def counters(self) -> Counters:
        """The tally, frozen."""
        return Counters.of(NOTHING | self.counted_for_steps())

    def spend_residual(self) -> None:
        """Count one evaluation of F; raises :class:`BudgetSpent` when a budget is used up."""
        if self.max_evaluations is not None and self.tally["residual_evaluations"] >= self.max_evaluations:
            raise BudgetSpent("evaluations", self.max_evaluations)
        self.check_time()
        self.tally["residual_evaluations"] += 1


class ForOutput:
    """Between its two ends everything that ``work`` counts is work for output rows."""

    def __init__(self, work: Work) -> None:
        self._work, self._before = work, [work.tally.get(name, 0) for name in OF_OUTPUT]

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        tally, output = self._work.tally, self._work.output
        for name, count in zip(OF_OUTPUT, self._before, strict=True):
            if tally.get(name, 0) > count:
                output[name] += tally[name] - count
