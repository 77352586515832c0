"""Problems with events, as files for the bench."""

from __future__ import annotations

from hhtbench.protocol.problem import Problem
from tests.eventful.test_eventful import BRAKE, STOP, Crane
from tests.eventful.test_switches import BREAKS, SPEED, STICKING, STICKS


def belt() -> Problem:
    """A block on a belt, which sticks and slips."""
    return Problem(name="belt", system=STICKING, t_span=(0.0, 2.0), q0=[0.0], v0=[SPEED], events=[BREAKS, STICKS])


def crane() -> Problem:
    """A crane with two events."""
    start = {"q0": [0.0, 0.0, -4.0], "v0": [0.0] * 3}
    return Problem(name="crane", system=Crane(), t_span=(0.0, 10.0), **start, events=[STOP, BRAKE])
