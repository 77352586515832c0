"""Velocity constraints that lose rank with v: what follows is open, and no run goes on by luck (H52)."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.result import Status
from solvers.hht.run import by_velocity
from solvers.hht.run.by_velocity import poles


class Speed(hb.System):
    """A weight whose speed is given."""

    least: float = hb.parameter(0.0)

    def force(self, t, q, v):
        return jnp.array([0.0, -1.0])

    def velocity_constraint(self, t, q, v):
        return jnp.array([v @ v - self.least**2 - (1.0 - t) ** 2])


def moved(least=0.0, t_end=2.0, angle=0.3, **request):
    speed = np.hypot(1.0, least)
    hht = hb.HHT(Speed(least=least), events=request.pop("events", ()))
    return hht.solve((0.0, t_end), [0.0, 0.0], speed * np.array([np.cos(angle), np.sin(angle)]), **request)


REQUESTS = [*({"rtol": r} for r in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)), {"steps": 101}, {"steps": 1_000}]


@pytest.mark.parametrize("request_", REQUESTS, ids=str)
@pytest.mark.parametrize("angle", [0.3, -0.5, 2.5])
def test_no_step_goes_by_luck_over_a_place_where_v_has_no_direction(request_, angle):
    solution = moved(angle=angle, **request_)
    assert solution.status is Status.singular_iteration_matrix, solution.message
    assert "rank 0 of 1 rows; for example rows [0]" in solution.message
    assert 0.5 < solution.t[-1] <= 1.0
    told = float(solution.message.split("lose rank at t = ")[1].split(":")[0])
    assert abs(told - 1.0) < 0.1
    assert solution.t.size == solution.counters.steps_accepted + 1


def test_what_was_seen_beyond_is_no_event():
    clock = hb.Event(lambda t, q, v: t - np.array([0.5]) @ np.ones(1), name="half")
    late = hb.Event(lambda t, q, v: t - 1.01, name="late")
    solution = moved(rtol=1e-3, events=[clock, late])
    assert [times.size for times in solution.t_events] == [1, 0]


def test_a_run_that_ends_there_arrives():
    assert moved(rtol=1e-4, t_end=0.99).success


@pytest.mark.parametrize("least", [0.1, 0.5])
def test_speeds_that_only_become_small_are_followed(least):
    """mu has a peak there, and a step is short beside it."""
    coarse, fine = (moved(least=least, rtol=rtol) for rtol in (1e-4, 1e-6))
    assert coarse.success, coarse.message
    assert fine.success, fine.message
    assert np.abs(coarse.q[-1] - fine.q[-1]).max() < 1e-2


def test_constraints_that_are_linear_in_v_cost_no_look(monkeypatch):
    monkeypatch.setattr(by_velocity, "poles", None)
    for name in ("knife_edge", "simple_pendulum"):
        assert hb.solve(hb.load_problem(name), "hht", rtol=1e-3).success


def test_a_pole_stands_out_from_what_is_three_steps_away():
    pole = 1.0 / (np.arange(40) - 20.3)
    assert poles(pole[:, None]).tolist() == [20]
    wave = np.sin(2.0 * np.pi * np.arange(200) / 50.0)
    assert poles(np.stack([0.0 * wave, wave], axis=1)).size == 0
