"""``steps=solution``: the steps of an earlier solution again."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from solvers.hht import HHT

EARLIER = hb.solve("simple_pendulum", "hht", rtol=1e-3)
PENDULUM = hb.load_problem("simple_pendulum")


@pytest.mark.parametrize("solver", ["hht(alpha=-0.2)", "generalised_alpha", "hht_i3", "rattle"])
def test_solvers_of_prescribed_steps_take_them_again(solver):
    found = hb.solve(PENDULUM, solver, steps=EARLIER)
    np.testing.assert_array_equal(found.steps_data.h, EARLIER.steps_data.h)
    assert np.ptp(found.steps_data.h) > 0.001


def test_so_does_the_integrator_itself_and_back_in_time():
    t0, t1 = PENDULUM.t_span
    found = HHT(PENDULUM.system).solve((t1, t0), EARLIER.q[-1], EARLIER.v[-1], steps=EARLIER)
    np.testing.assert_array_equal(found.steps_data.h, -EARLIER.steps_data.h)


def test_steps_of_a_library_that_has_kept_them_are_taken():
    earlier = hb.solve(PENDULUM, "scipy(method=DOP853)", rtol=1e-6, keep_steps=True, t_eval=[1.0])
    found = hb.solve(PENDULUM, "hht", steps=earlier)
    np.testing.assert_allclose(found.t, earlier.ends.t, rtol=0, atol=1e-13)


def test_solvers_that_choose_their_own_steps_decline():
    found = hb.solve(PENDULUM, "scipy", steps=EARLIER)
    assert found.status is hb.Status.declined
    assert "chooses its own steps" in found.message


@pytest.mark.parametrize(
    ("steps", "text"),
    [
        (EARLIER.but(status=hb.Status.max_steps), "has succeeded; this one ended with max_steps"),
        (EARLIER.but(steps_data=None), "has kept its steps; solve it with keep_steps=True"),
        (hb.solve(PENDULUM, "hht", rtol=1e-3, t_span=(0.0, 1.0)), "add up to the interval's length 10 s; they add up to 1"),
        (EARLIER.t, "or an earlier solution"),
    ],
    ids=["failed", "not kept", "other interval", "times"],
)
def test_what_has_no_steps_for_the_interval_is_refused(steps, text):
    with pytest.raises(hb.ProblemError, match=text):
        hb.solve(PENDULUM, "hht", steps=steps)


class Oscillator(hb.System):
    """A spring of length zero, 0.5 m below the floor at q = 0."""

    w: object = hb.parameter(2.0)

    def force(self, t, q, v):
        return jnp.stack([-(self.w**2) * (q[0] + 0.5)])


def bounced(w, **request):
    problem = hb.Problem(name="bounced", system=Oscillator(w=w), t_span=(0.0, 0.9), q0=[1.0], v0=[0.0])
    floor = hb.Event(lambda t, q, v: q[0], direction=-1, change=lambda t, q, v: (q, -0.8 * v))
    return hb.solve(problem, "hht", events=floor, **request)


@pytest.mark.parametrize("dw", [1e-7, -1e-7])
def test_a_result_behind_an_event_is_smooth_in_the_parameters(dw):
    """q = -0.5 + 0.5 cos(s) + 0.8 sqrt(2) sin(s) with s = w t - arccos(1/3), since it falls at -sqrt(2) w."""
    earlier = bounced(2.0, rtol=1e-6)
    s = 2.0 * 0.9 - np.arccos(1 / 3)
    slope = 0.9 * (-0.5 * np.sin(s) + 0.8 * np.sqrt(2) * np.cos(s))
    there, here = (bounced(w, steps=earlier) for w in (2.0 + dw, 2.0))
    assert here.t_events[0].size == 1
    assert (there.q[-1, 0] - here.q[-1, 0]) / dw == pytest.approx(slope, rel=1e-4)
