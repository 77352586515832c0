"""A length led by a stiff spring from another that a constraint drives; circles as in :mod:`.scenes`."""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
import numpy as np

from hhtbench.conformance.scenes.circles import FAST, FIRST, PRESS, SECOND, SLOW, arc, off_circle, on_circle
from hhtbench.conformance.scenes.scene import on_motion
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.system import System, parameter


class Hung(System):
    """Two circles: a constraint drives the arc length of the first, and a spring leads that of the second by it."""

    spring: Any = parameter(1.0, doc="[1/s^2]")
    damper: Any = parameter(0.0, doc="[1/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: between the lengths of both arcs, and against both circles."""
        y, z = arc(q, v, SLOW, FIRST, 1.0), arc(q, v, FAST, SECOND, 1.0)
        pull = self.spring * (y.length - z.length) + self.damper * (y.rate - z.rate)
        return -pull * y.tangent + (pull - jnp.sin(t)) * z.tangent + PRESS * (y.normal + z.normal)

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: the circles and the drive."""
        y = arc(q, q, SLOW, FIRST, 1.0)
        return jnp.stack([off_circle(q, SLOW, FIRST, 1.0), off_circle(q, FAST, SECOND, 1.0), y.length - jnp.sin(t)])


def hung(spring: float, damper: float, span: float) -> Problem:
    """Problem in which both arc lengths are sin t."""

    def exact(t: float) -> Motion:
        s, c = math.sin(t), math.cos(t)
        (q, v), (p, u) = on_circle(s, c, SLOW, FIRST, 1.0), on_circle(s, c, FAST, SECOND, 1.0)
        return Motion(q + p, v + u, np.array([PRESS + c * c, PRESS + c * c, s]), np.zeros(0))

    return on_motion("hung", Hung(spring=spring, damper=damper), exact, span)
