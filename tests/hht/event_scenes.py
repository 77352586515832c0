"""Scenes with events that the tests of events and of stepping by hand share."""

import numpy as np
from scipy.integrate import solve_ivp

from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.result import Status
from solvers.hht import HHT
from tests.hht.scenes import ANGLE, GRAVITY, Q0, SPEED, SYSTEMS, V0

FREE = NumpySystem(force=lambda t, q, v: np.array([-GRAVITY]))
AT_REST = NumpySystem(force=lambda t, q, v: np.zeros(1))  # with v = 1 the coordinate is the time
HOW = [{"step": 0.1}, {"rtol": 1e-6}]
RESTITUTION = 0.7


def height(t, q, v):
    return q[0]


def clock(at, **options):
    """An event at a given time."""
    return Event(lambda t, q, v: t - at, **options)


def drift(events, span=(0.0, 1.0), **how):
    """The free coordinate with q = t and v = 1: an event of q - c is at c."""
    return HHT(AT_REST, events=events).solve(span, [span[0]], [1.0], **(how or {"step": 0.1}))


def wall():
    """The vertical through the pivot, hit from the right."""
    return Event(height, direction=-1, change=lambda t, q, v: (q, -RESTITUTION * v), name="wall")


def impacts(count):
    """Times of the unit pendulum's impacts and the rates before them, from its angle's equation by DOP853."""

    def hit(t, y):
        return y[0]

    hit.terminal, hit.direction = True, -1
    t, y, times, rates = 0.0, [ANGLE, SPEED], [], []
    for _ in range(count):
        rate = lambda _, y: [y[1], -GRAVITY * np.sin(y[0])]  # noqa: E731
        flight = solve_ivp(rate, (t, t + 9.0), y, "DOP853", events=hit, rtol=1e-13, atol=1e-14)
        t, y = flight.t[-1], [0.0, -RESTITUTION * flight.y[1, -1]]
        times.append(t)
        rates.append(flight.y[1, -1])
    return np.array(times), np.array(rates)


ACCURACY = {"constant": {"step": 0.01}, "controlled": {"rtol": 1e-4}}


def begun(system=SYSTEMS["jax"], accuracy="constant", q0=Q0, v0=V0, **options):
    """A solver ready for stepping by hand."""
    solver = HHT(system, **options)
    assert solver.init_step(0.0, q0, v0, **ACCURACY[accuracy]) is Status.success, solver.message
    return solver
