"""Claims on failures: budgets, values that are not finite, exceptions and inconsistent starts are reported."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from hhtbench.conformance.entry import claim
from hhtbench.conformance.scenes.pendulum import numpy_pendulum, pendulum
from hhtbench.conformance.scenes.rod import FUNCTIONS, plane, problem, spoiled
from hhtbench.conformance.subject import COMPONENTS, Declined, Subject, expect, same_bits
from hhtbench.protocol.system import SIGNATURES, declared
from hhtbench.solution.result import Solution, Status

HALF_WAY = 0.75  # [s]
NEVER = -1.0  # [s], before the start
MAX_LATE = 5.0  # [s] beyond a budget of a twentieth of a second, compilation aside


class Planned(Exception):
    """Raised by a function of a system on purpose."""


def _says(solution: Solution, *words: str) -> None:
    expect(not solution.success, f"it ends with {solution.status.label}")
    expect(solution.message.strip(), f"{solution.status.label} comes without a message")
    for word in words:
        expect(word in solution.message, f"the message does not name {word}: {solution.message!r}")
    for name in ("t", *COMPONENTS):
        expect(np.isfinite(getattr(solution, name)).all(), f"{name} of the rows so far holds values that are not finite")


@claim("budget/steps")
def budget_of_steps(subject: Subject) -> None:
    """``max_num_steps`` ends the run with status max_steps, after so many steps, which are those of a run without it."""
    scene, request = subject.case("position", 0)
    whole = subject.solved(scene, **request)
    cut = subject.solve(scene.problem, **request, max_num_steps=2)
    expect(cut.status is Status.max_steps, f"with 2 steps allowed it ends with {cut.status.label}: {cut.message}")
    _says(cut)
    expect(cut.counters.steps_accepted == 2, f"2 steps were allowed and {cut.counters.steps_accepted} reported")
    expect(cut.t.size == 3 and np.array_equal(cut.q, whole.q[:3]), "the rows are not the first of the whole run")


@claim("budget/evaluations", known={"diffrax": ((), "its compiled loop ends after up to SEGMENT attempts")})
def budget_of_evaluations(subject: Subject) -> None:
    """``max_evaluations`` ends the run with status evaluation_budget, and no more evaluations are made for its steps.

    Of functions of JAX, which may be evaluated in compiled code, and of those of NumPy, whose calls are counted here too.
    """
    calls: list[float] = []
    for scene in (pendulum(), numpy_pendulum(**_counted(["force"], calls))):
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

    def slow(t: float, q: Any, v: Any) -> Any:
        time.sleep(0.005)
        return FUNCTIONS["force"](t, q, v)

    slowed = problem(plane(force=slow))
    request = subject.ladder(slowed)[-1]
    began = time.perf_counter()
    solution = subject.solve(slowed, **request, max_seconds=0.05)
    took = time.perf_counter() - began
    expect(solution.status is Status.deadline, f"after {took:.2g} s it ends with {solution.status.label}")
    _says(solution)
    expect(took < MAX_LATE, f"0.05 s were allowed and {took:.2g} s taken")


@claim("budget/unused")
def unused_budgets_change_nothing(subject: Subject) -> None:
    """Budgets that are not used up change no bit."""
    scene, request = subject.case("position", 1)
    steps = subject.solved(scene, **request).counters.steps_accepted or 10**6
    free = subject.succeeds(scene.problem, **request, max_num_steps=steps, max_evaluations=10**8, max_seconds=1e4)
    same_bits(subject.solved(scene, **request), free)


@claim("counters/sizes")
def counters_are_counts(subject: Subject) -> None:
    """Counters are whole numbers or None, their source is said, and there is a row at the start and one a counted step."""
    scene = subject.scene("position")
    solution = subject.solved(scene, **subject.ladder(scene.problem)[1])
    counters = solution.counters
    for name, value in vars(counters).items():
        if name != "provenance":
            expect(value is None or (isinstance(value, int) and value >= 0), f"{name} is {value!r}")
    expect(bool(counters.provenance), "provenance is empty")
    expect(counters.residual_evaluations != 0, "not one evaluation is counted")
    steps = counters.steps_accepted
    expect(steps == solution.t.size - 1, f"{steps} steps are counted and there are {solution.t.size} rows")


@claim("counters/evaluations")
def counted_evaluations_are_calls(subject: Subject) -> None:
    """The evaluations that are counted are calls of the force, and those of other functions for differences, to a tenth."""
    calls: list[float] = []
    others: list[float] = []
    names = [name for name in SIGNATURES if name != "force"]
    scene = numpy_pendulum(**_counted(["force"], calls), **_counted(names, others))
    solution = subject.succeeds(scene.problem, **subject.ladder(scene.problem)[1])
    counted = solution.counters.residual_evaluations
    if counted is None:
        raise Declined(f"{subject.name} does not count evaluations")
    counted += solution.counters.output_evaluations or 0
    close = 0.9 * len(calls) - 5 <= counted <= 1.1 * (len(calls) + len(others)) + 5
    text = f"the force was called {len(calls)} times, all others {len(others)} times"
    expect(close, f"{counted} evaluations are counted and {text}")


def _counted(names: list[str], calls: list[float]) -> dict[str, Any]:
    """Return functions of the pendulum that record their calls."""
    system = numpy_pendulum().problem.system

    def noted(function: Any, t: float, *arguments: Any) -> Any:
        calls.append(t)
        return function(t, *arguments)

    return {name: partial(noted, declared(system, name)) for name in names if callable(declared(system, name))}


NOT_FINITE = {  # part -> function, its value after a time, and that time [s]
    "force": ("force", np.nan, HALF_WAY),
    "infinite_force": ("force", np.inf, HALF_WAY),
    "mass": ("mass_matrix", np.nan, HALF_WAY),
    "constraint": ("constraint", np.nan, HALF_WAY),
    "from_the_start": ("force", np.nan, NEVER),
}


@claim("nan", parts=NOT_FINITE)
def function_that_is_not_finite(subject: Subject, part: str) -> None:
    """A function that is not finite from a time on is named, and the rows before it stay."""
    name, bad, since = NOT_FINITE[part]
    given = problem(spoiled(name, bad, lambda t, count: t > since))
    solution = subject.solve(given, **subject.ladder(given)[0])
    _says(solution, name)
    if name == "constraint":  # an underlying ODE is solved without it: the check of its rows says so
        return
    named = solution.status is Status.nonfinite_callback
    expect(named, f"{name} is not finite, and the run ends with {solution.status.label}: {solution.message}")
    last = solution.t[-1] if solution.t.size > 1 else NEVER
    expect(last <= since + 1e-12, f"there is a row at {last:.6g} s, after the last good value")


EXCEPTIONS: dict[str, tuple[BaseException, float]] = {
    "half_way": (Planned("half-way"), HALF_WAY),
    "at_once": (Planned("at once"), NEVER),
    "arithmetic": (ZeroDivisionError("of the user"), HALF_WAY),  # one that libraries like to catch
    "interrupt": (KeyboardInterrupt(), HALF_WAY),
}


@claim("exception", parts=EXCEPTIONS)
def exception_comes_back(subject: Subject, part: str) -> None:
    """An exception of the force comes back as the same object, or is a status with its name; Ctrl-C ends the solve."""
    error, since = EXCEPTIONS[part]
    given = problem(spoiled("force", error, lambda t, count: t > since))
    interrupt = isinstance(error, KeyboardInterrupt)
    try:
        solution = subject.solve(given, **subject.ladder(given)[0])
    except type(error) as caught:
        expect(caught is error or interrupt, "the exception that comes back is another object")
        partial_solution = getattr(caught, "partial_solution", None)
        expect(partial_solution is None or not partial_solution.success, "the partial solution claims success")
        return
    named = interrupt or type(error).__name__ in solution.message
    ended = solution.status is (Status.interrupted if interrupt else Status.user_exception)
    expect(ended and named, f"the exception is swallowed: {solution.status.label}, {solution.message!r}")


@claim("exception/works_again")
def works_again(subject: Subject) -> None:
    """After an exception of a system the solver gives the same bits as before it."""
    scene, request = subject.case("position", 1)
    before = subject.solved(scene, **request)
    exception_comes_back(subject, "half_way")
    same_bits(before, subject.succeeds(scene.problem, **request))


STARTS: dict[str, tuple[str, float, Any, str]] = {  # scene, factor of q0, added to v0, row that is off
    "position": ("position", 1.05, 0.0, "[0]"),
    "velocity": ("position", 1.0, [0.0, 0.0, 0.1], "[1]"),
    "velocity_constraint": ("velocity", 1.0, [0.0, 0.3, 0.0], "[0]"),
}


@claim("start", parts=STARTS)
def start_off_the_constraints(subject: Subject, part: str) -> None:
    """A start off the constraints, or off their velocity level, is refused, with its row."""
    scene, factor, added, row = STARTS[part]
    plain = subject.scene(scene).problem
    given = replace(plain, q0=factor * plain.q0, v0=plain.v0 + np.array(added), exact=None)
    request = subject.ladder(given)[0]
    try:
        solution = subject.solve(given, **request)
    except ValueError as refused:
        expect(str(refused).strip(), "the start is refused without a word")
        return
    named = solution.status is Status.inconsistent_initial
    expect(named, f"a start off the constraints ends with {solution.status.label}: {solution.message}")
    expect(row in solution.message, f"the message does not name the row {row}: {solution.message!r}")
