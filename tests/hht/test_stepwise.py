"""Stepping by hand as SUNDIALS offers it: one step, up to a time, never past one, between steps."""

import signal

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.events import Event
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.event_scenes import ACCURACY, FREE, begun, clock, height, wall
from tests.hht.scenes import (
    ALPHAS,
    PENDULUM,
    Q0,
    SYSTEMS,
    V0,
    Pendulum,
    bits,
    pendulum,
    pendulum_at,
)


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize("end", [0.7, -0.7])
def test_steps_under_error_control_are_those_of_solve(route, alpha, end):
    solution = HHT(SYSTEMS[route], alpha=alpha, events=wall()).solve((0.0, end), Q0, V0, rtol=1e-4)
    solver = begun(SYSTEMS[route], "controlled", alpha=alpha, events=wall())
    times, changes = [0.0], 0
    while solver.state.t != end:
        assert solver.step(tstop=end) is Status.success
        changes += len(solver.occurrences)
        times += [solver.state.t] * (1 + len(solver.occurrences))
        assert solver.state.q.tobytes() == solution.q[len(times) - 1].tobytes()
        assert solver.state.v.tobytes() == solution.v[len(times) - 1].tobytes()
    assert np.array_equal(times, solution.t)
    assert changes == solution.t_events[0].size
    counted = {
        name: getattr(solver.counters, name) for name in ("steps_accepted", "newton_iterations", "residual_evaluations")
    }
    assert counted == {name: getattr(solution.counters, name) for name in counted}


@pytest.mark.parametrize("accuracy", ACCURACY)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_normal_steps_reach_a_time_and_the_last_step_holds_it(accuracy, sign):
    solver = HHT(SYSTEMS["jax"])
    how = {"step": sign * 0.01} if accuracy == "constant" else ACCURACY[accuracy]
    solver.init_step(0.0, Q0, V0, **how)
    asked = sign * np.array([0.1234, 0.1235, 0.35, 0.6])
    q, v = pendulum_at(asked)
    for i, t in enumerate(asked):
        before = solver.state.t
        assert solver.step(t, "normal") is Status.success
        assert sign * solver.state.t >= sign * t
        found = solver.interpolate(t)
        assert np.max(np.abs(found.q - q[i])) < 2e-4
        assert np.max(np.abs(found.v - v[i])) < 1e-3
        if i == 1:
            assert solver.state.t == before  # it lies within the last step: none is taken
    assert np.array_equal(solver.interpolate(solver.state.t).q, solver.state.q)
    with pytest.raises(hb.ProblemError, match="covers"):
        solver.interpolate(asked[0])


@pytest.mark.parametrize("accuracy", ACCURACY)
def test_where_output_is_asked_for_changes_no_step(accuracy):
    ends = []
    for asked in ([0.01, 1.0], np.linspace(0.01, 1.0, 34)):  # the first time is the horizon of the first step
        solver = begun(accuracy=accuracy, events=wall())
        for t in asked:
            solver.step(t, "normal")
        ends.append(bits(solver.state))
    assert ends[0] == ends[1]


@pytest.mark.parametrize("accuracy", ACCURACY)
@pytest.mark.parametrize("method", ["onestep", "normal"])
def test_no_step_goes_past_tstop_and_one_ends_there(accuracy, method):
    solver = begun(accuracy=accuracy)
    t = None if method == "onestep" else 9.0
    while solver.state.t < 0.1234:
        assert solver.step(t, method, tstop=0.1234) is Status.success
        assert solver.state.t <= 0.1234
    assert solver.state.t == 0.1234
    with pytest.raises(hb.ProblemError, match="tstop must lie ahead"):
        solver.step(tstop=0.1234)
    assert solver.step(tstop=0.2) is Status.success
    q, _ = pendulum_at([solver.state.t])
    assert np.max(np.abs(solver.state.q - q)) < 1e-4


@pytest.mark.parametrize("accuracy", ACCURACY)
def test_a_terminal_event_returns_its_status_and_stepping_goes_on(accuracy):
    level = Event(lambda t, q, v: q[0] - 0.8, terminal=True, name="level")
    solver = begun(accuracy=accuracy, events=[level, height])
    assert solver.step(5.0, "normal") is Status.event
    assert "'level'" in solver.message
    assert [o.name for o in solver.occurrences] == ["level"]
    assert solver.occurrences[0].t == solver.state.t
    assert abs(solver.state.q[0] - 0.8) < 1e-15
    q, v = pendulum_at([solver.state.t])
    assert np.max(np.abs(solver.state.q - q)) < 3e-4
    first, length = solver.state.t, abs(solver.state.h)
    assert solver.step() is Status.success
    assert solver.state.h >= 0.5 * length  # the steps go on as they were
    assert solver.step(first + 0.2, "normal") is Status.success
    assert solver.message == ""
    assert solver.step(5.0, "normal") is Status.event  # the swing back
    assert solver.occurrences[0].name == "height"
    q, v = pendulum_at([solver.state.t])
    assert np.max(np.abs(solver.state.v - v)) < 1e-2


def test_a_change_by_hand_gives_both_sides_of_the_last_step():
    solver = begun(FREE, q0=[1.0], v0=[0.0], events=clock(0.015, change=lambda t, q, v: (q + 1.0, v)))
    solver.step()
    assert solver.step() is Status.success
    assert solver.state.t == 0.015
    assert solver.state.q[0] == solver.interpolate(0.015).q[0] == pytest.approx(2.0, abs=2e-3)
    assert solver.interpolate(0.0149).q[0] == pytest.approx(1.0, abs=2e-3)
    assert solver.occurrences[0].q[0] == pytest.approx(1.0, abs=2e-3)


def test_steps_by_hand_without_a_step_or_tolerances_take_plain_accuracy_and_say_so():
    told, asked = HHT(SYSTEMS["jax"]), HHT(SYSTEMS["jax"])
    assert told.init_step(0.0, Q0, V0) is asked.init_step(0.0, Q0, V0, rtol=1e-4) is Status.success
    assert told.message == "No tolerance was given: rtol = 0.0001 was taken."
    assert told.step(1.0) is asked.step(1.0) is Status.success
    assert bits(told.state) == bits(asked.state)


@pytest.mark.parametrize("accuracy", ACCURACY)
def test_wrong_use_of_step_is_refused_and_the_state_stays(accuracy):
    solver = HHT(SYSTEMS["jax"])
    for call in (solver.step, solver.checkpoint, lambda: solver.state, lambda: solver.interpolate(0.0)):
        with pytest.raises(hb.ProblemError, match="init_step"):
            call()
    solver = begun(accuracy=accuracy)
    solver.step(1.0)
    solver.step()
    before = bits(solver.state)
    for arguments, text in (
        ({"method": "twice"}, "method"),
        ({"method": "normal"}, "give t"),
        ({"t": -1.0, "method": "normal"}, "behind"),
        ({"t": np.nan, "method": "normal"}, "t must be finite"),
        ({"tstop": -0.1}, "tstop must lie ahead"),
        ({"tstop": np.inf}, "tstop must be finite"),
    ):
        with pytest.raises(hb.ProblemError, match=text):
            solver.step(**arguments)
    for arguments in ({"t": "1"}, {"tstop": [1.0]}):
        with pytest.raises(TypeError):
            solver.step(**arguments)
    assert bits(solver.state) == before
    assert solver.step() is Status.success


@pytest.mark.parametrize("accuracy", ACCURACY)
def test_a_failed_step_keeps_the_state_and_an_exception_too(accuracy):
    limit, error = [0.3], KeyboardInterrupt()

    def force(t, q, v):
        if t > limit[0]:
            return np.full(2, np.nan)
        if t > 0.2 and limit[0] < 0.3:
            raise error
        return PENDULUM["force"](t, q, v)

    solver = begun(pendulum(force=force), accuracy)
    assert solver.step(1.0, "normal") is Status.nonfinite_callback
    assert "force" in solver.message
    assert 0.2 < solver.state.t <= 0.3
    limit[0] = 0.25
    before = bits(begun(pendulum(force=force), accuracy).state)
    solver = begun(pendulum(force=force), accuracy)
    with pytest.raises(KeyboardInterrupt):
        solver.step(1.0, "normal")
    assert bits(solver.state) == before
    limit[0] = 9.0
    assert solver.step(0.5, "normal") is Status.success


class Cliff(hb.System):
    """A point that falls, until its force is no number."""

    def force(self, t, q, v):
        return jnp.where(q > 0.5, -9.81, jnp.nan)


@pytest.mark.parametrize("accuracy", ACCURACY)
@pytest.mark.parametrize("system", ["pendulum", "cliff"])
def test_steps_are_the_same_bits_whether_their_states_are_read_or_not(system, accuracy):
    """Counters, checkpoints, dense output and the cause of a failure too."""
    place = (0.0, Q0, V0) if system == "pendulum" else (0.0, [1.0], [0.0])
    made = SYSTEMS["jax"] if system == "pendulum" else Cliff()
    solvers = [HHT(made, alpha=-0.1) for _ in range(2)]
    for solver in solvers:
        solver.init_step(*place, **ACCURACY[accuracy])
    first, second = solvers
    statuses = []
    for _ in range(60):
        statuses.append(first.step())
        assert bits(first.state)
        assert second.step() is statuses[-1]
        assert second.message == first.message
    assert (Status.nonfinite_callback in statuses) == (system == "cliff")
    assert second.counters == first.counters
    assert second.checkpoint() == first.checkpoint()
    middle = (first.interpolate(first.state.t).q + first.state.q) / 2
    np.testing.assert_array_equal(second.interpolate(second.state.t).q, middle)
    start = first._integrator.last.t[0]
    np.testing.assert_array_equal(second.interpolate(start).v, first.interpolate(start).v)


@pytest.mark.parametrize("accuracy", [{"step": 0.01}, {"rtol": 1e-4}], ids=str)
@pytest.mark.parametrize("h", [0.002, -0.002])
def test_a_restart_from_the_present_state_takes_its_own_step(accuracy, h):
    solver = HHT(Pendulum())
    assert solver.init_step(0.0, Q0, V0, **accuracy) is Status.success
    for _ in range(5):
        assert solver.step() is Status.success
    t = solver.state.t
    solver.restart(solver.state, step=h)
    for _ in range(3):
        assert solver.step() is Status.success
    assert solver.state.t == pytest.approx(t + 3 * h, abs=1e-12)


@pytest.mark.parametrize("accuracy", [{"step": 0.01}, {"rtol": 1e-4}], ids=str)
def test_interrupts_between_steps_leave_a_solver_that_goes_on(accuracy):
    """Its state is on the trajectory, its last step is one step of it, and no step is counted less than once."""
    solver, alone = HHT(Pendulum()), HHT(Pendulum())
    for one in (solver, alone):
        assert one.init_step(0.0, Q0, V0, **accuracy) is Status.success
        for _ in range(5):  # compiles
            assert one.step() is Status.success
    before, found = signal.signal(signal.SIGALRM, signal.default_int_handler), []
    try:
        for k in range(100):
            try:
                signal.setitimer(signal.ITIMER_REAL, 2e-4 + 1e-5 * k, 0.1)  # again: one in the collector's hooks is lost
                while True:
                    solver.step()
            except KeyboardInterrupt:
                signal.setitimer(signal.ITIMER_REAL, 0.0)
                found.append((solver.state, solver._integrator.last.t.tolist(), solver.counters.steps_accepted))
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    times, states = [], [alone.state]
    for state, last, accepted in found:
        while states[-1].t < state.t:
            assert alone.step() is Status.success
            states.append(alone.state)
            times.append([x.t for x in states[-2:]])
        assert bits(state) == bits(states[-1])
        assert last == times[-1] if times else len(last) == 2
        assert 0 <= accepted - 4 - len(states) <= len(found), "a step that an interrupt takes is made again"
    assert len(states) > len(found)
