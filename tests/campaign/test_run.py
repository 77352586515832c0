"""One cell without a worker: what is asked of a solver, in which order, and what becomes of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from hhtbench import Counters, Ends, Motion, NumpySystem, Problem, Solution, Status, load_problem, load_solver
from hhtbench.campaign import run as module
from hhtbench.campaign.run import MEASURING, WARM_UP, attempt, call_of, request_of, run_cell
from hhtbench.lowering import operations
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.request import make_request
from hhtbench.solution.result import DenseOutput
from solvers import ida
from tests.adapters import scenes
from tests.adapters.liar import lying

ASKED = {"rtol": 1e-3, "atol": None, "step": None, "steps": None, "outputs": 5, "counting": True, "max_seconds": 9.0}
PROBLEM = Problem(
    name="line",
    system=NumpySystem(force=lambda t, q, v: 0 * q),
    t_span=(0.0, 1.0),
    q0=[0.0],
    v0=[1.0],
    exact=lambda t: Motion(np.array([t]), np.array([1.0]), np.zeros(0), np.zeros(0)),
)


class Line:
    """Solves the straight line, and keeps a diary."""

    name = "line"

    def __init__(self) -> None:
        self.diary: list[str] = []

    def accepts(self, problem: Any, request: Any) -> str | None:
        self.diary.append("accepts")
        return None

    def warm_up(self, problem: Any, request: Any) -> None:
        self.diary.append("warm_up")

    def count(self, problem: Any, request: Any) -> Counters:
        self.diary.append(f"count {request.t_eval.size}")
        return Counters(residual_evaluations=77)

    def solve(self, problem: Any, request: Any) -> Solution:
        t = np.linspace(0, 1, 31) if request.t_eval is None else request.t_eval
        self.diary.append(f"solve {t.size}")
        return line(t, counters=Counters(residual_evaluations=None))


def line(t: Any, **changes: Any) -> Solution:
    none = np.zeros((t.size, 0))
    values = {
        "q": t[:, None],
        "v": np.ones((t.size, 1)),
        "lam": none,
        "mu": none,
        "status": Status.success,
        "message": "done",
    }
    return Solution(t=t, **{**values, **changes})


def run(solver: Any, warm: Any = None, **changes: Any) -> dict[str, Any]:
    return run_cell(PROBLEM, solver, {**ASKED, **changes}, {} if warm is None else warm, lambda _: None)


def test_a_solver_is_warmed_once_then_solves_with_and_without_output_counts_and_shows_its_steps():
    solver, warm, phases = Line(), {}, []
    row = run_cell(PROBLEM, solver, ASKED, warm, phases.append)
    assert solver.diary == ["accepts", "warm_up", "solve 5", "solve 1", "count 1", "solve 31"]
    assert row["counters"]["residual_evaluations"] == 77
    assert row["metrics"]["drift"]["points"] == 31
    assert row["metrics"]["rows"] == 5
    assert phases[0] == WARM_UP
    solver.diary.clear()
    run(solver, warm)
    assert "warm_up" not in solver.diary


def test_without_counting_or_where_that_fails_the_counters_of_the_solve_stand(monkeypatch: pytest.MonkeyPatch):
    solver = Line()
    assert run(solver, counting=False)["counters"]["residual_evaluations"] is None
    assert "count 1" not in solver.diary
    monkeypatch.setattr(Line, "count", lambda *_: 1 / 0)
    row = run(Line())
    assert (row["status"], row["counters"]["residual_evaluations"]) == ("success", None)


@pytest.mark.parametrize(
    ("spec", "accuracy"),
    [
        ("ida(form=ggl)", {"rtol": 1e-6}),
        ("scipy(method=DOP853)", {"rtol": 1e-6}),
        ("hht", {"rtol": None, "steps": 40}),
        ("collocation", {"rtol": 1e-6}),
        ("diffrax(method=Tsit5)", {"rtol": 1e-6}),
    ],
)
def test_the_work_of_a_cell_does_not_depend_on_its_output_rows(spec: str, accuracy: dict[str, Any]):
    """DOP853 and Tsit5 reach rows inside their steps by evaluating more."""
    solver, scene, warm = load_solver(spec), scenes.problem(), {}
    few, many = (
        run_cell(scene, solver, {**ASKED, **accuracy, "outputs": outputs}, warm, lambda _: None) for outputs in (51, 501)
    )
    assert (few["status"], few["metrics"]["rows"], many["metrics"]["rows"]) == ("success", 51, 501)
    assert few["counters"] == many["counters"]
    assert few["counters"]["residual_evaluations"] > few["counters"]["steps_accepted"] > 2
    assert few["metrics"]["drift"] == many["metrics"]["drift"]


@pytest.mark.parametrize(
    ("spec", "evaluates"), [("hht", "residual"), ("cvode", "acceleration"), ("minimal(solver=cvode)", "acceleration")]
)
def test_a_row_tells_what_an_evaluation_costs(spec: str, evaluates: str):
    """Of minimal coordinates that of their own equations, beside the problem's residual."""
    pendulum = load_problem("simple_pendulum")
    found = call_of(pendulum, load_solver(spec))
    assert found is not None
    own = operations(pendulum.system, 0.0, pendulum.q0, pendulum.v0)
    assert (found["evaluates"], found["of_residual"]) == (evaluates, own["residual"])
    coordinates = pendulum.minimal()
    there = operations(coordinates.system, 0.0, coordinates.s0, coordinates.u0) if spec.startswith("minimal") else own
    assert found["operations"] == there[evaluates]


@pytest.mark.parametrize(
    "evaluates", [None, lambda problem: 1 / 0, lambda problem: "residual", lambda problem: ("both", problem)]
)
def test_a_solver_that_does_not_tell_what_it_evaluates_is_taken_to_need_accelerations(evaluates: Any):
    solver = Line()
    if evaluates is not None:
        solver.evaluates = evaluates  # type: ignore[attr-defined]
    found = call_of(load_problem("simple_pendulum"), solver)
    assert found is not None
    assert found["operations"] > found["of_residual"]


def test_of_plain_callables_calls_count_as_they_are():
    assert run(Line())["metrics"]["call"] is None


class Telling(Line):
    """The same with the ends of its steps."""

    def solve(self, problem: Any, request: Any) -> Solution:
        t = np.linspace(0, 1, 41)
        ends = Ends(t=t, q=t[:, None], v=np.ones((41, 1))) if request.keep_steps else None
        return replace(super().solve(problem, request), ends=ends)


class Thinned(Line):
    """Dense output through some of its steps only."""

    def solve(self, problem: Any, request: Any) -> Solution:
        found = super().solve(problem, request)
        mesh = Mesh(np.linspace(0, 1, 7))
        return replace(found, interpolant=mesh, counters=Counters(residual_evaluations=None, steps_accepted=30))


@dataclass(frozen=True)
class Mesh:
    """The straight line, through ``t``."""

    t: Any

    def __call__(self, t: Any) -> DenseOutput:
        return DenseOutput(np.array(t)[:, None], np.ones((np.size(t), 1)))


@pytest.mark.parametrize(("solver", "solves"), [(Line(), 3), (Telling(), 2), (Thinned(), 3)])
def test_whoever_tells_the_ends_of_steps_is_not_solved_once_more_for_them(solver: Line, solves: int):
    row = run(solver)
    assert row["status"] == "success"
    assert sum(entry.startswith("solve") for entry in solver.diary) == solves
    drift = row["metrics"]["drift"]
    assert (drift["sampled"], drift["points"]) == ("steps", 31 if solves == 3 else 41)


@pytest.mark.parametrize("broken", [None, ZeroDivisionError("no"), SystemExit(3)])
def test_a_row_holds_sizes_and_tags_of_its_problem_as_far_as_they_can_be_told(
    monkeypatch: pytest.MonkeyPatch, broken: BaseException | None
):
    def constraint(t: float, q: Any) -> Any:
        if broken is not None:
            raise broken
        return q[:1]

    def fails(*_: Any) -> Solution:
        raise RuntimeError("no")

    monkeypatch.setattr(Line, "solve", fails)
    system = NumpySystem(force=lambda t, q, v: 0 * q, constraint=constraint)
    problem = Problem(name="held", system=system, t_span=(0.0, 1.0), q0=[0.0, 1.0], v0=[0.0, 1.0], tags=("stiff",))
    row = run_cell(problem, Line(), ASKED, {}, lambda _: None)
    sizes = {"m": 1, "p": 0} if broken is None else {"m": None, "p": None}
    assert row["metrics"] == {"system": {"n": 2, **sizes, "tags": ["stiff"]}, "call": None}
    assert "metrics" not in run_cell(problem, Declines(), ASKED, {}, lambda _: None)


def test_the_functions_of_a_problem_may_be_traced_for_its_sizes_for_as_long_as_a_measurement_may_take(
    monkeypatch: pytest.MonkeyPatch,
):
    phases: list[str] = []
    found: list[str] = []
    monkeypatch.setattr(module, "system_of", lambda problem: found.append(phases[-1]) or {})
    run_cell(PROBLEM, Line(), ASKED, {}, phases.append)
    assert found == [MEASURING]


class Declines(Line):
    def accepts(self, *_: Any) -> str:
        return "never"


def test_a_solve_that_fails_without_output_is_not_reported_as_a_success(monkeypatch: pytest.MonkeyPatch):
    def fails_alone(self: Any, problem: Any, request: Any) -> Solution:
        if request.t_eval is not None and request.t_eval.size == 1:
            return line(np.array([0.0, 0.5]), status=Status.newton_failed, message="no way")
        return line(np.linspace(0, 1, 31) if request.t_eval is None else request.t_eval)

    monkeypatch.setattr(Line, "solve", fails_alone)
    row = run(Line())
    assert (row["status"], row["metrics"]["rows"]) == ("newton_failed", 5)
    assert row["message"] == "no way (without output on the way)"


def test_time_that_was_up_is_not_spent_again(monkeypatch: pytest.MonkeyPatch):
    solver = Line()

    def late(self: Any, problem: Any, request: Any) -> Solution:
        self.diary.append("solve")
        return line(np.array([0.0, 0.5]), status=Status.deadline, counters=Counters(residual_evaluations=9))

    monkeypatch.setattr(Line, "solve", late)
    row = run(solver)
    assert solver.diary == ["accepts", "warm_up", "solve"]
    assert (row["status"], row["counters"]["residual_evaluations"]) == ("deadline", 9)


def test_a_result_that_is_not_believed_keeps_its_rows_errors_and_drift(monkeypatch: pytest.MonkeyPatch):
    """IDA that leaves the circle by a fifth: another mechanism, but how far off it is stays in the store."""
    monkeypatch.setattr(ida, "IDA", lying(ida.IDA, lambda result: setattr(result, "y", 1.2 * result.y)))
    row = run_cell(scenes.problem(), load_solver("ida"), {**ASKED, "outputs": 51}, {}, lambda _: None)
    assert row["status"] == "unreliable"
    assert row["metrics"]["rows"] == 51
    assert row["metrics"]["errors"]["q"]["max"] == pytest.approx(0.2, rel=0.1)
    assert row["metrics"]["drift"]["sampled"] == "steps"
    assert row["metrics"]["drift"]["position_absolute"] == pytest.approx(0.22, rel=0.01)
    assert row["counters"]["steps_accepted"] > 4


def test_what_was_reached_before_an_exception_is_measured(monkeypatch: pytest.MonkeyPatch):
    def breaks(self: Any, problem: Any, request: Any) -> Solution:
        error = ZeroDivisionError("in the force")
        error.partial_solution = line(np.array([0.0, 0.5]), status=Status.user_exception)  # type: ignore[attr-defined]
        raise error

    monkeypatch.setattr(Line, "solve", breaks)
    row = run(Line())
    assert row["status"] == "user_exception"
    assert row["message"].startswith("ZeroDivisionError: in the force (raised in test_run.py")
    assert row["metrics"]["reached"] == 0.5
    assert row["metrics"]["errors"]["q"]["max"] == 0.0


@pytest.mark.parametrize(
    ("raised", "status"),
    [
        (MemoryError("none"), "out_of_memory"),
        (RuntimeError("RESOURCE_EXHAUSTED: Out of memory allocating"), "out_of_memory"),
        (ProblemError("not this"), "declined"),
        (SystemExit(3), "user_exception"),
    ],
)
def test_what_a_solver_raises_becomes_a_status(monkeypatch: pytest.MonkeyPatch, raised: BaseException, status: str):
    def raises(*_: Any) -> Solution:
        raise raised

    monkeypatch.setattr(Line, "solve", raises)
    assert run(Line())["status"] == status


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        (None, "returned NoneType"),
        (line(np.array([0.0, 1.0]), v=np.ones((1, 1))), "shapes: v must be (2, 1)"),
    ],
)
def test_a_success_that_cannot_be_one_is_unreliable(monkeypatch: pytest.MonkeyPatch, returned: Any, said: str):
    monkeypatch.setattr(Line, "solve", lambda *_: returned)
    row = run(Line())
    assert row["status"] == "unreliable"
    assert said in row["message"]


def test_output_times_are_even_and_hold_those_of_the_reference():
    reference = {"t": [0.3, 1.0, 7.0]}
    forward = Problem(**{**vars(PROBLEM), "reference": reference})
    assert request_of(forward, ASKED).t_eval.tolist() == [0.0, 0.25, 0.3, 0.5, 0.75, 1.0]
    backward = Problem(**{**vars(PROBLEM), "t_span": (1.0, 0.0), "reference": reference})
    assert request_of(backward, ASKED).t_eval.tolist() == [1.0, 0.75, 0.5, 0.3, 0.25, 0.0]


@pytest.mark.parametrize("origin", [0.0, 1e9])
def test_times_of_outputs_and_references_one_rounding_error_apart_are_one(origin: float):
    """0.1 * 3 and 0.3 are one ulp apart: no solver can step from one to the other."""
    start, end = origin, origin + 1.0
    third = float(np.linspace(start, end, 11)[3])
    reference = {"t": [np.nextafter(third, np.inf), np.nextafter(end, start)]}
    problem = Problem(**{**vars(PROBLEM), "t_span": (start, end), "reference": reference})
    times = request_of(problem, {**ASKED, "outputs": 11}).t_eval
    assert times.size == 11
    assert reference["t"][0] in times
    assert times[-1] == end
    assert np.diff(times).min() > 0.05


class Straight:
    """Goes on as it has started, whatever pulls."""

    name = "straight"

    def accepts(self, problem: Any, request: Any) -> str | None:
        return None

    def solve(self, problem: Any, request: Any) -> Solution:
        t = np.linspace(*problem.t_span, 31) if request.t_eval is None else request.t_eval
        q = problem.q0 + (t - problem.t_span[0])[:, None] * problem.v0
        return line(t, q=q, v=np.repeat(problem.v0[None], t.size, axis=0))


def test_a_plugin_that_returns_a_straight_line_is_not_believed():
    """The falling weight of unit acceleration, and the same without weight, which does go straight on."""
    fall = Problem(**{**vars(PROBLEM), "system": NumpySystem(force=lambda t, q, v: 0 * q - 1.0), "exact": None})
    row = run_cell(fall, Straight(), ASKED, {}, lambda _: None)
    assert row["status"] == "unreliable"
    assert row["message"].startswith("equations of motion: from the row at t = ")
    assert row["metrics"]["trust"]["motion"] > 1.0
    free = run(Straight())
    assert free["status"] == "success"
    assert "Equations of motion not judged: " in free["message"]


def test_a_plugin_may_not_do_less_where_nobody_looks(monkeypatch: pytest.MonkeyPatch):
    def idle_alone(self: Any, problem: Any, request: Any) -> Solution:
        t = np.linspace(0, 1, 31) if request.t_eval is None else request.t_eval
        return line(t) if t.size > 1 else line(t, q=np.zeros((1, 1)))

    monkeypatch.setattr(Line, "solve", idle_alone)
    row = run(Line())
    assert (row["status"], row["message"].partition(":")[0]) == ("unreliable", "repetition")


def test_an_event_that_nobody_asked_for_and_an_answer_that_is_no_text_are_not_believed(monkeypatch: pytest.MonkeyPatch):
    ended = replace(line(np.array([0.0])), status=Status.event, t_events=(np.zeros(1),))
    for told in (lambda t: ended, lambda t: line(t, t_events=(t,))):
        monkeypatch.setattr(Line, "solve", lambda self, problem, request, told=told: told(request.t_eval))
        assert run_cell(PROBLEM, Line(), ASKED, {}, lambda _: None)["message"].startswith("end: an event is reported")
    monkeypatch.setattr(Line, "accepts", lambda self, problem, request: True)
    row = run_cell(PROBLEM, Line(), ASKED, {}, lambda _: None)
    assert (row["status"], row["message"][:8]) == ("unreliable", "accepts:")


def test_ctrl_c_in_the_main_process_is_no_solvers_failure():
    class Interrupted:
        name = "interrupted"

        def accepts(self, problem, request):
            return None

        def solve(self, problem, request):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        attempt(load_problem("knife_edge"), Interrupted(), make_request(rtol=1e-3))
