"""What trials, interrupts, exceptions and foreign states leave behind: nothing that a later step would meet."""

import gc
import signal
import weakref
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol import NumpySystem, System
from hhtbench.result import Status
from solvers.hht import HHT, Event
from solvers.hht.run import idle
from solvers.hht.run.engine import Engine
from solvers.hht.run.loops import Loops

from .scenes import GRAVITY, JAX_PENDULUM, Q0, V0, same_bits


class Own(Exception):
    pass


class Free(System):
    """Mass points that nothing pulls."""

    def force(self, t, q, v):
        return 0.0 * q


def test_an_exception_after_a_failed_trial_of_derived_derivatives_is_the_users(monkeypatch):
    """The trial has callbacks of its own; those of the declared derivatives must come back with their addresses."""
    trials = []

    def force(t, q, v):
        if trials and t > 0.05:
            raise Own
        return 100.0 * q**2

    original = Engine.give_up_derivatives
    monkeypatch.setattr(
        Engine, "give_up_derivatives", lambda *given, **named: trials.append(original(*given, **named)) or trials[-1]
    )
    system = NumpySystem(force=force, force_jacobians=lambda t, q, v: (np.diag(200.0 * q), np.zeros((1, 1))))
    with pytest.raises(Own):
        HHT(system, first_step=1.0).solve((0.0, 0.2), [0.5], [0.0], rtol=1e-4, atol=1e-4)
    assert trials and not any(trials)


@pytest.fixture(autouse=True)
def interruptible():
    """As in a terminal: a process that a shell has put into the background ignores interrupts."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupting(after):
    """An event function in Python that interrupts once, from the time ``after`` on."""
    done = []

    def function(t, q, v):
        if t > after and not done:
            done.append(t)
            signal.raise_signal(signal.SIGINT)
        return 1.0

    return Event(function)


@pytest.mark.parametrize("after", [0.95, 0.9999])
@pytest.mark.parametrize("linsolver", ["auto", "sparse"])
def test_an_interrupt_up_to_the_last_call_is_raised_and_the_rows_before_it_are_right(linsolver, after):
    with pytest.raises(KeyboardInterrupt) as raised:
        HHT(JAX_PENDULUM, linsolver=linsolver, events=interrupting(after)).solve((0.0, 1.0), Q0, V0, steps=100)
    rows = raised.value.partial_solution
    assert rows.t[-1] > 0.9
    assert np.abs(np.sum(rows.q**2, axis=1) - Q0 @ Q0).max() < 1e-12


def test_an_interrupt_in_the_very_last_call_of_a_free_motion_is_raised():
    """No step and no output follows that would tell."""
    with pytest.raises(KeyboardInterrupt) as raised:
        HHT(Walled(), events=interrupting(0.0999)).solve((0.0, 0.1), [0.0], [0.0], steps=10)
    assert raised.value.partial_solution.t[-1] == 0.1


def test_an_interrupt_in_a_step_by_hand_is_raised_by_that_step():
    hht = HHT(JAX_PENDULUM, events=interrupting(0.0))
    hht.init_step(0.0, Q0, V0, step=0.01)
    with pytest.raises(KeyboardInterrupt):
        hht.step()
    assert hht.state.t == 0.0
    assert hht.step() is Status.success


def test_an_impact_just_behind_a_steps_start_is_no_pile_up():
    """The second bounce of a ball lies 1e-7 of a step behind the start of a step that no change has made."""
    system = NumpySystem(force=lambda t, q, v: np.array([-GRAVITY]))
    floor = Event(lambda t, q, v: q[0], direction=-1, change=lambda t, q, v: (q, -0.5 * v))
    second = 2.0 * np.sqrt(2.0 / GRAVITY)  # of a fall from 1 m and a rebound with half the speed
    ends = np.concatenate([[0.0], np.arange(0.1, second - 0.05, 0.1), second - 1e-8 + 0.1 * np.arange(3)])
    solution = HHT(system, alpha=0.0, events=floor).solve((0.0, ends[-1]), [1.0], [0.0], steps=np.diff(ends))
    assert solution.success, solution.message
    assert np.allclose(solution.t_events[0][:2], [second / 2, second], rtol=0, atol=1e-6)


def test_an_exception_while_a_saved_state_is_loaded_does_not_reach_the_next_one():
    broken = []

    def force(t, q, v):
        if broken:
            raise Own
        return -q - q**3

    hht, other = HHT(NumpySystem(force=force)), HHT(NumpySystem(force=force))
    for solver in (hht, other):
        solver.init_step(0.0, [1.0], [0.0], step=0.02)
    states = []
    for _ in range(20):
        hht.step()
        states.append(hht.state)
    hht.restart(states[4])
    broken.append(True)
    with pytest.raises(Own):
        hht.step()
    broken.clear()
    for solver in (hht, other):
        solver.restart(states[-1])
        assert solver.step() is Status.success
    assert np.array_equal(hht.state.q, other.state.q)


@pytest.mark.parametrize("size", [2, 10**6])
def test_a_state_of_another_length_is_refused(size):
    hht = HHT(JAX_PENDULUM)
    hht.init_step(0.0, Q0, V0, step=0.01)
    assert hht.step() is Status.success
    before = hht.state
    hht.restart(replace(before, factorised=replace(before.factorised, at=np.zeros(size))))
    with pytest.raises(hb.ProblemError, match="arrays are of other lengths"):
        hht.step()
    hht.restart(before)
    assert hht.step() is Status.success


class Walled(System):
    """A spring whose force is not defined beyond 1: only there a look tells which function is not finite."""

    def force(self, t, q, v):
        return jnp.where(q > 1.0, jnp.nan, 100.0)


@pytest.mark.parametrize("linsolver", ["auto", "dense", "band", "sparse"])
@pytest.mark.parametrize("how", [{"step": 0.02}, {"rtol": 1e-3}], ids=str)
def test_trial_steps_for_an_event_of_the_interpolant_alone_leave_no_bit_behind(how, linsolver):
    """Dense output leaves the circle between steps, and no step's end does: the step stands, and so does its matrix."""
    plain = HHT(JAX_PENDULUM, linsolver=linsolver).solve((0.0, 2.0), Q0, V0, **how)
    off = np.sum(plain(np.linspace(0.0, 2.0, 2001)).q ** 2, axis=1) - 1.0
    level = 0.3 * off[np.argmax(np.abs(off))]
    circle = Event(lambda t, q, v: q @ q - 1.0 - level, terminal=True, samples=16)
    watched = HHT(JAX_PENDULUM, linsolver=linsolver, events=circle).solve((0.0, 2.0), Q0, V0, **how)
    assert watched.counters.residual_evaluations > plain.counters.residual_evaluations, "there were trials"
    assert watched.success and not watched.t_events[0].size
    assert same_bits(watched, plain)


@pytest.mark.parametrize("how", [{"step": 0.02}, {"rtol": 1e-4}], ids=["constant", "controlled"])
def test_an_exception_in_any_call_of_steps_by_hand_leaves_nothing_behind(how):
    count, raised_at = [0], [0]

    def force(t, q, v):
        count[0] += 1
        if count[0] == raised_at[0]:
            raise ZeroDivisionError
        return np.array([0.0, -GRAVITY])

    def steps(at):
        count[0], raised_at[0] = 0, 0
        hht = HHT(NumpySystem(force=force, constraint=lambda t, q: np.array([(q @ q - 1.0) / 2.0])), events=[event])
        hht.init_step(0.0, np.array([1.0, 0.0]), np.zeros(2), **how)
        raised_at[0], found = count[0] + at, []
        while len(found) < 4 or found[-1] is not Status.event:
            try:
                found.append(hht.step(tstop=1.0))
            except ZeroDivisionError:
                continue
            if found[-1] not in (Status.success, Status.event):
                break
        return found, hht.state, count[0] - raised_at[0] + at

    event = Event(lambda t, q, v: q[0] - 0.9, terminal=True)
    statuses, state, calls = steps(-1)
    assert statuses[-1] is Status.event
    for at in range(1, calls + 1, 3):
        found, end, _ = steps(at)
        assert found == statuses
        assert (end.t, *end.q, *end.v) == (state.t, *state.q, *state.v), f"an exception in call {at}"


@pytest.mark.parametrize("n", [20, 150])
def test_an_engine_that_is_not_kept_for_later_solves_is_freed_at_once(n, monkeypatch):
    """Without constraints, by full matrices and by bands: neither Python's cycles nor the callbacks hold its memory."""
    made = []
    original = Loops.__init__
    monkeypatch.setattr(Loops, "__init__", lambda own, *given: made.append(weakref.ref(own)) or original(own, *given))
    monkeypatch.setattr(idle, "MAX_BYTES", 0)
    gc.collect()
    gc.disable()
    try:
        for system in (NumpySystem(force=lambda t, q, v: 0.0 * q), Free()):
            assert HHT(system).solve((0.0, 0.01), np.ones(n), np.zeros(n), step=0.005, t_eval=[0.0, 0.01]).success
        assert len(made) == 2
        assert [own() for own in made] == [None, None]
    finally:
        gc.enable()


def test_engines_for_later_solves_hold_no_more_than_64_megabytes():
    """One for 400 coordinates has 25."""
    for _ in range(4):
        system = NumpySystem(force=lambda t, q, v: 0.0 * q)
        assert HHT(system).solve((0.0, 0.01), np.ones(400), np.zeros(400), step=0.005, t_eval=[0.0, 0.01]).success
    assert 20e6 <= sum(engine.nbytes for _, engine in idle._idle) <= 64 * 2**20
