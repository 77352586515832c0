r"""Rigid bodies in space: unit quaternions, their inertia and the rows of joints, for one body or k at once.

Source: P. E. Nikravesh, Computer-Aided Analysis of Mechanical Systems, Prentice Hall 1988, chapters 6 and 7.

A quaternion ``p = (e0, e)`` has its scalar first.  All functions take ``p`` as (..., 4); leading axes count bodies, so
that any number of bodies compiles like one.  With ``G = [-e, e0 I - e x]`` and ``E = [-e, e0 I + e x]`` (3 x 4):

    R = E G^T,   w = 2 G p'  (rate in the body's frame),   2 E p' = R w  (in space)

R is homogeneous of degree 2 in p, and is a rotation where ``p.p = 1``.  Kinetic energy ``T = 2 (G p')^T J (G p')``.
Because G is linear in p, ``G(p') p = -G(p) p'`` and ``G(p') p' = 0``, Lagrange's equations are

    4 G^T J G p'' = F_p + ...,   F_p = -8 G(p')^T J G(p) p'.

``4 G^T J G`` is singular along p.  Adding ``4 j0 p p^T`` makes it regular; on the constraint ``p.p'' = -p'.p'``, so the
equations gain the radial term ``-4 j0 |p'|^2 p``, which only the multiplier of the norm can hold.  No term against it is
put into the force: the motion and the other multipliers do not depend on j0.

Coordinates of k bodies: ``(x1, p1, x2, p2, ...)``, 7 each, x the centre of mass.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.shapes import expect_bodies, expect_pairs, expect_rows, expect_split


def rate_tensor(side: float) -> Any:
    """Tensor (3, 4, 4) with ``tensor @ p = [-e, e0 I + side e x]``; side -1 gives G, +1 gives E."""
    tensor = np.zeros((3, 4, 4))
    i = np.arange(3)
    j, k = (i + 1) % 3, (i + 2) % 3
    tensor[i, 0, i + 1] = -1.0
    tensor[i, i + 1, 0] = 1.0
    tensor[i, k + 1, j + 1] = side  # (e x u)_i = e_j u_k - e_k u_j
    tensor[i, j + 1, k + 1] = -side
    return tensor


BODY, SPACE = rate_tensor(-1.0), rate_tensor(1.0)


def body_rate_matrix(p: Any) -> Array:
    """Matrix G (..., 3, 4) of the quaternion ``p`` (..., 4): body-fixed angular velocity ``w = 2 G p'``."""
    return jnp.einsum("ijk,...k->...ij", BODY, p)


def space_rate_matrix(p: Any) -> Array:
    """Matrix E (..., 3, 4) of the quaternion ``p`` (..., 4): angular velocity in space ``2 E p'``."""
    return jnp.einsum("ijk,...k->...ij", SPACE, p)


def rotation(p: Any) -> Array:
    """Rotation matrix R (..., 3, 3) of ``p`` (..., 4): maps components in the body's frame to components in space."""
    return jnp.einsum("...ij,...kj->...ik", space_rate_matrix(p), body_rate_matrix(p))


def body_rate(p: Any, pdot: Any) -> Array:
    """Angular velocity w (..., 3) in the body's frame [rad/s] from ``p`` and ``pdot`` (..., 4)."""
    return 2 * jnp.einsum("...ij,...j->...i", body_rate_matrix(p), pdot)


def space_rate(p: Any, pdot: Any) -> Array:
    """Angular velocity R w (..., 3) in space [rad/s] from ``p`` and ``pdot`` (..., 4)."""
    return 2 * jnp.einsum("...ij,...j->...i", space_rate_matrix(p), pdot)


def quaternion_rate(p: Any, rate: Any) -> Array:
    """Quaternion derivative p' (..., 4) [1/s] for the angular velocity ``rate`` (..., 3) in space [rad/s]."""
    return jnp.einsum("...ij,...i->...j", space_rate_matrix(p), jnp.asarray(rate)) / 2


def spin(J: Any, w: Array) -> Array:
    """Angular momentum ``J w`` (..., 3) in the body's frame; ``J`` (..., 3) principal moments or (..., 3, 3) tensors."""
    J = jnp.asarray(J)
    return J * w if J.ndim <= w.ndim else jnp.einsum("...ij,...j->...i", J, w)


def rotational_mass(p: Array, J: Any, j0: Any) -> Array:
    """Rotational mass matrix ``4 G^T J G + 4 j0 p p^T`` (..., 4, 4) [kg m^2]; ``J`` as in :func:`spin`, ``j0`` (...)."""
    G, J = body_rate_matrix(p), jnp.asarray(J)
    along = jnp.asarray(j0)[..., None, None] * p[..., :, None] * p[..., None, :]
    turned = jnp.einsum("...i,...ik->...ik", J, G) if J.ndim <= p.ndim else jnp.einsum("...il,...lk->...ik", J, G)
    return 4 * jnp.einsum("...ij,...ik->...jk", G, turned) + 4 * along


def rotational_force(p: Array, pdot: Array, J: Any) -> Array:
    """Quadratic velocity force ``F_p = -8 G(p')^T J G p'``, (..., 4) [N m]; ``J`` as in :func:`spin`."""
    return -4 * jnp.einsum("...ij,...i->...j", body_rate_matrix(pdot), spin(J, body_rate(p, pdot)))


def split(q: Any) -> tuple[Array, Array]:
    """Split ``q`` (7 k,) into centres (k, 3) and quaternions (k, 4); also velocities."""
    bodies = expect_split("q", jnp.asarray(q), 7)
    return bodies[:, :3], bodies[:, 3:]


def mass_of_bodies(q: Array, m: Any, J: Any, j0: Any) -> Array:
    """Mass matrix (7 k, 7 k), one block per body; masses ``m`` and ``j0`` (k,), ``J`` (k, 3) or (k, 3, 3)."""
    m = jnp.asarray(m)
    bodies = jnp.arange(m.size)
    blocks = jnp.zeros((m.size, 7, 7))
    blocks = blocks.at[:, :3, :3].set(m[:, None, None] * jnp.eye(3)).at[:, 3:, 3:].set(rotational_mass(split(q)[1], J, j0))
    return jnp.zeros((m.size, 7, m.size, 7)).at[bodies, :, bodies, :].set(blocks).reshape(q.size, q.size)


def force_on_bodies(q: Array, v: Array, m: Any, J: Any, gravity: Any) -> Array:
    """Generalised forces (7 k,) of weight and of the terms quadratic in p'; ``gravity`` (3,) [m/s^2]."""
    rotational = rotational_force(split(q)[1], split(v)[1], J)
    return jnp.concatenate([jnp.asarray(m)[:, None] * jnp.asarray(gravity), rotational], axis=1).ravel()


def energy_of_bodies(q: Array, v: Array, m: Any, J: Any, gravity: Any) -> Array:
    """Kinetic plus gravitational potential energy [J] of k bodies; ``j0`` does not contribute."""
    (x, p), (xdot, pdot), m = split(q), split(v), jnp.asarray(m)
    w = body_rate(p, pdot)
    return jnp.sum(m[:, None] * xdot**2) / 2 + jnp.sum(spin(J, w) * w) / 2 - m @ x @ jnp.asarray(gravity)


def moment_of_momentum(q: Array, v: Array, m: Any, J: Any) -> Array:
    """Angular momentum (3,) [kg m^2/s] of k bodies about the origin."""
    (x, p), (xdot, pdot) = split(q), split(v)
    turning = jnp.einsum("kij,kj->i", rotation(p), spin(J, body_rate(p, pdot)))
    return turning + jnp.asarray(m) @ jnp.cross(x, xdot)


def norm_rows(p: Array) -> Array:
    """Residuals ``p.p - 1`` (...) of the norm constraints of quaternions ``p`` (..., 4)."""
    return jnp.sum(p**2, axis=-1) - 1


class Placement(NamedTuple):
    """Positions of bodies: centres ``x`` (k + 1, 3) [m] and rotations ``R`` (k + 1, 3, 3); the last body is the ground."""

    x: Array
    R: Array


def placed_with_ground(q: Array) -> Placement:
    """Placement of the k bodies of ``q`` (7 k,) and of the ground, which is number k or -1 and has the frame of space."""
    x, p = split(q)
    return Placement(jnp.concatenate([x, jnp.zeros((1, 3))]), jnp.concatenate([rotation(p), jnp.eye(3)[None]]))


def points_on(at: Placement, body: Any, local: Any, name: str = "local") -> Array:
    """Positions (j, 3) [m] in space of the points ``local`` (j, 3) in the frames of the bodies numbered ``body`` (j,).

    Raises
    ------
    ValueError
        ``local`` has another shape; the text calls it ``name``.
    """
    body = expect_bodies("body", body, len(at.x))
    return at.x[body] + jnp.einsum("jab,jb->ja", at.R[body], expect_rows(name, local, body, 3))


def in_frame(at: Placement, body: Any, vector: Any) -> Array:
    """Components (j, 3) in the frames of the bodies numbered ``body`` (j,) of ``vector`` (j, 3) in space."""
    body = expect_bodies("body", body, len(at.x))
    return jnp.einsum("jba,jb->ja", at.R[body], expect_rows("vector", vector, body, 3))


def spherical_rows(at: Placement, first: Any, second: Any, a: Any, b: Any) -> Array:
    """Residuals (3 j,) [m] of spherical joints: points ``a`` (j, 3) of bodies ``first`` minus points ``b`` of ``second``."""
    first, second = expect_pairs(first, second, len(at.x))
    return (points_on(at, first, a, "a") - points_on(at, second, b, "b")).ravel()


def perpendicular_rows(at: Placement, first: Any, second: Any, across: Any, axis: Any) -> Array:
    """Scalar products (2 j,) of two directions ``across`` (j, 2, 3) of ``first`` with ``axis`` (j, 3) of ``second``."""
    first, second = expect_pairs(first, second, len(at.x))
    turned = jnp.einsum("jcb,jab->jca", expect_rows("across", across, first, 2, 3), at.R[first])
    return jnp.einsum("jca,jab,jb->jc", turned, at.R[second], expect_rows("axis", axis, second, 3)).ravel()


def revolute_rows(at: Placement, first: Any, second: Any, a: Any, b: Any, across: Any, axis: Any) -> Array:
    """Residuals (5 j,) of revolute joints: a common point and a common axis.

    ``axis`` (j, 3) belongs to ``second``; ``across`` (j, 2, 3) spans the plane normal to it in ``first``.
    """
    return jnp.concatenate([spherical_rows(at, first, second, a, b), perpendicular_rows(at, first, second, across, axis)])


def velocity_at(q: Array, v: Array, body: Any, offset: Any) -> Array:
    """Velocities (j, 3) [m/s] in space of body points at ``offset`` (j, 3) [m] from the centres of the bodies ``body``
    (j,).

    A body rolls if this is zero at its point of contact: a velocity constraint.
    """
    (_, p), (xdot, pdot) = split(q), split(v)
    body = expect_bodies("body", body, len(p), ground=False)
    return xdot[body] + jnp.cross(space_rate(p[body], pdot[body]), expect_rows("offset", offset, body, 3))


def carried(q: Any, velocity: Any, rate: Any, spins: Any) -> Array:
    """Velocities (7 k,) of bodies that a moving frame carries and that spin about axes fixed in themselves.

    Affine in ``q`` (7 k,): the ``along`` of a steady motion for :func:`hhtbench.modes`, as of wheels that roll.

    Parameters
    ----------
    velocity, rate
        (3,) velocity [m/s] of the frame at the origin and its angular velocity [rad/s], in space.
    spins
        (k, 3) angular velocities of the bodies relative to the frame, in the bodies' frames [rad/s].
    """
    x, p = split(q)
    turning = quaternion_rate(p, jnp.broadcast_to(jnp.asarray(rate), x.shape))
    spinning = jnp.einsum("kij,ki->kj", body_rate_matrix(p), expect_rows("spins", spins, jnp.arange(len(p)), 3)) / 2
    return jnp.concatenate([jnp.asarray(velocity) + jnp.cross(jnp.asarray(rate), x), turning + spinning], axis=1).ravel()
