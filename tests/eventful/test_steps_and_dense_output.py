"""Dense output and constant steps with events, for every solver that has them."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb

G, FIRST = 9.81, np.sqrt(2 / 9.81)  # of the first hit [s]


class Ball(hb.System):
    def force(self, t, q, v):
        return jnp.stack([-G + 0 * t])


class Rests(Ball):
    def constraint(self, t, q):
        return q


def bouncing(end):
    """From 1 m, restitution 0.5; it rests after the first hit's time times 3."""
    hit = hb.Event(lambda t, q, v: q[0], direction=-1, restitution=0.5, then=Rests(), name="hit")
    return hb.Problem(name="ball", system=Ball(), t_span=(0, end), q0=[1.0], v0=[0.0], events=hit)


def flight(t):
    """Height and velocity at ``t`` in closed form."""
    begun, speed = -FIRST, G * FIRST
    while speed > 1e-9 and t >= begun + 2 * speed / G:
        begun, speed = begun + 2 * speed / G, speed / 2
    s = t - begun
    return (speed * s - G * s * s / 2, speed - G * s) if speed > 1e-9 else (0.0, 0.0)


@pytest.mark.parametrize("solver", ["hht", "ida", "cvode", "scipy(method=Radau)", "diffrax(method=Dopri8)"])
def test_dense_output_goes_on_over_hits_and_rest(solver):
    run = hb.solve(bouncing(2.0), solver, rtol=1e-8, dense_output=True)
    times = np.linspace(0.003, 1.997, 60)
    found = run(times)
    assert run.success
    assert np.allclose(np.hstack([found.q, found.v]), [flight(t) for t in times], atol=1e-5)
    assert np.allclose(run(times[7]).q, found.q[7])
    assert np.allclose(run(run.t_events[0][0]).v, G * FIRST / 2, atol=1e-5)  # after the impact
    assert hb.solve(bouncing(0.5), "cvode", rtol=1e-6).interpolant is None  # it was not asked for


class Pendulum(hb.System):
    def force(self, t, q, v):
        return jnp.stack([0.0, -G])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1) / 2])


@pytest.mark.parametrize("solver", ["hht(alpha=-0.1)", "generalised_alpha", "rattle"])
def test_constant_steps_with_a_wall_keep_order_two(solver):
    wall = hb.Event(lambda t, q, v: q[0], direction=-1, restitution=0.7, name="wall")
    start = {"q0": [np.sin(1.0), -np.cos(1.0)], "v0": [0.0, 0.0], "events": wall}
    problem = hb.Problem(name="wall", system=Pendulum(), t_span=(0, 2), **start)
    exact = hb.solve(problem, "projected", rtol=1e-11).q[-1]
    runs = [hb.solve(problem, solver, steps=n) for n in (200, 400)]
    errors = [np.linalg.norm(run.q[-1] - exact) for run in runs]
    assert [len(run.t_events[0]) for run in runs] == [2, 2]
    for run, h in zip(runs, (0.01, 0.005), strict=True):
        other = np.diff(run.t)[np.abs(np.diff(run.t) / h - 1) > 1e-9]  # up to two hits and to the end, and rows after hits
        assert np.all(other < h)
        assert other.size <= 5
    assert 1.8 < np.log2(errors[0] / errors[1]) < 2.2


def test_lengths_of_steps_are_declined_with_switches():
    run = hb.solve(bouncing(1.0), "hht", steps=np.full(10, 0.1))
    assert run.status is hb.Status.declined
    assert "steps=N" in run.message


@pytest.mark.parametrize("solver", ["hht", "cvode"])
def test_dense_output_ends_where_a_terminal_event_does(solver):
    lands = hb.Event(lambda t, q, v: q[0], direction=-1, restitution=0.5, terminal=True, name="lands")
    problem = hb.Problem(name="ball", system=Ball(), t_span=(0, 1.0), q0=[1.0], v0=[0.0], events=lands)
    run = hb.solve(problem, solver, rtol=1e-8, dense_output=True)
    assert run(FIRST - 1e-3).q[0] == pytest.approx(G * FIRST * 1e-3, rel=1e-2)
    with pytest.raises(hb.ProblemError, match="covers"):
        run(0.5)


@pytest.mark.parametrize("solver", ["cvode", "ida"])
def test_rebounds_of_bound_bodies_go_on_from_the_constraints(solver):
    wall = hb.Event(lambda t, q, v: q[0], direction=-1, restitution=0.7, name="wall")
    start = {"q0": [np.sin(1.0), -np.cos(1.0)], "v0": [0.0, 0.0], "events": wall}
    run = hb.solve(hb.Problem(name="wall", system=Pendulum(), t_span=(0, 4), **start), solver, rtol=1e-5)
    assert run.success
    assert run.t_events[0].size > 3
