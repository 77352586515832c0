"""Rigid bodies in the plane and their joints, for one body or k at once.

Coordinates of k bodies: ``(x1, y1, angle1, x2, y2, angle2, ...)``, 3 each, (x, y) the centre of mass [m], angles [rad]
counterclockwise.  ``*_rows`` return constraint residuals, zero where the joint holds; points and directions are in the
frames of their bodies.
Source: P. E. Nikravesh, Computer-Aided Analysis of Mechanical Systems, Prentice Hall 1988, chapters 4 and 5.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from hhtbench.mechanics.shapes import expect_bodies, expect_pairs, expect_rows, expect_split


class Placement(NamedTuple):
    """Positions of bodies: centres ``x`` (k + 1, 2) [m] and ``angle`` (k + 1,) [rad]; the last body is the ground."""

    x: Array
    angle: Array


def placed_with_ground(q: Array) -> Placement:
    """Placement of the k bodies of ``q`` (3 k,) and of the ground, which is number k or -1 and has the plane's frame."""
    bodies = jnp.concatenate([expect_split("q", q, 3), jnp.zeros((1, 3))])
    return Placement(bodies[:, :2], bodies[:, 2])


def turned(angle: Any, vector: Any) -> Array:
    """Rotate ``vector`` (..., 2) by ``angle`` (...) [rad] counterclockwise."""
    c, s, vector = jnp.cos(angle), jnp.sin(angle), jnp.asarray(vector)
    x, y = vector[..., 0], vector[..., 1]
    return jnp.stack([c * x - s * y, s * x + c * y], axis=-1)


def points_on(at: Placement, body: Any, local: Any, name: str = "local") -> Array:
    """Positions (j, 2) [m] in the plane of the points ``local`` (j, 2) in the frames of the bodies numbered ``body`` (j,).

    Raises
    ------
    ValueError
        ``local`` has another shape; the text calls it ``name``.
    """
    body = expect_bodies("body", body, len(at.x))
    return at.x[body] + turned(at.angle[body], expect_rows(name, local, body, 2))


def in_frame(at: Placement, body: Any, vector: Any) -> Array:
    """Components (j, 2) in the frames of the bodies numbered ``body`` (j,) of ``vector`` (j, 2) in the plane."""
    body = expect_bodies("body", body, len(at.x))
    return turned(-at.angle[body], expect_rows("vector", vector, body, 2))


def revolute_rows(at: Placement, first: Any, second: Any, a: Any, b: Any) -> Array:
    """Residuals (2 j,) [m] of revolute joints: points ``a`` (j, 2) of bodies ``first`` minus points ``b`` of ``second``."""
    first, second = expect_pairs(first, second, len(at.x))
    return (points_on(at, first, a, "a") - points_on(at, second, b, "b")).ravel()


def slot_rows(at: Placement, first: Any, second: Any, a: Any, b: Any, along: Any) -> Array:
    """Residuals (j,) [m] of pins at ``a`` of ``first`` in slots of ``second`` through ``b`` along unit vectors ``along``
    (j, 2).
    """
    first, second = expect_pairs(first, second, len(at.x))
    apart = points_on(at, first, a, "a") - points_on(at, second, b, "b")
    direction = turned(at.angle[second], expect_rows("along", along, second, 2))
    return direction[:, 0] * apart[:, 1] - direction[:, 1] * apart[:, 0]


def angle_rows(at: Placement, first: Any, second: Any, angle: Any = 0.0) -> Array:
    """Residuals (j,) [rad] of fixed relative angles: angle of ``first`` minus angle of ``second`` minus ``angle`` (j,)."""
    first, second = expect_pairs(first, second, len(at.x))
    return at.angle[first] - at.angle[second] - jnp.asarray(angle)


def prismatic_rows(at: Placement, first: Any, second: Any, a: Any, b: Any, along: Any, angle: Any = 0.0) -> Array:
    """Residuals (2 j,) of prismatic joints: :func:`slot_rows`, then :func:`angle_rows`."""
    return jnp.concatenate([slot_rows(at, first, second, a, b, along), angle_rows(at, first, second, angle)])


def velocity_at(v: Array, body: Any, offset: Any) -> Array:
    """Velocities (j, 2) [m/s] of body points at ``offset`` (j, 2) [m] from the bodies' centres, in the plane's frame.

    A body rolls if this is zero at its point of contact: a velocity constraint.
    """
    velocities = expect_split("v", v, 3)
    body = expect_bodies("body", body, len(velocities), ground=False)
    bodies, offset = velocities[body], expect_rows("offset", offset, body, 2)
    rate = bodies[..., 2:]
    return bodies[..., :2] + rate * jnp.stack([-offset[..., 1], offset[..., 0]], axis=-1)


def mass_of_bodies(m: Any, J: Any) -> Array:
    """Diagonal (3 k,) of the mass matrix from masses ``m`` (k,) [kg] and central moments of inertia ``J`` (k,) [kg m^2]."""
    m, J = jnp.atleast_1d(jnp.asarray(m), jnp.asarray(J))
    if m.ndim != 1 or m.shape != J.shape:
        raise ValueError(f"m and J must hold a number for each body; got shapes {m.shape} and {J.shape}.")
    return jnp.stack([m, m, J], axis=-1).ravel()


def weight_of_bodies(m: Any, gravity: Any) -> Array:
    """Generalised forces (3 k,) of the weights of masses ``m`` (k,) [kg] under ``gravity`` (2,) [m/s^2]."""
    m, gravity = jnp.asarray(m), jnp.asarray(gravity)
    if gravity.shape != (2,):
        raise ValueError(f"gravity must have the shape (2,); got {gravity.shape}.")
    return jnp.concatenate([m[:, None] * gravity, jnp.zeros((m.size, 1))], axis=1).ravel()


def energy_of_bodies(q: Array, v: Array, m: Any, J: Any, gravity: Any) -> Array:
    """Kinetic plus gravitational potential energy [J] of k bodies; masses ``m`` and moments ``J`` (k,)."""
    heights = q.reshape(-1, 3)[:, :2] @ jnp.asarray(gravity)
    return jnp.sum(mass_of_bodies(m, J) * v**2) / 2 - jnp.asarray(m) @ heights
