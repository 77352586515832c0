"""Claims on conduct: inputs are not changed, results are reproducible, rows are where they were asked for."""

from __future__ import annotations

import contextlib
import io
import warnings
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from hhtbench.conformance.entry import claim
from hhtbench.conformance.scenes.pendulum import numpy_pendulum
from hhtbench.conformance.subject import Declined, Subject, at, errors, expect, same_bits
from hhtbench.solution.request import Request


@claim("inputs/untouched")
def inputs_are_left_alone(subject: Subject) -> None:
    """q0, v0 and t_eval of the caller, which must not be written to, are taken, and are what they were after a solve."""
    scene = subject.scene("position")
    times = np.linspace(*scene.problem.t_span, 4)
    problem = replace(scene.problem, q0=scene.problem.q0.copy(), v0=scene.problem.v0.copy())
    given = problem.q0, problem.v0, times
    for array in given:
        array.setflags(write=False)
    before = [array.copy() for array in given]
    subject.succeeds(problem, **at(subject.ladder(problem)[0], times))
    for old, new in zip(before, given, strict=True):
        expect(np.array_equal(old, new), "an array of the caller was changed")


@claim("inputs/results_are_the_callers")
def results_share_no_memory(subject: Subject) -> None:
    """What a caller writes into a solution reaches neither the problem nor the next solution."""
    scene, request = subject.case("position", 0)
    first = subject.succeeds(scene.problem, **request)
    kept = first.q.copy()
    for array in (first.t, first.q, first.v, first.lam):
        if array.flags.writeable:
            array[...] = -1.0
    expect(np.array_equal(scene.problem.q0, scene.exact(0.0).q), "the problem's q0 is a view of the solution's rows")
    again = subject.succeeds(scene.problem, **request)
    expect(np.array_equal(again.q, kept), "what was written into one solution is in the next")


@claim("inputs/world")
def world_is_left_alone(subject: Subject) -> None:
    """A solve prints nothing, warns of nothing, and leaves random numbers and floating-point settings alone."""
    scene, request = subject.case("position", 0)
    before = np.random.get_state()[1].copy(), np.geterr()  # type: ignore[index]  # noqa: NPY002
    said = io.StringIO()
    with warnings.catch_warnings(record=True) as warned, contextlib.redirect_stdout(said):
        warnings.simplefilter("always")
        subject.succeeds(scene.problem, **request)
    after = np.random.get_state()[1], np.geterr()  # type: ignore[index]  # noqa: NPY002
    expect(np.array_equal(before[0], after[0]), "the global random numbers were used")
    expect(before[1] == after[1], "NumPy's handling of floating-point errors was changed")
    expect(not said.getvalue(), f"it prints: {said.getvalue()[:80]!r}")
    expect(not warned, f"it warns: {warned[0].message if warned else ''}")


@claim("repeat/twice")
def same_bits_twice(subject: Subject) -> None:
    """A second solve gives the same bits and counters, by another instance too, and whatever was solved between them."""
    scene, other = subject.scene("position"), subject.scene("rheonomic")
    request = subject.ladder(scene.problem)[1]
    first = subject.solved(scene, **request)
    same_bits(first, subject.succeeds(scene.problem, **request))
    same_bits(first, subject.succeeds(scene.problem, subject.fresh(), **request))
    subject.succeeds(other.problem, **subject.ladder(other.problem)[0])
    subject.solve(scene.problem, **subject.ladder(scene.problem)[0], max_num_steps=3)
    same_bits(first, subject.succeeds(scene.problem, **request))


@claim("repeat/two_threads")
def same_bits_in_two_threads(subject: Subject) -> None:
    """Two threads that solve different problems at once get the bits that each gets alone."""
    scenes = [subject.scene("position"), subject.scene("mixed")]
    requests = [subject.ladder(scene.problem)[1] for scene in scenes]
    alone = [subject.solved(scene, **request) for scene, request in zip(scenes, requests, strict=True)]
    with ThreadPoolExecutor(max_workers=2) as threads:
        for _ in range(3):
            jobs = [
                threads.submit(subject.solve, scene.problem, **request)
                for scene, request in zip(scenes, requests, strict=True)
            ]
            for before, job in zip(alone, jobs, strict=True):
                same_bits(before, job.result())


@claim("output/times")
def rows_are_at_the_times_asked_for(subject: Subject) -> None:
    """Output comes at the times asked for, bit by bit, repeated ones and the end among them, or the start alone."""
    scene = subject.scene("position")
    t0, t1 = scene.problem.t_span
    for times in (np.array([t0, 0.1, 0.1, 1 / 3, t1, t1]), np.array([t0])):
        solution = subject.solved(scene, **at(subject.ladder(scene.problem)[0], times))
        expect(np.array_equal(solution.t, times), f"rows at {solution.t}, asked for {times}")
        expect(np.array_equal(solution.q[0], scene.problem.q0), "the first row is not the start")
    twice = subject.solved(scene, **at(subject.ladder(scene.problem)[0], np.array([0.1, 0.1]))).q
    expect(np.array_equal(twice[0], twice[1]), "the same time twice gives two states")


@claim("output/as_accurate", "position", "rheonomic", "velocity", "mixed")
def output_between_steps_is_as_accurate(subject: Subject, name: str) -> None:
    """Rows between the steps are as accurate as those at steps."""
    scene, request = subject.case(name, 1)
    times = scene.problem.t_span[0] + np.linspace(0.01, 1.49, 23)
    at_steps = errors(scene, subject.solved(scene, **request))
    between = errors(scene, subject.solved(scene, **at(request, times)))
    bound = subject.bound(request, scene.problem)
    for which in ("q", "v"):
        most = max(10 * at_steps[which], bound / 10)
        text = f"the error of {which} is {between[which]:.1e} at rows and {at_steps[which]:.1e} at steps"
        expect(between[which] <= most, text)


@claim("output/dense")
def dense_output_meets_the_steps(subject: Subject) -> None:
    """Dense output meets the steps it was made of, is right between them, and refuses times outside."""
    scene, request = subject.case("position", 1)
    solution = subject.solve(scene.problem, **request, dense_output=True)
    if solution.interpolant is None:
        raise Declined(f"{subject.name} has no dense output")
    middle = (solution.t[1:] + solution.t[:-1]) / 2
    bound = 10 * subject.bound(request, scene.problem)
    for times, known in ((solution.t, solution.q), (middle, np.array([scene.exact(float(t)).q for t in middle]))):
        off = float(np.max(np.abs(solution(times).q - known)))
        limit = 1e-9 if times is solution.t else bound
        expect(off <= limit, f"dense output is off by {off:.1e}; expected {limit:.1e} at most")
    try:
        beyond = solution(scene.problem.t_span[1] + 1.0)
    except ValueError:
        return
    expect(not np.isfinite(beyond.q).all(), "dense output a second after the end gives numbers instead of a refusal")


@claim("declines/says_why")
def declining_says_why(subject: Subject) -> None:
    """``accepts`` gives None or a reason, and what it declines ends as declined or is refused."""
    scene = subject.scene("position")
    for request in (Request(), Request(rtol=1e-3), Request(steps=10), Request(rtol=1e-3, options={"no_such_option": 1})):
        reason = subject.solver.accepts(scene.problem, request)
        expect(reason is None or (isinstance(reason, str) and reason.strip()), f"accepts returns {reason!r}")
        with contextlib.suppress(ValueError, TypeError):
            expect(
                reason is None or not subject.solver.solve(scene.problem, request).success,
                f"it declines ({reason}), and then solves",
            )
    expect(subject.ladder(scene.problem), "nothing is taken")


@claim("declines/unknown_option")
def unknown_options_are_named(subject: Subject) -> None:
    """An option that it does not know is declined by name."""
    scene = subject.scene("position")
    request = Request(**subject.ladder(scene.problem)[0], options={"no_such_option": 1})
    reason = subject.solver.accepts(scene.problem, request)
    expect(reason is not None and "no_such_option" in reason, f"no_such_option is taken, or not named: {reason!r}")


@claim("declines/without_calling")
def accepting_calls_nothing(subject: Subject) -> None:
    """``accepts`` calls no function of the system."""

    def force(t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        raise AssertionError("accepts calls the force")

    problem = numpy_pendulum(force=force).problem
    subject.solver.accepts(problem, Request(rtol=1e-3))
    subject.solver.accepts(problem, Request(steps=10))


@claim("name")
def has_a_name(subject: Subject) -> None:
    """A solver has a name, a word or a spec."""
    name = getattr(subject.solver, "name", None)
    expect(isinstance(name, str) and bool(name.strip()), f"name is {name!r}")


@claim("tolerance/absolute_alone")
def absolute_tolerances_alone(subject: Subject) -> None:
    """Absolute tolerances, one for each component, suffice where rtol is 0."""
    scene = subject.scene("position")
    request: dict[str, Any] = {"rtol": 0.0, "atol": np.full(6, 1e-4)}
    if reason := subject.takes(scene.problem, **request):
        raise Declined(reason)
    found = errors(scene, subject.succeeds(scene.problem, **request))
    bound = subject.bound({"rtol": 1e-4}, scene.problem) * 5
    expect(found["q"] <= bound, f"the error of q is {found['q']:.1e} at atol=1e-4; expected {bound:.1e} at most")


@claim("steps/count")
def prescribed_steps_are_taken(subject: Subject) -> None:
    """``steps=N`` takes N equal steps, ``step=h`` steps of h, ``steps=array`` these."""
    scene = subject.scene("position")
    lengths = np.array([0.3, 0.1, 0.2, 0.4, 0.5]) / 4
    asked: list[tuple[dict[str, Any], np.ndarray]] = [
        ({"steps": 30}, np.linspace(*scene.problem.t_span, 31)),
        ({"step": 0.05}, np.linspace(*scene.problem.t_span, 31)),
        ({"steps": np.tile(lengths, 4)}, np.concatenate([[0.0], np.cumsum(np.tile(lengths, 4))])),
    ]
    reasons = [subject.takes(scene.problem, **request) for request, _ in asked]
    if all(reasons):
        raise Declined(str(reasons[0]))
    for (request, times), reason in zip(asked, reasons, strict=True):
        if reason is None:
            solution = subject.succeeds(scene.problem, **request)
            good = solution.t.shape == times.shape and np.allclose(solution.t, times, rtol=0, atol=1e-12)
            expect(good, f"{request} gives {solution.t.size - 1} steps to {solution.t[-1]:.6g}, not {times.size - 1}")
