"""The equations of motion between rows: honest solves are believed, motions of nothing are not."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hhtbench import Counters, Ends, NumpySystem, Problem, Request, Solution, Status, load_problem, load_solver
from hhtbench.checks.result.between import stand_out
from hhtbench.checks.result.judge import Judgement, judge
from hhtbench.checks.result.success import too_few
from tests.sample import slow
from tests.trust.faulty import MOTIONS, Faulty

PROBLEMS = ("simple_pendulum", "knife_edge", "jay_negrut_test1")
HONEST = {  # solvers that take the problem
    "simple_pendulum": ("hht", "ida(form=ggl)", "projected(method=RK23)"),
    "andrews": ("hht", "ida(form=ggl)", "projected(method=RK23)"),
    "knife_edge": ("hht", "cvode(form=ode, method=adams)"),
    "jay_negrut_test1": ("hht", "ida(form=index1)"),
    "redundant_pendulum": ("hht", "ida(form=ggl)"),
    "stiff_spring_pendulum": ("hht", "scipy(method=Radau)"),
}


def judged(problem: Problem, solver: Any, **asked: Any) -> Judgement:
    """The solve with 51 rows, and its own steps."""
    request = Request(t_eval=np.linspace(*problem.t_span, 51), **asked)
    rows = solver.solve(problem, request)
    every = solver.solve(problem, replace(request, t_eval=None))
    assert rows.success and every.success
    return judge(problem, request, replace(rows, ends=Ends(t=every.t, q=every.q, v=every.v)))


TIGHTNESSES = (1e-2, 1e-4, 1e-8)
ASKED = [(name, solver, rtol) for name in HONEST for solver in HONEST[name] for rtol in TIGHTNESSES]
ASKED.remove(("redundant_pendulum", "hht", 1e-8))  # so many steps of second order take a fifth of this file's time


@pytest.mark.parametrize(("name", "solver", "rtol"), ASKED)
def test_honest_solves_are_believed_and_tight_ones_judged(name: str, solver: str, rtol: float):
    found = judged(load_problem(name), load_solver(solver), rtol=rtol)
    assert found.doubt == ""
    if rtol <= 1e-4:
        assert found.not_judged == ""
        assert found.metrics()["windows"] > 0
        assert found.metrics()["motion"] < 1.0


@pytest.mark.parametrize("name", PROBLEMS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_motion_of_something_else_is_found(name: str, motion: str):
    problem = load_problem(name)
    found = judged(problem, Faulty(motion), rtol=1e-6)
    assert found.doubt.partition(":")[0] in ("equations of motion", "constraints", "start")


@pytest.mark.parametrize("motion", ["straight line", "frozen", "without reaction", "stopped half-way"])
def test_what_knows_of_no_force_is_found_at_any_tolerance(motion: str):
    found = judged(load_problem("simple_pendulum"), Faulty(motion), rtol=1e-2)
    assert found.doubt


@pytest.mark.parametrize(("name", "steps"), [("simple_pendulum", 200), ("simple_pendulum", 2000), ("andrews", 2000)])
def test_constant_steps_set_the_measure_themselves(name: str, steps: int):
    problem = load_problem(name)
    for solver in ("hht", "generalised_alpha", "hht_i3"):
        found = judged(problem, load_solver(solver), steps=steps)
        assert (found.doubt, found.not_judged) == ("", "")
    assert judged(problem, Faulty("other force"), steps=2000).doubt


def begun(force: Any) -> Problem:
    """A bead on a line that rests until t = 1 s, when a ``force`` of the time since begins."""
    return Problem(
        name="begun",
        system=NumpySystem(
            force=lambda t, q, v: np.array([force(t - 1.0) if t > 1.0 else 0.0, 0.0]), constraint=lambda t, q: q[1:]
        ),
        t_span=(0.0, 3.0),
        q0=[0.0, 0.0],
        v0=[0.0, 0.0],
    )


LATE = {"smooth": lambda t: 20 * np.sin(5 * t) ** 3, "sudden": lambda t: 20.0}


@pytest.mark.parametrize(
    ("force", "solver", "steps"),
    [
        *(("smooth", "hht", 100), slow("smooth", "generalised_alpha", 397), slow("smooth", "rattle", 100)),
        *(slow("sudden", "hht", 397), ("sudden", "generalised_alpha", 100), ("sudden", "rattle", 397)),
    ],
)
def test_constant_steps_may_be_off_where_the_force_begins_later(force: str, solver: str, steps: int):
    assert judged(begun(LATE[force]), load_solver(solver), steps=steps).doubt == ""


@pytest.mark.parametrize("force", LATE)
def test_a_force_that_begins_later_may_not_be_another(force: str):
    assert judged(begun(LATE[force]), Faulty("other force"), steps=397).doubt.startswith("equations of motion: ")


FALL = Problem(name="fall", system=NumpySystem(force=lambda t, q, v: 0 * q - 9.81), t_span=(0.0, 1.0), q0=[1.0], v0=[0.0])


def fall(t: np.ndarray, g: float = 9.81, **changes: Any) -> Solution:
    none = np.zeros((t.size, 0))
    true: dict[str, Any] = {"t": t, "q": 1 - g * t[:, None] ** 2 / 2, "v": -g * t[:, None], "lam": none, "mu": none}
    return Solution(**{**true, "status": Status.success, "message": "there", **changes})


def test_neither_rows_nor_steps_may_be_wrong_alone():
    """Steps of another gravity beside true rows, and the other way round; a plugin without forces of its own at all."""
    t, ends = np.linspace(0.0, 1.0, 11), np.linspace(0.0, 1.0, 40)
    request, true, other = Request(rtol=1e-6, t_eval=t), fall(t), fall(t, g=9.7)
    true_steps, other_steps = (Ends(t=ends, q=one.q, v=one.v) for one in (fall(ends), fall(ends, 9.7)))
    assert judge(FALL, request, replace(true, ends=true_steps)).doubt == ""
    assert judge(FALL, request, replace(true, ends=other_steps)).doubt.startswith("equations of motion: ")
    assert judge(FALL, request, replace(other, ends=true_steps)).doubt.startswith("equations of motion: ")


def test_one_wrong_row_at_the_end_is_found():
    t = np.linspace(0.0, 1.0, 11)
    q = fall(t).q.copy()
    q[-1] = q[-2]
    request = Request(rtol=1e-6, t_eval=t)
    assert "to the row at t = 1:" in judge(FALL, request, fall(t, q=q)).doubt


def test_events_may_change_the_state_between_windows():
    """A ball that bounces at 0.4 s: rows before and after are judged, the jump is not."""
    t = np.linspace(0.0, 1.0, 501)
    before, after, at = t < 0.4, t >= 0.4, 0.4
    q, v = fall(t).q.copy(), fall(t).v.copy()
    v[after, 0] = 9.81 * 0.4 - 9.81 * (t[after] - at)
    q[after, 0] = 1 - 9.81 * at**2 / 2 + 9.81 * 0.4 * (t[after] - at) - 9.81 * (t[after] - at) ** 2 / 2
    request, bounced = Request(rtol=1e-6, t_eval=t), fall(t, q=q, v=v)
    assert before.any()
    assert judge(FALL, request, bounced).doubt
    assert judge(FALL, request, replace(bounced, t_events=(np.array([at]),))).doubt == ""


def test_what_cannot_be_judged_is_said_with_the_reason():
    free = Problem(name="free", system=NumpySystem(force=lambda t, q, v: 0 * q), t_span=(0.0, 1.0), q0=[0.0], v0=[1.0])
    t = np.linspace(0.0, 1.0, 11)
    line = fall(t, q=t[:, None], v=np.ones((11, 1)))
    assert "too close to a straight line" in judge(free, Request(rtol=1e-4, t_eval=t), line).not_judged
    assert "steps are too few" in judge(FALL, Request(steps=4, t_eval=t), fall(t)).not_judged
    assert "neither tolerances nor steps" in judge(FALL, Request(t_eval=t), fall(t)).not_judged
    broken = replace(FALL, system=NumpySystem(force=lambda t, q, v: 0 * q / (t - 0.5)))
    found = judge(broken, Request(rtol=1e-4, t_eval=t), line)
    assert found.doubt or found.not_judged


def test_multipliers_need_a_column_for_each_constraint():
    pendulum = load_problem("simple_pendulum")
    made = load_solver("hht").solve(pendulum, Request(rtol=1e-3))
    wrong = replace(made, lam=np.zeros((made.t.size, 3)))
    assert judge(pendulum, Request(rtol=1e-3), wrong).doubt.startswith("shapes: lam has 3 columns")


def swing(rows: np.ndarray) -> Judgement:
    """The pendulum by 401 rows: those with these numbers of a longer motion."""
    problem = load_problem("simple_pendulum")
    t0, t1 = problem.t_span
    t = t0 + np.arange(411) * (t1 - t0) / 400
    longer = replace(problem, t_span=(t0, float(t[-1])))
    made = load_solver("projected").solve(longer, Request(t_eval=t, rtol=1e-6))
    request = Request(t_eval=np.append(t[:400], t1), rtol=1e-6)
    return judge(problem, request, replace(made, t=request.t_eval, **{x: getattr(made, x)[rows] for x in PARTS}))


PARTS = ("q", "v", "lam", "mu")
AS_THEY_ARE = np.arange(401)
FROZEN = np.where((AS_THEY_ARE > 123) & (AS_THEY_ARE < 141), 123, AS_THEY_ARE)  # then it goes on as if nothing had been
LEAPS = np.where(AS_THEY_ARE < 217, AS_THEY_ARE, AS_THEY_ARE + 2)  # from there on it is two rows ahead


@pytest.mark.parametrize("rows", [FROZEN, LEAPS], ids=["frozen", "leaps"])
def test_rows_that_freeze_or_leap_anywhere_among_hundreds_are_found(rows: np.ndarray):
    assert swing(AS_THEY_ARE).doubt == ""
    assert swing(rows).doubt.startswith("equations of motion: ")


@pytest.mark.parametrize(("factor", "rtol"), [(0.0, 1e-3), (-1.0, 1e-3), (2.0, 1e-3), (1.012, 1e-6), (1.0012, 1e-8)])
@pytest.mark.parametrize("name", ["simple_pendulum", "redundant_pendulum", "andrews"])
def test_multipliers_that_do_not_make_the_accelerations_are_found(name: str, factor: float, rtol: float):
    problem = load_problem(name)
    request = Request(t_eval=np.linspace(*problem.t_span, 51), rtol=rtol)
    made = load_solver("ida(form=ggl)").solve(problem, request)
    assert judge(problem, request, made).doubt == ""
    assert judge(problem, request, replace(made, lam=factor * made.lam)).doubt.startswith("multipliers: ")


@pytest.mark.parametrize(
    ("rows", "factor"),
    [(slice(20, 30), 0.0), (slice(25, 26), 1e9), (slice(-1, None), 0.0)],
    ids=["ten rows", "one row", "last row"],
)
def test_multipliers_of_any_row_are_looked_at(rows: slice, factor: float):
    problem = load_problem("simple_pendulum")
    request = Request(t_eval=np.linspace(*problem.t_span, 51), rtol=1e-6)
    made = load_solver("projected").solve(problem, request)
    lam = made.lam.copy()
    lam[rows] *= factor
    for draw in range(5):
        assert judge(problem, request, made, draw=draw).doubt == ""
        assert judge(problem, request, replace(made, lam=lam), draw=draw).doubt.startswith("multipliers: ")


@pytest.mark.parametrize("asked", [{"rtol": 1e-2}, {"rtol": 1e-4}, {"rtol": 1e-8}, {"steps": 400}, {"steps": 4000}], ids=str)
@pytest.mark.parametrize("name", ["simple_pendulum", "knife_edge", "jay_negrut_test1"])
def test_multipliers_may_be_those_of_the_step_before(name: str, asked: dict[str, Any]):
    problem = load_problem(name)
    made = load_solver("hht").solve(problem, Request(**asked))
    lam, mu = (np.concatenate([x[:1], x[:-1]]) for x in (made.lam, made.mu))
    assert judge(problem, Request(**asked), replace(made, lam=lam, mu=mu)).doubt == ""


def test_the_same_draw_looks_at_the_same_rows_and_another_at_others():
    problem = load_problem("simple_pendulum")
    request = Request(t_eval=np.linspace(*problem.t_span, 401), rtol=1e-6)
    made = load_solver("projected").solve(problem, request)
    starts = [{window.start for window in judge(problem, request, made, draw=draw).windows} for draw in (3, 3, 4)]
    assert starts[0] == starts[1] != starts[2]


def bumped(made: Solution) -> Solution:
    """A pendulum that is ahead by up to 0.05 rad around 2.5 s, with the velocities of that, and accelerations of nothing."""
    s = np.clip((made.t - 2.5) / 0.5, -1.0, 1.0)
    angle = np.arctan2(made.q[:, 1], made.q[:, 0]) + 0.05 * (1 - s**2) ** 4
    rate = made.q[:, 0] * made.v[:, 1] - made.q[:, 1] * made.v[:, 0] - 0.8 * s * (1 - s**2) ** 3
    q = np.column_stack([np.cos(angle), np.sin(angle)])
    return replace(made, q=q, v=rate[:, None] * np.column_stack([-q[:, 1], q[:, 0]]))


def test_velocities_that_fit_a_wrong_motion_in_the_middle_do_not_hide_it():
    problem = replace(load_problem("simple_pendulum"), t_span=(0.0, 5.0))
    request = Request(rtol=1e-6, t_eval=np.linspace(0.0, 5.0, 401))
    made = load_solver("projected").solve(problem, request)
    for draw in range(5):
        assert judge(problem, request, made, draw=draw).doubt == ""
        assert judge(problem, request, bumped(made), draw=draw).doubt.startswith("equations of motion: ")


def test_an_honest_rest_before_does_not_hide_rows_that_stand_still():
    """A fall at whose beginning ten rows creep; later a row is given twice."""
    t = np.linspace(0.0, 1.0, 401)
    q, v = fall(t).q, fall(t).v
    q[:10], v[:10] = 1e-8 * t[:10, None], 1e-8
    q[301], v[301] = q[300], v[300]
    found = stand_out(Ends(t=t, q=q, v=v), np.ones(2))
    assert {0, 300} <= set(found)


def test_ends_of_steps_must_fit_the_rows():
    """Whoever tells steps tells them from the start to the last row, in order, finite, in the shapes of the rows."""
    t, ends = np.linspace(0.0, 1.0, 11), fall(np.linspace(0.0, 1.0, 41))
    request = Request(rtol=1e-6, t_eval=t)
    told = {"t": ends.t, "q": ends.q, "v": ends.v}
    cut = {name: value[:20] for name, value in told.items()}
    many = Counters(steps_accepted=100, residual_evaluations=None)
    assert judge(FALL, request, fall(t, ends=(1, 2, 3))).doubt == "type: ends must be an Ends; it is tuple."
    assert judge(FALL, request, fall(t, ends=Ends(**told), counters=many)).doubt.startswith("ends of steps: 41 are reported")
    past = {name: np.concatenate([value, value[-1:]]) for name, value in told.items()}
    past["t"][-1] = 1.1
    far = {**told, "t": 1e17 + 0 * ends.t}  # rounded to one
    assert not too_few(Ends(**far), many)
    wrong = [
        ({"t": [0.0, [1.0]]}, "shapes"),
        ({"q": ends.q[:, 0]}, "shapes"),
        ({"t": ends.t[::-1]}, "order"),
        ({"v": np.inf * ends.v}, "finiteness"),
    ]
    assert judge(FALL, request, fall(t, ends=Ends(**told))).doubt == ""
    for changed, check in [*wrong, (cut, "ends of steps"), (past, "ends of steps"), ({"q": ends.q + 1.0}, "start")]:
        assert judge(FALL, request, fall(t, ends=Ends(**told | changed))).doubt.startswith(f"{check}")


def test_a_leap_in_the_midst_of_many_steps_is_found():
    ends = np.linspace(0.0, 1.0, 3001)
    t = np.linspace(0.0, 1.0, 11)
    one = fall(ends, q=fall(ends).q + 0.01 * (ends > ends[1000])[:, None])
    found = judge(FALL, Request(rtol=1e-6, t_eval=t), fall(t, ends=Ends(t=ends, q=one.q, v=one.v)))
    assert found.doubt.startswith("equations of motion: ")


@pytest.mark.parametrize("solver", ["hht", "generalised_alpha"])
def test_constant_steps_may_be_off_where_the_force_jumps_at_a_row(solver: str):
    """A brake that pulls as soon as the time is not that of the start."""
    system = NumpySystem(force=lambda t, q, v: 0 * q - (9.81 if t > 0.0 else 0.0))
    assert judged(replace(FALL, system=system), load_solver(solver), steps=1000).doubt == ""
