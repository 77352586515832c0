"""Events, of solvers that have them: when they happen, in which direction, and the state in which one ends the motion."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.optimize import brentq

from hhtbench.conformance.entry import claim
from hhtbench.conformance.scenes.pendulum import PERIOD, RADIUS, swing
from hhtbench.conformance.scenes.scene import Scene
from hhtbench.conformance.subject import Subject, expect
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import Solution, Status

ANGLE = 0.5  # of the pendulum from below, at which the event is [rad]
HEIGHT = -RADIUS * float(np.cos(ANGLE))  # [m]
REACHED = 1e-9  # m: what a motion that ends at an event may be beside it


def _times() -> Vector:
    """Return the times at which the pendulum passes ``HEIGHT``, first falling, then rising [s]."""
    first = float(brentq(lambda t: swing(t)[0] - ANGLE, 0.0, PERIOD / 4, xtol=1e-14))
    return np.array([first, PERIOD / 2 - first])


def _height(direction: int, terminal: bool) -> Callable[..., Any]:
    """Return the event function, with SciPy's attributes ``direction`` and ``terminal``."""

    def height(t: Any, q: Any, v: Any) -> Any:
        return q[1] - HEIGHT

    height.direction, height.terminal = direction, terminal  # type: ignore[attr-defined]
    return height


def _solved(subject: Subject, direction: int = 0, terminal: bool = False) -> tuple[Scene, Solution, float]:
    """Solve the pendulum with that event; return scene, solution and the allowed error."""
    scene, request = subject.case("position", 1)
    solver = subject.having("with_events")(_height(direction, terminal))
    return scene, subject.solve(scene.problem, solver, **request), subject.bound(request, scene.problem)


def _expect_times(found: Solution, known: Vector, bound: float) -> None:
    expect(len(found.t_events) == 1, f"one event function was given and there are {len(found.t_events)} lists of times")
    times = found.t_events[0]
    expect(times.size == known.size, f"there are {times.size} events at {times}; expected them at {known}")
    off = float(np.max(np.abs(times - known), initial=0.0))
    expect(off <= bound, f"an event is off its time by {off:.1e} s; expected {bound:.1e} at most")


@claim("events/times", needs=("with_events",))
def events_are_found_in_time(subject: Subject) -> None:
    """Every change of sign of an event function is found, at its time, with the state there."""
    _, found, bound = _solved(subject)
    expect(found.status is Status.success, f"it ends with {found.status.label}: {found.message}")
    _expect_times(found, _times(), bound)
    off = float(np.max(np.abs(found.q_events[0][:, 1] - HEIGHT)))
    expect(off <= bound, f"at an event its function is {off:.1e}; expected {bound:.1e} at most")


@claim("events/direction", needs=("with_events",))
def events_have_a_direction(subject: Subject) -> None:
    """Of an event with a direction the changes of sign in the other one are none."""
    for direction, known in ((-1, _times()[:1]), (1, _times()[1:])):
        _, found, bound = _solved(subject, direction)
        _expect_times(found, known, bound)


@claim("events/terminal", needs=("with_events",))
def terminal_event_ends_the_motion(subject: Subject) -> None:
    """A terminal event ends the motion where its function is zero or has just crossed it, on both constraint levels."""
    scene, found, bound = _solved(subject, terminal=True)
    expect(found.status is Status.event, f"it ends with {found.status.label}: {found.message}")
    _expect_times(found, _times()[:1], bound)
    expect(found.t[-1] == found.t_events[0][-1], f"the last row is at {exact(found.t[-1])}, not at the event")
    beyond = HEIGHT - float(found.q[-1, 1])
    expect(0.0 <= beyond <= REACHED, f"the motion ends {beyond:.1e} m beyond the event; expected 0 to {REACHED:.0e}")
    levels = scene.levels(float(found.t[-1]), found.q[-1], found.v[-1])
    worst = max(float(np.max(np.abs(level))) for level in levels)
    most = subject.claims.drift or 10 * bound
    expect(worst <= most, f"at the event the constraints are off by {worst:.1e}; expected {most:.1e} at most")
