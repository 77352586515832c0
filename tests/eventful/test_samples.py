"""Sampled control: the held input changes at every sample, exactly, with every solver."""

from __future__ import annotations

import pickle

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.errors import ProblemError
from tests.eventful.test_eventful import Crane

PERIOD, GAINS = 0.13, np.array([4.0, 3.0])


class Held(hb.System):
    """A unit mass under a held force: q = (place, force)."""

    def force(self, t, q, v):
        return jnp.stack([q[1], 0.0])


def control(t, q, v):
    return jnp.asarray(q).at[1].set(-GAINS @ jnp.stack([q[0], v[0]])), v


SAMPLE = hb.Event.every(PERIOD, control)


def states(count):
    """Place and velocity (count + 1, 2) at the samples: between them the acceleration is constant."""
    step, push = np.array([[1.0, PERIOD], [0.0, 1.0]]), np.array([PERIOD**2 / 2, PERIOD])
    x = [np.array([1.0, 0.0])]
    for _ in range(count):
        x.append(step @ x[-1] - push * (GAINS @ x[-1]))
    return np.array(x)


@pytest.mark.parametrize("solver", ["hht", "cvode", "ida(form=index1)", "scipy(method=DOP853)", "projected"])
def test_motion_between_samples_is_that_of_the_held_force(solver):
    problem = hb.Problem(name="held", system=Held(), t_span=(0.0, 10 * PERIOD), q0=[1.0, 0.0], v0=[0.0, 0.0])
    found = hb.solve(problem, solver, rtol=1e-8, atol=1e-10, events=[SAMPLE])
    assert found.status.label == "success"
    np.testing.assert_allclose(found.t_events[0], PERIOD * np.arange(10), rtol=1e-15)
    expected = states(10)
    np.testing.assert_allclose(found.q_events[0][:, 0], expected[:-1, 0], atol=1e-7)
    np.testing.assert_allclose(found.v_events[0][:, 0], expected[:-1, 1], atol=1e-7)
    np.testing.assert_allclose([found.q[-1, 0], found.v[-1, 0]], expected[-1], atol=1e-7)


def test_rows_at_samples_hold_the_new_input_and_other_events_stay():
    problem = hb.Problem(name="held", system=Held(), t_span=(0.0, 10 * PERIOD), q0=[1.0, 0.0], v0=[0.0, 0.0])
    half = hb.Event(lambda t, q, v: q[0] - 0.5, name="half")
    found = hb.solve(problem, "projected", rtol=1e-9, events=[half, SAMPLE], t_eval=PERIOD * np.arange(11))
    assert found.status.label == "success"
    np.testing.assert_allclose(found.q[0], problem.q0)  # the start, before its sample
    np.testing.assert_allclose(found.q[1:-1, 1], -(states(10) @ GAINS)[1:-1], atol=1e-7)
    assert found.t.size == 11
    (t,), at = found.t_events[0], states(10)
    i = int(t // PERIOD)
    s, u = t - i * PERIOD, -(GAINS @ at[i])
    np.testing.assert_allclose(at[i, 0] + s * at[i, 1] + s * s / 2 * u, 0.5, atol=1e-7)


def test_samples_end_the_run_at_their_number():
    problem = hb.Problem(name="held", system=Held(), t_span=(0.0, 10.0), q0=[1.0, 0.0], v0=[0.0, 0.0])
    found = hb.solve(problem, "hht", rtol=1e-6, events=[hb.Event.every(PERIOD, control, terminal=4)])
    assert (found.status.label, found.t[-1]) == ("event", 3 * PERIOD)


def test_no_sample_falls_on_the_end_of_the_interval():
    assert 3 * 0.3 < 0.9  # by roundoff
    problem = hb.Problem(name="held", system=Held(), t_span=(0.0, 0.9), q0=[1.0, 0.0], v0=[0.0, 0.0])
    found = hb.solve(problem, "projected", rtol=1e-6, events=[hb.Event.every(0.3, control)])
    assert (found.status.label, found.t_events[0].size, found.t[-1]) == ("success", 3, 0.9)


def test_wrong_periods_loops_and_starts_are_refused():
    with pytest.raises(ProblemError, match="period of an event must be above 0"):
        hb.Event.every(0.0, control)
    with pytest.raises(ProblemError, match=r"Event\.every is for hhtbench\.solve"):
        hb.HHT(Held(), events=[SAMPLE])
    off = hb.Problem(name="crane", system=Crane(), t_span=(0.0, 1.0), q0=[0.0, 0.0, -3.0], v0=[0.0] * 3)
    found = hb.solve(off, "projected", rtol=1e-6, events=[hb.Event.every(0.1, lambda t, q, v: (q, v))])
    assert found.status.label == "inconsistent_initial"


def test_an_unpickled_problem_is_sampled():
    start = {"t_span": (0.0, 4 * PERIOD), "q0": [1.0, 0.0], "v0": [0.0, 0.0], "events": SAMPLE}
    problem = pickle.loads(pickle.dumps(hb.Problem(name="held", system=Held(), **start)))
    found = hb.solve(problem, "projected", rtol=1e-8)
    np.testing.assert_allclose(found.q[-1, 0], states(4)[-1, 0], atol=1e-7)
