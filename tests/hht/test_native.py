"""The native engine against the host engine: the same steps, counters, statuses and events, for every problem and option."""

from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np
import pytest
from solvers.hht.native.engine import NativeEngine

import hhtbench as hb
from hhtbench import ProblemError, Status
from hhtbench.lowering.scalar_compiler import compiler
from solvers.hht import HHT, Event, engines
from solvers.hht.events import scan
from tests.hht.scenes import Q0, SYSTEMS, V0

CLOSE = 1e-9  # of the largest: roundoff of both engines, carried over the steps
NAMES = hb.list_problems()
METHODS = [
    {"alpha": -0.3},
    {"alpha": -0.3, "b": 0.25},
    {"alpha": -0.15, "reaction": "predictor"},
    {"alpha": -0.15, "reaction": "midpoint"},
    {"alpha": 0.0, "reaction": "midpoint_predictor"},
    {"alpha": -0.1, "start": "shifted"},
    {"alpha": -0.2, "start": "trapezoidal", "rescale_a": False},
]
MIXED = ["jay_negrut_pendulum", "andrews", "rolling_disk_incline", "jay_negrut_test1", "knife_edge", "oscillator_chain"]


def both(problem, options=None, span=None, events=None, **request):
    guesses = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
    solve = lambda engine: HHT(problem.system, engine=engine, events=events, **(options or {})).solve(  # noqa: E731
        span or problem.t_span, problem.q0, problem.v0, **guesses, **request
    )
    return solve("native"), solve("host")


def assert_same(native, host, close=CLOSE):
    assert native.status is host.status, (native.message, host.message)
    assert native.t.size == host.t.size
    assert native.counters.steps_accepted == host.counters.steps_accepted
    for name in ("q", "v", "lam", "mu"):
        ours, theirs = getattr(native, name), getattr(host, name)
        bound = close * (1.0 if name in "qv" else 1e3) * max(float(np.abs(theirs).max(initial=0.0)), 1e-12)
        assert np.abs(ours - theirs).max(initial=0.0) <= bound, name


@pytest.mark.parametrize("name", NAMES)
def test_every_problem_moves_the_same_with_constant_steps_and_under_error_control(name):
    problem = hb.load_problem(name)
    t0, t1 = problem.t_span
    h = 1e-4 * (t1 - t0)
    native, host = both(problem, span=(t0, t0 + 30 * h), step=h)
    assert_same(native, host)
    iterations = pytest.approx(host.counters.newton_iterations, rel=0.05, abs=3)  # the last one is often roundoff's choice
    assert native.counters.newton_iterations == iterations
    assert_same(*both(problem, rtol=1e-4, max_num_steps=30), close=1e-7)  # steps follow the error, roundoff follows them


@pytest.mark.parametrize("options", METHODS, ids=str)
@pytest.mark.parametrize("name", MIXED)
def test_every_method_moves_the_same(name, options):
    problem = hb.load_problem(name)
    t0, t1 = problem.t_span
    lengths = 1e-4 * (t1 - t0) * np.resize([1.0, 1.0, 0.5, 1.4, 1.4, 1.4], 24)
    assert_same(*both(problem, options, span=(t0, t0 + float(lengths.sum())), steps=lengths))
    assert_same(*both(problem, options, rtol=1e-3, max_num_steps=12), close=1e-7)


def test_time_runs_backward_the_same():
    problem = hb.load_problem("jay_negrut_pendulum")
    assert_same(*both(problem, span=(0.0, -0.2), step=1e-3))
    assert_same(*both(problem, span=(0.0, -0.2), rtol=1e-4), close=1e-7)


def test_the_loops_make_the_steps(monkeypatch):
    """Not one of a thousand is left to the host engine."""
    monkeypatch.setattr("solvers.hht.engine.HostEngine.step", None)
    problem = hb.load_problem("jay_negrut_pendulum")
    solution = HHT(problem.system, engine="native").solve((0.0, 1.0), problem.q0, problem.v0, step=1e-3)
    assert solution.success
    assert HHT(problem.system, engine="native").solve((0.0, 1.0), problem.q0, problem.v0, rtol=1e-4).success


def test_events_come_at_the_same_times():
    height = Event(lambda t, q, v: q[1] + 0.3)
    bounce = Event(lambda t, q, v: q[0] - 0.4, change=lambda t, q, v: (q, -v))
    for how in ({"step": 0.01}, {"rtol": 1e-5}):
        native, host = (
            HHT(SYSTEMS["jax"], engine=engine, events=[height, bounce]).solve((0.0, 2.0), Q0, V0, **how)
            for engine in ("native", "host")
        )
        assert [t.size for t in native.t_events] == [t.size for t in host.t_events]
        assert sum(t.size for t in native.t_events) > 1
        for ours, theirs in zip(native.t_events, host.t_events, strict=True):
            assert np.abs(ours - theirs).max(initial=0.0) < 1e-9
        assert native.counters.event_evaluations > 0


def test_steps_without_an_event_stay_in_the_loops(monkeypatch):
    """Only the first step, which may begin on a zero, is looked at from Python."""
    scans = []
    monkeypatch.setattr("solvers.hht.watch.scan", lambda *arguments: scans.append(1) or scan(*arguments))
    far = Event(lambda t, q, v: q[0] - 1e3, samples=3)
    solution = HHT(SYSTEMS["jax"], engine="native", events=far).solve((0.0, 1.0), Q0, V0, steps=1000)
    assert len(scans) == 1
    assert solution.counters.event_evaluations == 4 * 1000 + 2  # the start, and a look at where the motion leaves it to


def test_a_function_that_keeps_something_between_calls_is_called_in_python():
    calls = []
    event = Event(lambda t, q, v: calls.append(float(t)) or q[0] - 1e3)
    solution = HHT(SYSTEMS["jax"], engine="native", events=event).solve((0.0, 0.2), Q0, V0, step=0.01)
    assert solution.counters.event_evaluations == len(calls) > 20


@pytest.mark.parametrize("request_", [{"max_evaluations": 100}, {"max_num_steps": 17}, {"max_seconds": 0.05}], ids=str)
def test_budgets_end_in_the_same_status_with_all_steps_kept(request_):
    problem = hb.load_problem("jay_negrut_pendulum")
    steps = 1000 if "max_seconds" not in request_ else 20_000_000
    native, host = both(problem, steps=steps, t_eval=None if steps == 1000 else [0.0], **request_)
    assert native.status is host.status
    assert native.status in (Status.evaluation_budget, Status.max_steps, Status.deadline)
    if "max_seconds" not in request_:
        assert_same(native, host)
        assert native.counters.residual_evaluations == host.counters.residual_evaluations


def test_stepping_by_hand_and_from_a_checkpoint_gives_the_bits_of_one_solve():
    problem = hb.load_problem("andrews")
    whole = HHT(problem.system, engine="native").solve((0.0, 2e-3), problem.q0, problem.v0, rtol=1e-4)
    hht = HHT(problem.system, engine="native")
    hht.init_step(0.0, problem.q0, problem.v0, rtol=1e-4)
    rows = [hht.state.q]
    while hht.state.t < 2e-3:
        if len(rows) == 7:
            saved, hht = hht.checkpoint(), HHT(problem.system, engine="native")
            hht.resume(saved)
        hht.step(tstop=2e-3)
        rows.append(hht.state.q)
    assert np.array_equal(np.array(rows), whole.q)


def test_auto_takes_native_for_small_systems_and_says_why_not_elsewhere():
    pendulum = hb.load_problem("jay_negrut_pendulum")
    hht = HHT(pendulum.system)
    hht.init_step(0.0, pendulum.q0, pendulum.v0, step=1e-3)
    assert isinstance(hht._engine, NativeEngine)
    assert hht.engine_used == "native"
    plain = HHT(SYSTEMS["numpy"])
    plain.solve((0.0, 0.1), Q0, V0, step=0.01)
    assert plain.engine_used == "native"
    with pytest.raises(ProblemError, match="engine must be one of auto, host, native"):
        HHT(pendulum.system, engine="fortran")
    with pytest.raises(ProblemError, match="linsolver"):
        HHT(pendulum.system, engine="native", linsolver="sparse").solve((0.0, 0.1), pendulum.q0, pendulum.v0, step=0.01)


def test_a_matrix_that_serves_often_is_inverted_and_gives_the_same_motion():
    """7 unknowns: an inverse after 11 solves."""
    native, host = both(hb.load_problem("jay_negrut_pendulum"), step=1e-3)
    assert_same(native, host)
    assert native.counters.factorisations < native.counters.linear_solves / 22


def test_the_largest_system_is_a_rule_that_can_be_seen(monkeypatch):
    monkeypatch.setattr(engines, "LARGEST", 3)
    pendulum = hb.load_problem("jay_negrut_pendulum")
    hht = HHT(pendulum.system)
    hht.init_step(0.0, pendulum.q0, pendulum.v0, step=1e-3)
    assert not isinstance(hht._engine, NativeEngine)


def test_threads_share_machine_code_and_not_the_memory_of_a_solve():
    problem = hb.load_problem("jay_negrut_pendulum")
    solve = lambda _: HHT(problem.system).solve((0.0, 0.3), problem.q0, problem.v0, rtol=1e-5).q[-1]  # noqa: E731
    alone = solve(0)
    with ThreadPoolExecutor(6) as pool:
        assert all(np.array_equal(end, alone) for end in pool.map(solve, range(24)))


class TwoMasses(hb.System):
    """Springs between two masses and a wall; the declared Jacobian says that there are none."""

    stiffness: object = hb.parameter(1e6)

    def force(self, t, q, v):
        return jnp.stack([-self.stiffness * (2 * q[0] - q[1]), -self.stiffness * (q[1] - q[0])])

    def force_jacobians(self, t, q, v):
        return jnp.zeros((2, 2)), jnp.zeros((2, 2))


@pytest.mark.parametrize("engine", ["native", "auto", "host"])
def test_entries_that_a_wrong_jacobian_leaves_out_come_back_with_the_derived_one(engine):
    with pytest.warns(UserWarning, match="failed with the declared force_jacobians and converged without"):
        solution = HHT(TwoMasses(), alpha=-0.3, engine=engine).solve((0.0, 0.1), [1.0, 0.5], [0.0, 0.0], step=0.01)
    assert solution.success


def armed_run(engine):
    level = -0.9

    def arm(t, q, v):
        nonlocal level
        level = 0.1
        return q, v

    events = [Event(lambda t, q, v: q[0] - 0.35, change=arm), Event(lambda t, q, v: q[0] - level, terminal=True)]
    return HHT(SYSTEMS["jax"], engine=engine, events=events).solve((0.0, 3.0), Q0, V0, step=0.01)


def test_an_event_over_a_number_that_changes_is_seen_to_change():
    native, host = armed_run("native"), armed_run("host")
    assert native.status is host.status is Status.event
    assert native.t[-1] == pytest.approx(host.t[-1], abs=1e-12)


def test_a_step_that_newton_does_not_make_is_the_host_engines_with_the_same_counters():
    """Forces that jump to NaN in mid-run."""
    native, host = (
        HHT(Vanishing(), engine=engine).solve((0.0, 1.0), [0.0], [1.0], step=0.01) for engine in ("native", "host")
    )
    assert native.status is host.status is Status.nonfinite_callback
    assert native.message == host.message
    assert native.counters == host.counters
    assert native.t[-1] == host.t[-1] == pytest.approx(0.52, abs=0.011)  # arcsin(1/2)


class Vanishing(hb.System):
    """A free mass whose force is no number beyond q = 1/2."""

    def force(self, t, q, v):
        return jnp.where(q < 0.5, -q, jnp.nan)


class Free(hb.System):
    """A mass on a spring, for one test only: what is known of its code stays with it."""

    def force(self, t, q, v):
        return -jnp.sin(q) * jnp.cos(q)


def test_systems_beyond_the_limit_are_declined_for_their_size(monkeypatch, tmp_path):
    monkeypatch.setenv("HHTBENCH_CACHE", str(tmp_path))
    monkeypatch.setattr(compiler, "MOST_OPERATIONS", 5)
    with pytest.raises(ProblemError, match="operations"):
        HHT(Free(), engine="native").solve((0.0, 1e-3), [1.0], [0.0], steps=1)
    hht = HHT(Free())
    assert hht.solve((0.0, 1e-3), [1.0], [0.0], steps=1).success
    assert "operations" in hht.engine_used


@pytest.mark.parametrize(("name", "rtol", "steps"), [("kapitza_pendulum", 1e-2, 60), ("planar_chain", 1e-2, 40)])
def test_steps_that_need_damped_newton_are_made_in_the_loops_too(monkeypatch, name, rtol, steps):
    """Small systems by whole corrections, larger ones by factors."""
    problem = hb.load_problem(name)
    native, host = both(problem, rtol=rtol, max_num_steps=steps)
    assert native.counters.steps_rejected_newton == host.counters.steps_rejected_newton > 0
    assert_same(native, host, close=1e-6)
    monkeypatch.setattr(NativeEngine, "step", None)  # the host engine's
    again = HHT(problem.system, engine="native").solve(
        problem.t_span, problem.q0, problem.v0, rtol=rtol, max_num_steps=steps
    )
    np.testing.assert_array_equal(again.q, native.q)


class Ball(hb.System):
    """A unit mass that falls onto a stiff ground."""

    def force(self, t, q, v):
        return jnp.where(q < 0.0, -1e8 * q, 0.0) - 9.81


@pytest.mark.parametrize("level", [0.7, 0.5, 0.3])
def test_the_matrix_of_a_step_of_the_host_engine_filters_the_next_error_too(level):
    """That step ends at an event, the next one meets the ground: by the ground's own matrix alone it would look exact."""

    def passes(t, q, v):
        return q[0] - level

    found = []
    for engine in ("native", "host"):
        hht = HHT(Ball(), engine=engine, alpha=-0.1, events=Event(passes, terminal=True))
        hht.init_step(0.0, np.array([1.0]), np.array([0.0]), rtol=1e-3)
        while hht.step() is not Status.event:
            pass
        hht.step()
        found.append((hht.state.h, hht.state.q[0]))
    np.testing.assert_allclose(*found, rtol=1e-6)
