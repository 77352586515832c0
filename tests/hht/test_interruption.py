"""Interrupts and exceptions reach the caller, and later steps are those of a run without them."""

import signal

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem, System
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.scenes import GRAVITY, JAX_PENDULUM, Q0, V0


class Own(Exception):
    pass


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


class Walled(System):
    """A spring whose force is not defined beyond 1: only there a look tells which function is not finite."""

    def force(self, t, q, v):
        return jnp.where(q > 1.0, jnp.nan, 100.0)


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
