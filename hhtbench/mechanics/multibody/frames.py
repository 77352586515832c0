"""Rigid bodies in space and in the plane behind one interface, for systems that serve both.

``q`` holds 7 numbers for each body in space (centre, unit quaternion), 3 in the plane (centre, angle).
Source: the modules ``space`` and ``plane``.
"""

from __future__ import annotations

from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import plane, space

ROUNDOFF = 1e-14  # of entries of rotation matrices


class Placed(NamedTuple):
    """Positions of bodies: centres ``x`` (k + 1, d) [m], rotations ``R`` (k + 1, d, d) and, in the plane, ``angle``
    (k + 1,) [rad], in space quaternions ``p`` (k + 1, 4); the last body is the ground.
    """

    x: Array
    R: Array
    angle: Array | None = None
    p: Array | None = None

    def point(self, bodies: tuple[int, ...], local: Any) -> Array:
        """Positions (j, d) [m] of the points ``local`` (j, d) of the bodies numbered ``bodies`` (j,)."""
        return self.x[np.array(bodies)] + self.along(bodies, local)

    def along(self, bodies: tuple[int, ...], local: Any) -> Array:
        """Components (j, d) in space of directions ``local`` (j, d) of the bodies numbered ``bodies`` (j,)."""
        return jnp.einsum("jab,jb->ja", self.R[np.array(bodies)], jnp.asarray(local))

    def local(self, bodies: tuple[int, ...], place: Any) -> Array:
        """Coordinates (j, d) in the frames of the bodies numbered ``bodies`` of the points ``place`` (j, d) [m] in space."""
        numbers = np.array(bodies)
        return jnp.einsum("jba,jb->ja", self.R[numbers], place - self.x[numbers])


@jax.jit
def _quaternion_rates(q: Any, rate: Any) -> Array:
    return space.quaternion_rate(space.split(q)[1], rate)


class Space:
    """Bodies in space.

    Rotations are ``R(p) / (p.p)``, which does not change with the length of p: so the rows of joints do not load the norm of
    the quaternions, and least multipliers of redundant rows do not depend on j0.
    """

    dimension: ClassVar[int] = 3
    size: ClassVar[int] = 7  #: coordinates of a body
    module: ClassVar[Any] = space

    @staticmethod
    def placed(q: Array) -> Placed:
        """Positions of the bodies of ``q`` and of the ground."""
        x, p = space.split(q)
        R = space.rotation(p) / jnp.sum(p**2, axis=-1)[:, None, None]
        with_ground = (jnp.concatenate([a, b[None]]) for a, b in ((x, jnp.zeros(3)), (R, jnp.eye(3)), (p, jnp.eye(4)[0])))
        x, R, p = with_ground
        return Placed(x, R, p=p)

    @staticmethod
    def own_rows(q: Array) -> Array:
        """Residuals (k,) of the norms of the quaternions."""
        return space.norm_rows(space.split(q)[1])

    @staticmethod
    def coordinates(x: Any, p: Any) -> Any:
        """Coordinates (7 k,) of bodies with centres ``x`` (k, 3) and quaternions ``p`` (k, 4)."""
        return np.concatenate([np.asarray(x), np.asarray(p)], axis=1).ravel()

    @staticmethod
    def velocities(q: Any, velocity: Any, rate: Any) -> Any:
        """Velocities (7 k,) from those of the centres (k, 3) and angular velocities ``rate`` (k, 3) in space."""
        turning = _quaternion_rates(np.asarray(q), np.asarray(rate))
        return np.concatenate([np.asarray(velocity), np.asarray(turning)], axis=1).ravel()

    @staticmethod
    def rates(q: Array, v: Array) -> Array:
        """Angular velocities (k + 1, 3) [rad/s] in space of the bodies and of the ground."""
        w = space.space_rate(space.split(q)[1], space.split(v)[1])
        return jnp.concatenate([w, jnp.zeros((1, 3))])

    @staticmethod
    def velocity_at(q: Array, v: Array, bodies: tuple[int, ...], offset: Array) -> Array:
        """Velocities (j, 3) [m/s] of points at ``offset`` (j, 3) [m] from the centres of the bodies numbered ``bodies``."""
        numbers, centres = np.array(bodies), jnp.concatenate([space.split(v)[0], jnp.zeros((1, 3))])
        return centres[numbers] + jnp.cross(Space.rates(q, v)[numbers], offset)

    @staticmethod
    def wrench(q: Array, forces: Array, torques: Array) -> Array:
        """Generalised forces (7 k,) of ``forces`` at the centres and ``torques`` in space, (k, 3) each."""
        turning = 2 * jnp.einsum("kij,ki->kj", space.space_rate_matrix(space.split(q)[1]), torques)
        return jnp.concatenate([forces, turning], axis=1).ravel()

    @staticmethod
    def forces_of(q: Any, Q: Any) -> tuple[Array, Array]:
        """Forces at the centres and torques in space, (k, 3) each, of generalised forces ``Q`` (7 k,): ``n = E Q_p / 2``."""
        forces, turning = space.split(jnp.asarray(Q))
        return forces, jnp.einsum("kij,kj->ki", space.space_rate_matrix(space.split(jnp.asarray(q))[1]), turning) / 2


class Plane:
    """Bodies in the plane; rates and torques about its normal are numbers."""

    dimension: ClassVar[int] = 2
    size: ClassVar[int] = 3
    module: ClassVar[Any] = plane

    @staticmethod
    def placed(q: Array) -> Placed:
        """Positions of the bodies of ``q`` and of the ground."""
        at = plane.placed_with_ground(q)
        return Placed(at.x, jnp.stack([plane.turned(at.angle, x) for x in np.eye(2)], axis=-1), at.angle)

    @staticmethod
    def own_rows(q: Array) -> Array:
        """No residuals."""
        return jnp.zeros(0)

    @staticmethod
    def coordinates(x: Any, angle: Any) -> Any:
        """Coordinates (3 k,) of bodies with centres ``x`` (k, 2) and angles (k,)."""
        return np.concatenate([np.asarray(x), np.asarray(angle)[:, None]], axis=1).ravel()

    velocities = staticmethod(lambda q, velocity, rate: Plane.coordinates(velocity, rate))

    @staticmethod
    def rates(q: Array, v: Array) -> Array:
        """Angular velocities (k + 1,) [rad/s] of the bodies and of the ground."""
        return jnp.append(v.reshape(-1, 3)[:, 2], 0.0)

    @staticmethod
    def velocity_at(q: Array, v: Array, bodies: tuple[int, ...], offset: Array) -> Array:
        """Velocities (j, 2) [m/s] of points at ``offset`` (j, 2) [m] from the centres of the bodies numbered ``bodies``."""
        numbers, centres = np.array(bodies), jnp.concatenate([v.reshape(-1, 3)[:, :2], jnp.zeros((1, 2))])
        across = jnp.stack([-offset[:, 1], offset[:, 0]], axis=1)
        return centres[numbers] + Plane.rates(q, v)[numbers, None] * across

    @staticmethod
    def wrench(q: Array, forces: Array, torques: Array) -> Array:
        """Generalised forces (3 k,) of ``forces`` (k, 2) at the centres and ``torques`` (k,)."""
        return jnp.concatenate([forces, torques[:, None]], axis=1).ravel()

    @staticmethod
    def forces_of(q: Any, Q: Any) -> tuple[Array, Array]:
        """Forces (k, 2) at the centres and torques (k,) of generalised forces ``Q`` (3 k,)."""
        parts = jnp.reshape(Q, (-1, 3))
        return parts[:, :2], parts[:, 2]


def product(p: Any, r: Any) -> Any:
    """Product (4,) of two quaternions: the rotation ``p`` after ``r``."""
    return np.array([p[0] * r[0] - p[1:] @ r[1:], *(p[0] * r[1:] + r[0] * p[1:] + np.cross(p[1:], r[1:]))])


def quaternion(R: Any, near: Any = None) -> Any:
    """Unit quaternion (4,), scalar first, of a rotation matrix ``R`` (3, 3).

    Of both signs that of ``near`` (4,), or the one with a scalar not below 0; ``near`` itself if its rotation is ``R``.

    It is the eigenvector of the largest eigenvalue of a symmetric matrix: I. Y. Bar-Itzhack, New method for extracting the
    quaternion from a rotation matrix, Journal of Guidance, Control, and Dynamics 23 (2000) 1085-1087.
    """
    R = np.asarray(R, dtype=float)
    if near is not None and np.max(np.abs(np.asarray(space.rotation(near)) - R)) < ROUNDOFF:
        return np.asarray(near)
    axial = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    K = np.block([[np.trace(R), axial[None]], [axial[:, None], R + R.T - np.trace(R) * np.eye(3)]])
    p = np.linalg.eigh(K)[1][:, -1]
    return -p if (p[0] if near is None else p @ near) < 0 else p
