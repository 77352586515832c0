"""Eight scenes with events by six families of solvers: end states and times of events beside the truth.

``python -m tests.eventful.figures [rtol]`` prints, for each scene and solver, the error of the end state in tolerances and
the largest error of an event's time [s].  The truth is closed for three scenes, else ``projected`` at 1e-12.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from typing import Any

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from tests.eventful.test_eventful import FALL, Crane, ball, bounce
from tests.eventful.test_states import Cart as Balanced
from tests.eventful.test_states import balance
from tests.eventful.test_switches import ARM, BREAKS, GRIPPED, SPEED, STICKING, STICKS, arm, stick_slip

SOLVERS = ["hht", "ida", "cvode", "scipy(method=Radau)", "diffrax(method=Dopri8)", "projected"]
ROD = 0.5


class Free(hb.System):
    """Unit masses without forces."""

    def force(self, t, q, v):
        return jnp.zeros(2)


def closed(q: Any, v: Any, *times: Any) -> tuple[Any, tuple[Any, ...]]:
    """End state and times of events."""
    return np.concatenate([np.ravel(q), np.ravel(v)]).astype(float), times


def scenes() -> dict[str, tuple[hb.Problem, Any]]:
    """Problems with their events by name, and their closed end states and times where known."""
    found: dict[str, tuple[hb.Problem, Any]] = {}
    t, speed = 1.1 - 2 * FALL, 9.81 * FALL / 4
    bounced = closed(speed * t - 9.81 * t**2 / 2, speed - 9.81 * t, FALL * np.array([1.0, 2.0]))
    found["bounce"] = ball(1.1, events=bounce()), bounced
    meet = hb.Event(lambda t, q, v: q[1] - q[0], direction=-1, restitution=1.0, name="meet")
    wall = hb.Event(lambda t, q, v: q[0], direction=-1, restitution=1.0, name="wall")
    start = {"t_span": (0, 2.5), "q0": [1.0, 2.0], "v0": [0.5, -1.0], "events": [meet, wall]}
    swapped = closed([0.5, 2.25], [1.0, 0.5], [2 / 3], [2.0])  # they swap velocities
    found["two balls"] = hb.Problem(name="two balls", system=Free(), **start), swapped
    sides = [hb.Event(lambda t, q, v, i=i: q[i], direction=-1, restitution=0.5, name=f"wall {i}") for i in range(2)]
    start = {"t_span": (0, 2.0), "q0": [1.0, 2.0], "v0": [-1.0, -2.0], "events": sides}
    found["corner"] = hb.Problem(name="corner", system=Free(), **start), closed([0.5, 1.0], [0.5, 1.0], [1.0], [1.0])
    problem, gap = arm()
    grip = hb.Event(gap, direction=-1, during=ARM, then=GRIPPED, name="grip")
    drop = hb.Event(lambda t, q, v: t - 0.8, direction=1, during=GRIPPED, then=ARM, name="lets go")
    given = {"system": problem.system, "q0": problem.q0, "v0": problem.v0}
    found["capture"] = hb.Problem(name="capture", t_span=(0, 0.75), **given, events=[grip]), None
    found["release"] = hb.Problem(name="release", t_span=(0, 1.0), **given, events=[grip, drop]), None
    breaks, sticks = stick_slip(2)
    end = 0.5 * (sticks[1] + breaks[1]) + 0.1
    belt = hb.Problem(name="belt", system=STICKING, t_span=(0, end), q0=[0.0], v0=[SPEED], events=[BREAKS, STICKS])
    found["stick-slip"] = belt, None
    q0 = [0.0, ROD * np.sin(0.2), ROD * np.cos(0.2)]
    push = hb.Sampled(balance, every=0.01, delay=0.004)
    cart = hb.Problem(name="cart", system=Balanced(), t_span=(0, 0.3), q0=q0, v0=[0, 0, 0], inputs=push)
    found["sampled control"] = cart, None
    stop = hb.Event(lambda t, q, v: q[0] - 2.0, direction=1, restitution=0.5, name="end of the rail")
    rail = hb.Problem(name="rail", system=Crane(), t_span=(0, 6.0), q0=[0.0, 0.0, -4.0], v0=[0.0] * 3, events=[stop])
    found["end stop"] = rail, None
    return found


def errors(run: Any, truth: tuple[Any, tuple[Any, ...]], n: int) -> tuple[float, float]:
    """Errors of the end state and of the times of events, infinite where their numbers differ."""
    state, times = truth
    apart = np.abs(np.concatenate([run.q[-1, :n], run.v[-1, :n]]) - state).max()
    pairs = list(zip(run.t_events, times, strict=False))
    if any(np.size(one) != np.size(other) for one, other in pairs):
        return apart, np.inf
    return apart, max([float(np.max(np.abs(np.subtract(*pair)), initial=0.0)) for pair in pairs] or [0.0])


def lines(rtol: float) -> Iterator[str]:
    """Lines of the table."""
    yield f"rtol {rtol:g}: error of the end state in tolerances, error of times [s]"
    for name, (problem, known) in scenes().items():
        layout = getattr(problem.system, "layout", None)
        n = problem.q0.size if layout is None else layout.n
        truth = known
        if truth is None:
            best = hb.solve(problem, "projected", rtol=1e-12)
            truth = np.concatenate([best.q[-1, :n], best.v[-1, :n]]), best.t_events
        for solver in SOLVERS:
            run = hb.solve(problem, solver, rtol=rtol, max_seconds=60)
            if run.success:
                state, time = errors(run, truth, n)
                yield f"{name:16} {solver:24} {state / rtol:9.2g} {time:9.1e}"
            else:
                yield f"{name:16} {solver:24} {run.status.label}: {run.message[:80]}"


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for line in lines(*map(float, sys.argv[1:] or ["1e-7"])):
        sys.stdout.write(line + "\n")
        sys.stdout.flush()
