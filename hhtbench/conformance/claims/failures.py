"""What goes wrong is told: budgets, values that are not finite, exceptions, starts off the constraints."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.conformance.entry import claim
from hhtbench.conformance.scenes.pendulum import GRAVITY, MASS, Function, numpy_pendulum, pendulum
from hhtbench.conformance.subject import COMPONENTS, Declined, Subject, expect, same_bits
from hhtbench.protocol import SIGNATURES, Problem, declared
from hhtbench.result import Solution, Status

HALF_WAY = 0.75  # [s]
WEIGHT = np.array([0.0, -MASS * GRAVITY, 0.0])
LATE = 5.0  # s: how long a solve may take beyond a budget of a twentieth of a second, compilation aside


class Planned(Exception):
    """Raised by a function of a system on purpose."""


def _counted(calls: list[float], after: Callable[[float], Any] = lambda t: None) -> Function:
    def force(t: float, q: Any, v: Any) -> Any:
        calls.append(t)
        value = after(t)
        return WEIGHT if value is None else value

    return force


def _told(solution: Solution, *words: str) -> None:
    expect(not solution.success, f"it ends with {solution.status.label}")
    expect(solution.message.strip(), f"{solution.status.label} comes without a message")
    for word in words:
        expect(word in solution.message, f"the message does not name {word}: {solution.message!r}")
    for name in ("t", *COMPONENTS):
        expect(np.isfinite(getattr(solution, name)).all(), f"{name} of the rows so far holds values that are not finite")


# --- budgets ------------------------------------------------------------------------------------------------------------


@claim("budget/steps")
def budget_of_steps(subject: Subject) -> None:
    """``max_num_steps`` ends the run with status max_steps, after so many steps, which are those of a run without it."""
    scene = subject.scene("position")
    request = subject.ladder(scene.problem)[0]
    whole = subject.solved(scene, **request)
    cut = subject.solve(scene.problem, **request, max_num_steps=2)
    expect(cut.status is Status.max_steps, f"with 2 steps allowed it ends with {cut.status.label}: {cut.message}")
    _told(cut)
    expect(cut.counters.steps_accepted == 2, f"2 steps were allowed and {cut.counters.steps_accepted} reported")
    expect(cut.t.size == 3 and np.array_equal(cut.q, whole.q[:3]), "the rows are not the first of the whole run")


@claim("budget/evaluations")
def budget_of_evaluations(subject: Subject) -> None:
    """``max_evaluations`` ends the run with status evaluation_budget, and no more evaluations are made for its steps.

    Of functions of JAX, which may be evaluated in compiled code, and of those of NumPy, whose calls are counted here too.
    """
    calls: list[float] = []
    for scene in (pendulum(), numpy_pendulum(force=_counted(calls))):
        request = subject.ladder(scene.problem)[-1]
        solution = subject.solve(scene.problem, **request, max_evaluations=60)
        expect(solution.status is Status.evaluation_budget, f"it ends with {solution.status.label}: {solution.message}")
        made = solution.counters.residual_evaluations
        expect(made is not None and made <= 60, f"60 evaluations were allowed and {made} reported")
    spare = (solution.counters.output_evaluations or 0) + 60
    expect(len(calls) <= spare + 5, f"60 evaluations were allowed and the force was called {len(calls)} times")


@claim("budget/seconds")
def budget_of_seconds(subject: Subject) -> None:
    """``max_seconds`` ends the run with status deadline, soon."""
    slow = _counted([], lambda t: time.sleep(0.005))
    scene = numpy_pendulum(force=slow)
    request = subject.ladder(scene.problem)[-1]
    began = time.perf_counter()
    solution = subject.solve(scene.problem, **request, max_seconds=0.05)
    took = time.perf_counter() - began
    expect(solution.status is Status.deadline, f"after {took:.2g} s it ends with {solution.status.label}")
    _told(solution)
    expect(took < LATE, f"0.05 s were allowed and {took:.2g} s taken")


@claim("budget/unused")
def unused_budgets_change_nothing(subject: Subject) -> None:
    """Budgets that are not used up change no bit."""
    scene = subject.scene("position")
    request = subject.ladder(scene.problem)[1]
    steps = subject.solved(scene, **request).counters.steps_accepted or 10**6
    free = subject.succeeds(scene.problem, **request, max_num_steps=steps, max_evaluations=10**8, max_seconds=1e4)
    same_bits(subject.solved(scene, **request), free)


# --- counters -----------------------------------------------------------------------------------------------------------


@claim("counters/steps")
def counted_steps_are_rows(subject: Subject) -> None:
    """There is a row at the start and one for every step that is counted."""
    scene = subject.scene("position")
    solution = subject.solved(scene, **subject.ladder(scene.problem)[1])
    steps = solution.counters.steps_accepted
    expect(steps == solution.t.size - 1, f"{steps} steps are counted and there are {solution.t.size} rows")


@claim("counters/sizes")
def counters_are_counts(subject: Subject) -> None:
    """Counters are whole numbers, not negative, or None; where they come from is said."""
    scene = subject.scene("mixed")
    counters = subject.solved(scene, **subject.ladder(scene.problem)[1]).counters
    for name, value in vars(counters).items():
        if name != "provenance":
            expect(value is None or (isinstance(value, int) and value >= 0), f"{name} is {value!r}")
    expect(bool(counters.provenance), "provenance is empty")
    expect(counters.residual_evaluations != 0, "not one evaluation is counted")


@claim("counters/evaluations")
def counted_evaluations_are_calls(subject: Subject) -> None:
    """The evaluations that are counted are calls of the force, and those of other functions for differences, to a tenth."""
    calls: list[float] = []
    others: list[float] = []
    scene = numpy_pendulum(**{**_all_counted(others), "force": _counted(calls)})
    solution = subject.succeeds(scene.problem, **subject.ladder(scene.problem)[1])
    told = solution.counters.residual_evaluations
    if told is None:
        raise Declined(f"{subject.name} does not count evaluations")
    told += solution.counters.output_evaluations or 0
    close = 0.9 * len(calls) - 5 <= told <= 1.1 * (len(calls) + len(others)) + 5
    text = f"the force was called {len(calls)} times, all others {len(others)} times"
    expect(close, f"{told} evaluations are counted and {text}")


def _all_counted(calls: list[float]) -> dict[str, Any]:
    """The other functions of the pendulum, whose calls are noted."""
    system = numpy_pendulum().problem.system
    names = [name for name in SIGNATURES if name != "force" and callable(declared(system, name))]

    def counted(function: Any) -> Any:
        def call(t: float, *arguments: Any) -> Any:
            calls.append(t)
            return function(t, *arguments)

        return call

    return {name: counted(declared(system, name)) for name in names}


# --- values that are not finite -----------------------------------------------------------------------------------------


def _not_finite(subject: Subject, function: str, scene: Any) -> None:
    solution = subject.solve(scene.problem, **subject.ladder(scene.problem)[0])
    expect(solution.status is not Status.success, f"{function} is not finite half-way, and the run ends with success")
    known = solution.status is Status.nonfinite_callback
    expect(known, f"{function} is not finite, and the status is {solution.status.label}: {solution.message}")
    _told(solution, function)
    if solution.t.size:
        expect(solution.t[-1] <= HALF_WAY + 1e-12, f"there is a row at {solution.t[-1]:.6g} s, after the last good value")


@claim("nan/force")
def force_that_ends(subject: Subject) -> None:
    """A force that is NaN half-way is named; the rows before it stay."""
    scene = numpy_pendulum(force=_counted([], lambda t: WEIGHT * np.nan if t > HALF_WAY else None))
    _not_finite(subject, "force", scene)


@claim("nan/infinite_force")
def infinite_force(subject: Subject) -> None:
    """An infinite force is named."""
    scene = numpy_pendulum(force=_counted([], lambda t: np.full(3, np.inf) if t > HALF_WAY else None))
    _not_finite(subject, "force", scene)


@claim("nan/mass")
def mass_that_ends(subject: Subject) -> None:
    """A mass that is NaN half-way is named."""
    scene = numpy_pendulum(mass_matrix=lambda t, q: MASS * np.eye(3) * (np.nan if t > HALF_WAY else 1.0))
    _not_finite(subject, "mass", scene)


@claim("nan/constraint")
def constraint_that_ends(subject: Subject) -> None:
    """A constraint that is NaN half-way is named, where the solver evaluates it."""
    calls: list[float] = []

    def constraint(t: float, q: Any) -> Any:
        calls.append(t)
        value = np.array([(q @ q - 1.44) / 2, q[2]])
        return value * np.nan if t > HALF_WAY else value

    scene = numpy_pendulum(constraint=constraint)
    solution = subject.solve(scene.problem, **subject.ladder(scene.problem)[0])
    if solution.success and not any(t > HALF_WAY for t in calls):
        raise Declined(f"{subject.name} does not evaluate the constraint on the way")
    _told(solution)


@claim("nan/from_the_start")
def force_that_never_is(subject: Subject) -> None:
    """A force that is NaN at the start ends the run there, with its name."""
    scene = numpy_pendulum(force=lambda t, q, v: WEIGHT * np.nan)
    solution = subject.solve(scene.problem, **subject.ladder(scene.problem)[0])
    _told(solution, "force")
    expect(solution.t.size <= 1, f"there are {solution.t.size} rows")


# --- exceptions ---------------------------------------------------------------------------------------------------------


def _raises(subject: Subject, problem: Problem, error: BaseException) -> None:
    request = subject.ladder(problem)[0]
    try:
        solution = subject.solve(problem, **request)
    except type(error) as caught:
        expect(caught is error, "the exception that comes back is another object")
        partial = getattr(caught, "partial_solution", None)
        expect(partial is None or not partial.success, "the partial solution claims success")
        return
    told = solution.status is Status.user_exception and type(error).__name__ in solution.message
    expect(told, f"the exception is swallowed: {solution.status.label}, {solution.message!r}")


def _raising(error: BaseException, when: Callable[[float], bool]) -> Function:
    def raised(t: float) -> None:
        if when(t):
            raise error

    return _counted([], raised)


@claim("exception/half_way")
def exception_half_way(subject: Subject) -> None:
    """An exception of the force comes back as the same object, or is the status user_exception with its name."""
    error = Planned("half-way")
    scene = numpy_pendulum(force=_raising(error, lambda t: t > HALF_WAY))
    _raises(subject, scene.problem, error)


@claim("exception/at_once")
def exception_at_once(subject: Subject) -> None:
    """So does one of the first call."""
    error = Planned("at once")
    scene = numpy_pendulum(force=_raising(error, lambda t: True))
    _raises(subject, scene.problem, error)


@claim("exception/arithmetic")
def exception_of_arithmetic(subject: Subject) -> None:
    """So does one that libraries like to catch: a ZeroDivisionError."""
    error = ZeroDivisionError("of the user")
    scene = numpy_pendulum(force=_raising(error, lambda t: t > HALF_WAY))
    _raises(subject, scene.problem, error)


@claim("exception/interrupt")
def interrupt(subject: Subject) -> None:
    """Ctrl-C ends the solve."""
    error = KeyboardInterrupt()
    scene = numpy_pendulum(force=_raising(error, lambda t: t > HALF_WAY))
    try:
        solution = subject.solve(scene.problem, **subject.ladder(scene.problem)[0])
    except KeyboardInterrupt:
        return
    expect(solution.status is Status.interrupted, f"Ctrl-C is swallowed: the run ends with {solution.status.label}")


@claim("exception/works_again")
def works_again(subject: Subject) -> None:
    """After an exception of a system the solver gives the same bits as before it."""
    scene = subject.scene("position")
    request = subject.ladder(scene.problem)[1]
    before = subject.solved(scene, **request)
    error = Planned("before")
    broken = numpy_pendulum(force=_raising(error, lambda t: t > HALF_WAY))
    _raises(subject, broken.problem, error)
    same_bits(before, subject.succeeds(scene.problem, **request))


# --- starts and requests ------------------------------------------------------------------------------------------------


def _inconsistent(subject: Subject, problem: Problem, row: str) -> None:
    request = subject.ladder(problem)[0]
    try:
        solution = subject.solve(problem, **request)
    except ValueError as refused:
        expect(str(refused).strip(), "the start is refused without a word")
        return
    expect(not solution.success, "a start off the constraints is integrated as if nothing were wrong")
    told = solution.status is Status.inconsistent_initial
    expect(told, f"a start off the constraints ends with {solution.status.label}: {solution.message}")
    expect(row in solution.message, f"the message does not name the row {row}: {solution.message!r}")


@claim("start/position")
def start_off_the_position_constraints(subject: Subject) -> None:
    """A start off a position constraint is refused, with its row."""
    problem = subject.scene("position").problem
    _inconsistent(subject, replace(problem, q0=1.05 * problem.q0, exact=None), "[0]")


@claim("start/velocity")
def start_off_the_velocity_level(subject: Subject) -> None:
    """A start whose velocity leaves the constraints is refused, with its row."""
    problem = subject.scene("position").problem
    _inconsistent(subject, replace(problem, v0=np.array([0.0, 0.0, 0.1]), exact=None), "[1]")


@claim("start/velocity_constraint")
def start_off_a_velocity_constraint(subject: Subject) -> None:
    """A start off a velocity constraint is refused, with its row."""
    problem = subject.scene("velocity").problem
    _inconsistent(subject, replace(problem, v0=problem.v0 + np.array([0.0, 0.3, 0.0]), exact=None), "[0]")


@claim("status/message")
def success_says_something(subject: Subject) -> None:
    """A success has a message, and the status is one of the table's."""
    scene = subject.scene("position")
    solution = subject.solved(scene, **subject.ladder(scene.problem)[0])
    expect(isinstance(solution.status, Status), f"status is {solution.status!r}")
    expect(isinstance(solution.message, str) and bool(solution.message.strip()), "message is empty")
