"""``solution(t)`` of the libraries: their own interpolant where it is asked for, or a plain word that there is none."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.result import Status
from tests.sample import slow

INTERPOLATE = (
    *("ida(form=ggl)", "ida(form=integrated)", "cvode(method=bdf)", "cvode(method=adams)", "collocation"),
    *("scipy(method=Radau)", "scipy(method=BDF)", "scipy(method=LSODA)", "scipy(method=DOP853)"),
    *("diffrax(method=Tsit5)", "diffrax(method=Dopri8)", "diffrax(method=Kvaerno5)"),
)
SPAN = (3.0, 4.0)


def swing(t_span=SPAN):
    pendulum = hb.load_problem("simple_pendulum")
    return hb.Problem(name="p", system=pendulum.system, t_span=t_span, q0=pendulum.q0, v0=pendulum.v0)


@pytest.mark.parametrize("t_span", [SPAN, SPAN[::-1]], ids=["forward", "backward"])
@pytest.mark.parametrize("solver", [slow(x) if "Kvaerno5" in x or "Dopri8" in x else x for x in INTERPOLATE])
def test_the_interpolant_is_as_the_library_has_it_and_changes_no_step(solver, t_span):
    """Between steps as accurate as its order lets it be: ten times the error at steps, and three tolerances."""
    problem, times = swing(t_span), np.linspace(*t_span, 201)
    plain, dense = (hb.solve(problem, solver, rtol=1e-6, dense_output=asked) for asked in (False, True))
    assert dense.status is Status.success
    assert dense.q.tobytes() == plain.q.tobytes()
    assert dense.counters.residual_evaluations == plain.counters.residual_evaluations
    at_steps = dense(dense.t)
    assert at_steps.q.tobytes() == dense.q.tobytes()
    assert at_steps.v.tobytes() == dense.v.tobytes()
    exact, exact_at_steps = (hb.solve(problem, "collocation", rtol=1e-12, t_eval=t) for t in (times, dense.t))
    for name in ("q", "v"):
        error = np.abs(getattr(dense(times), name) - getattr(exact, name)).max()
        at_ends = np.abs(getattr(dense, name) - getattr(exact_at_steps, name)).max()
        assert error < 10 * at_ends + 3e-6
    assert dense(times[7]).q.shape == (2,)
    assert dense(times[7]).q.tobytes() == dense(times[7:9]).q[0].tobytes()
    with pytest.raises(ProblemError, match="covers"):
        dense(max(t_span) + 1e-3)


@pytest.mark.parametrize(
    "solver", ["ida(form=ggl)", "ida(form=integrated)", "cvode", "scipy(method=Radau)", "diffrax", "minimal(solver=cvode)"]
)
@pytest.mark.parametrize("back", [False, True], ids=["forward", "backward"])
def test_ends_of_steps_beside_rows_are_those_of_a_run_with_output_at_every_step(solver, back):
    pendulum = hb.load_problem("simple_pendulum")
    t0, t1 = pendulum.t_span
    pendulum = replace(pendulum, t_span=(t0, t0 - (t1 - t0)) if back else (t0, t1))
    times = np.linspace(*pendulum.t_span, 7)
    every = hb.solve(pendulum, solver, rtol=1e-4)
    rows, both = (hb.solve(pendulum, solver, rtol=1e-4, t_eval=times, keep_steps=kept) for kept in (False, True))
    assert rows.ends is None
    for name in ("t", "q", "v"):
        assert getattr(both.ends, name).tobytes() == getattr(every, name).tobytes()
        assert getattr(both, name).tobytes() == getattr(rows, name).tobytes()
    assert (both.ends.carried is None) == (every.carried is None)
    for name in every.carried or {}:
        assert both.ends.carried[name].tobytes() == every.carried[name].tobytes()
    assert both.counters == rows.counters
    assert both.drift().t.size == every.t.size


@pytest.mark.parametrize("solver", ["collocation", "projected"])
def test_whose_steps_end_at_output_times_or_are_not_seen_tells_none(solver):
    found = hb.solve(swing(), solver, rtol=1e-4, t_eval=np.linspace(*SPAN, 7), keep_steps=True)
    assert found.success
    assert found.ends is None


@pytest.mark.parametrize("solver", ["cvode", "scipy(method=BDF)", "ida", "scipy(method=LSODA)"])
def test_rows_at_output_times_are_those_of_the_interpolant(solver):
    """Methods of many steps: both are the library's polynomial, which is sampled where the library keeps none."""
    times = np.linspace(*SPAN, 101)[1:-1]
    dense = hb.solve(swing(), solver, rtol=1e-6, dense_output=True)
    asked = hb.solve(swing(), solver, rtol=1e-6, t_eval=times)
    np.testing.assert_allclose(dense(times).q, asked.q, rtol=0, atol=1e-13)
    np.testing.assert_allclose(dense(times).v, asked.v, rtol=0, atol=1e-12)


@pytest.mark.parametrize("solver", ["cvode", "diffrax", "scipy(method=DOP853)"])
def test_neither_rows_nor_dense_output_hide_a_drift_unless_that_is_asked_for(solver):
    problem, times = swing(), np.linspace(*SPAN, 40)
    levels = ConstraintLevels(derive(problem.system, SPAN[0], problem.q0, problem.v0))
    solution = hb.solve(problem, solver, rtol=1e-4, t_eval=times, dense_output=True)

    def off(rows):
        return max(levels.at(float(t), q, v).scaled_position(1.0).max() for t, q, v in zip(times, *rows, strict=True))

    assert off((solution.q, solution.v)) > 1e-7
    assert off(solution(times)) > 1e-7
    assert off(solution(times, project=True)) < 1e-14


def test_a_dense_solution_survives_pickling():
    solution = hb.solve(swing(), "diffrax", rtol=1e-4, dense_output=True)
    again = pickle.loads(pickle.dumps(solution))
    assert again(3.3).q.tobytes() == solution(3.3).q.tobytes()


def test_what_dense_output_costs_is_work_for_output():
    plain, dense = (hb.solve(swing(), "scipy(method=DOP853)", rtol=1e-4, dense_output=x).counters for x in (False, True))
    assert dense.output_evaluations == plain.output_evaluations + 3 * dense.steps_accepted
    assert replace(dense, output_evaluations=0) == replace(plain, output_evaluations=0)


@pytest.mark.parametrize("solver", ["cvode", "projected"])
def test_without_dense_output_a_solution_says_how_to_get_it(solver):
    with pytest.raises(ValueError, match="dense_output=True"):
        hb.solve(swing(), solver, rtol=1e-4)(3.3)


def test_the_projected_methods_say_that_they_have_none():
    declined = hb.solve(swing(), "projected", rtol=1e-4, dense_output=True)
    assert declined.status is Status.declined
    assert "has no dense output" in declined.message
    assert "t_eval" in declined.message


def test_dense_output_is_a_switch():
    with pytest.raises(TypeError, match="dense_output must be True or False"):
        hb.solve(swing(), "cvode", rtol=1e-4, dense_output="yes")
