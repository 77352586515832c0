"""Angles, travels and their rates of the joints of a mechanism at states, and as functions of the state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.forces import rates
from hhtbench.mechanics.multibody.frames import product, quaternion
from hhtbench.mechanics.multibody.parts import GROUND, Joint
from hhtbench.mechanics.multibody.rows import Rows, angles, counted, travels, turning

TURNING = "revolute", "cylindrical"  # joints with an angle
SLIDING = "prismatic", "cylindrical", "on_line"  # with a travel


def _rows(m: Any, joints: Sequence[Joint]) -> tuple[Rows, Any, Any]:
    """Rows of the angles of ``joints``, and the joints' axes (j, d) in the first and in the second bodies."""
    first, second = (tuple(m.number(getattr(joint, side)) for joint in joints) for side in ("first", "second"))
    a, b = (np.array([joint.points[i] for joint in joints]) for i in (0, 1))
    one, other = (np.array([joint.frames[i] for joint in joints]) for i in (0, 1))
    laws = (None,) * len(joints)
    drawn = np.array([joint.drawn for joint in joints])
    rows = Rows(
        first=first, second=second, laws=laws, a=a, b=b, u=one[:, :, 0], w=other[:, :, 0], y=one[:, :, 1], value=drawn
    )
    return rows, one[:, :, -1], other[:, :, -1]


def moves(m: Any, q: Any, v: Any) -> Any:
    """Angles, in space in (-pi, pi], travels, rates of both (k, j) of all joints at states ``q, v`` (n,) or (k, n)."""
    rows, axis, axis_second = _rows(m, list(m.joints.values()))
    return [np.asarray(x) for x in _moves(m.frame, rows, axis, axis_second, np.atleast_2d(q), np.atleast_2d(v))]


@eqx.filter_jit
def _moves(frame: Any, rows: Rows, axis: Any, axis_second: Any, q: Any, v: Any) -> Any:
    sliding = eqx.tree_at(lambda one: one.u, rows, axis)
    turned = eqx.tree_at(lambda one: one.b, rows, axis_second)

    def one(q: Any, v: Any) -> Any:
        travel, speed = rates(lambda q: travels(frame.placed(q), sliding), q, v)
        return angles(frame.placed(q), rows), travel, turning(frame, turned, q, v), speed

    return jax.vmap(one)(q, v)


def at_present(m: Any, joint: Joint) -> tuple[float, Any]:
    """Angle [rad] of a joint in space at the present pose, with its turns, and the quaternions (2, 4) of ``counted``.

    They are the rotation r of the second body in the first, and the derivative of r by half the angle.
    """
    (_, R1, _), (_, R2, _) = m.pose(joint.first), m.pose(joint.second)
    cosine, sine, _ = (R1 @ joint.frames[0]).T @ (R2 @ joint.frames[1])[:, 0]
    one, other = (
        np.eye(4)[0] if name == GROUND else quaternion(m.bodies[name].R, m.bodies[name].p)
        for name in (joint.first, joint.second)
    )
    r = product(one * [1, -1, -1, -1], other)
    turn = product(r, np.array([0.0, *joint.frames[1][:, 2]]))
    return float(np.arctan2(sine, cosine)) + 2 * np.pi * joint.turns, np.stack([r, turn])


class Measure(eqx.Module):
    """Angle [rad] or travel [m] of one joint as a function of the coordinates."""

    frame: Any = eqx.field(static=True)
    rows: Rows
    near: Any  #: see ``counted``; unused in the plane
    slides: bool = eqx.field(static=True)
    size: int = eqx.field(static=True)  #: number of coordinates of the bodies

    def __call__(self, q: Array) -> Array:
        """Angle or travel, a number."""
        at = self.frame.placed(q[: self.size])
        return (travels(at, self.rows) if self.slides else counted(at, self.rows, self.near))[0]

    def value(self, q: Any) -> Any:
        """The same, compiled outside of traced functions."""
        return self(q) if isinstance(q, jax.core.Tracer) else _value(self, q)

    def rate(self, q: Any, v: Any) -> Any:
        """Its rate, likewise."""
        traced = isinstance(q, jax.core.Tracer) or isinstance(v, jax.core.Tracer)
        return jax.jvp(self, (q,), (v,))[1] if traced else _rate(self, jnp.asarray(q), jnp.asarray(v))


@eqx.filter_jit
def _value(measure: Measure, q: Any) -> Any:
    return measure(q)


@eqx.filter_jit
def _rate(measure: Measure, q: Any, v: Any) -> Any:
    return jax.jvp(measure, (q,), (v,))[1]


def measure_of(m: Any, joint: Joint, *, slides: bool) -> Measure:
    """The angle or the travel of ``joint``."""
    rows, axis, _ = _rows(m, [joint])
    near: Any = 0.0
    if slides:
        rows = eqx.tree_at(lambda one: one.u, rows, axis)
    elif not m.plane:
        value, quaternions = at_present(m, joint)
        rows, near = eqx.tree_at(lambda one: one.value, rows, np.array([value])), quaternions[None]
    return Measure(m.frame, rows, jnp.asarray(near), slides, m.frame.size * len(m.bodies))


def function_of(measure: Measure, *, rate: bool) -> Callable[[Any, Any, Any], Any]:
    """``measure`` or its rate as a function of (t, q, v), a plain one, as events need to become machine code."""
    if rate:
        return lambda t, q, v: measure.rate(q, v)
    return lambda t, q, v: measure.value(q)
