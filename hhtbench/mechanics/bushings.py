"""Bushings between bodies: springs and dampers against all relative translations and rotations of two frames.

A bushing is a measure and a law: ``forces.force_of(offsets, forces.spring_damper(k, c, 0.0), q, v)`` with the offsets of
this module, ``k`` and ``c`` one number per offset.  The offsets do not change when both bodies move as one rigid body, so
forces and moments on the two bodies are in balance by virtual work.  The ground is body -1.

Source: forces by virtual work as in ``forces``; the rotation vector (angle times axis) as in M. Geradin and A. Cardona,
Flexible Multibody Dynamics, Wiley 2001.
"""

from __future__ import annotations

import math
from typing import Any

import jax.numpy as jnp
from jax import Array

from hhtbench.mechanics import plane, space
from hhtbench.mechanics.shapes import expect_pairs

SERIES_BELOW = 0.002  #: 1 - cos(angle) below which ``angle / sin(angle)`` is a series: six terms reach roundoff there
SERIES = [math.factorial(n) / math.prod(range(1, 2 * n + 2, 2)) for n in range(6)]  #: n! / (2 n + 1)!!, powers of 1 - cos


def offsets_in_plane(at: plane.Placement, first: Any, second: Any, a: Any, b: Any) -> Array:
    """Offsets (j, 3) [m, m, rad] of bushings: from points ``a`` (j, 2) of bodies ``first`` to points ``b`` of ``second``, in
    the frame of the first, and the angle of the second less that of the first.
    """
    first, second = expect_pairs(first, second, len(at.x))
    apart = plane.in_frame(at, first, plane.points_on(at, second, b, "b") - plane.points_on(at, first, a, "a"))
    return jnp.concatenate([apart, plane.angle_rows(at, second, first)[:, None]], axis=1)


def offsets_in_space(at: space.Placement, first: Any, second: Any, a: Any, b: Any) -> Array:
    """Offsets (j, 6) [m, rad] of bushings: from points ``a`` (j, 3) of bodies ``first`` to points ``b`` of ``second``, and
    the rotation vector from the first to the second, both in the frame of the first.

    The frames of the two bodies are parallel in the free bushing.  The rotation vector jumps at half a turn.
    """
    first, second = expect_pairs(first, second, len(at.x))
    apart = space.in_frame(at, first, space.points_on(at, second, b, "b") - space.points_on(at, first, a, "a"))
    return jnp.concatenate([apart, rotation_vector(jnp.einsum("jba,jbc->jac", at.R[first], at.R[second]))], axis=1)


def rotation_vector(R: Any) -> Array:
    """Rotation vectors (..., 3) [rad], angle times axis, of matrices ``R`` (..., 3, 3); smooth below half a turn."""
    R = jnp.asarray(R)
    axial = jnp.stack([R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], axis=-1) / 2
    less = (3 - jnp.trace(R, axis1=-2, axis2=-1)) / 2  # 1 - cos(angle)
    small = less < SERIES_BELOW
    sine = jnp.linalg.norm(jnp.where(small[..., None], 1.0, axial), axis=-1)  # no square root of zero is differentiated
    ratio = jnp.where(small, jnp.polyval(jnp.array(SERIES[::-1]), less), jnp.arctan2(sine, 1 - less) / sine)
    return ratio[..., None] * axial
