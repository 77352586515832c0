"""Springs, bushings, contacts and loads between bodies, one vectorised family for each kind."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import contact, forces, tyres
from hhtbench.mechanics.bushings import rotation_vector
from hhtbench.mechanics.multibody.frames import Placed
from hhtbench.mechanics.multibody.rows import OfTime, Rows, angles, counted, lengths
from hhtbench.protocol.system import parameter

WINDING = 2 * np.pi - 0.5  # radians that torsion springs in space turn from their start; steps must not cross the rest
Measure = Callable[[Array], Array]
Tensions = Callable[[Array, Array], Array]


class Springs(eqx.Module):
    """j springs with dampers: of the distances of points, of angles or, as bushings, of all offsets of two frames."""

    rows: Rows
    stiffness: Any = parameter(doc="one number for each measured one [N/m, N m/rad]")
    damping: Any = parameter(doc="[N s/m, N m s/rad]")
    free: Any = parameter(doc="measures without force [m, rad]")
    axes: Any = parameter(0.0, doc="of bushings: frames in the first and in the second bodies (j, 2, d, d)")
    near: Any = parameter(0.0, doc="of torsion springs in space: quaternions, see rows.counted (j, 2, 4)")

    @property
    def law(self) -> Tensions:
        """Tensions over measures and their rates."""
        return forces.spring_damper(self.stiffness, self.damping, self.free)

    def energy(self, measured: Array) -> Array:
        """Energy [J] of the springs."""
        return jnp.sum(self.stiffness * (measured - self.free) ** 2) / 2


class Contacts(eqx.Module):
    """j contacts of points, circles or balls of the first bodies with planes, balls or cylinders of the second."""

    rows: Rows  #: ``a`` centres of the first; ``b`` centres or points of planes, ``w`` their normals, axes of cylinders
    radius: Any = parameter(doc="of the first (j,) [m]")
    other: Any = parameter(doc="of the second (j,) [m], below 0 for a hollow one; unused by planes")
    stiffness: Any = parameter(doc="(j,) [N/m^power]")
    loss: Any = parameter(doc="(j,) [s/m]")
    onset: Any = parameter(doc="(j,) [m]")
    power: Any = parameter(doc="(j,)")
    rub: Any = parameter(doc="law along the surface: friction coefficient and creep (j, 2) [1, m/s]")
    balls: bool = eqx.field(static=True, default=False)
    cylinders: bool = eqx.field(static=True, default=False)  #: some of the balls have an axis
    rubs: bool = eqx.field(static=True, default=False)

    @property
    def law(self) -> Tensions:
        """Tensions, below 0, over gaps and their rates."""
        return contact.hunt_crossley(self.stiffness, self.loss, self.onset, self.power)

    def energy(self, measured: Array) -> Array:
        """Energy [J] of the contacts."""
        return contact.contact_energy(measured, self.stiffness, self.onset, self.power)

    def touching(self, at: Placed) -> contact.Contact:
        """Gaps, normals and points."""
        centre, other = self.rows.points(at)
        if self.cylinders:
            return contact.on_cylinder(centre, self.radius, other, at.along(self.rows.second, self.rows.w), self.other)
        if self.balls:
            return contact.on_sphere(centre, self.radius, other, self.other)
        return contact.on_plane(centre, self.radius, other, at.along(self.rows.second, self.rows.w))

    def friction(self, frame: Any, q: Array, v: Array) -> Array:
        """Generalised force (n,) along the surfaces."""
        touching, force = self._along(frame, q, v)
        bodies = np.array(self.rows.first + self.rows.second)
        levers = jnp.tile(touching.point, (2, 1)) - frame.placed(q).x[bodies]
        return generalised(frame, q, bodies, levers, jnp.concatenate([force, -force]))

    def rubbing(self, frame: Any, q: Array, v: Array) -> Array:
        """Forces (j, d) [N] along the surfaces on the first bodies."""
        return self._along(frame, q, v)[1]

    def resistance(self, frame: Any, touching: contact.Contact, push: Array, sliding: Array, q: Array, v: Array) -> Array:
        """The law along the surfaces: forces (j, d) [N] at the velocities ``sliding`` (j, d) [m/s]."""
        return contact.friction(push, sliding, self.rub[:, 0], self.rub[:, 1])

    def _along(self, frame: Any, q: Array, v: Array) -> tuple[contact.Contact, Array]:
        touching, push = self._pressed(frame, q, v)
        return touching, self.resistance(frame, touching, push, self._sliding(frame, touching, touching.point, q, v), q, v)

    def _pressed(self, frame: Any, q: Array, v: Array) -> tuple[contact.Contact, Array]:
        """Contacts and their normal forces (j,) [N]."""
        gap, rate = forces.rates(lambda y: self.touching(frame.placed(y)).gap, q, v)
        return self.touching(frame.placed(q)), -self.law(gap, rate)

    def _sliding(self, frame: Any, touching: contact.Contact, points: Array, q: Array, v: Array) -> Array:
        """Velocities (j, d) [m/s] of the first against the second at ``points`` (j, d), along the surfaces."""
        x, bodies = frame.placed(q).x, (self.rows.first, self.rows.second)
        first, second = (frame.velocity_at(q, v, one, points - x[np.array(one)]) for one in bodies)
        return contact.along(first - second, touching.normal)


class Tyres(Contacts):
    """j tyres: wheels of the first bodies, with axles ``u``, on planes of the second; ``rub`` is (j, 4), their grip."""

    def touching(self, at: Placed) -> contact.Contact:
        """Gaps, normals and points."""
        centre, origin = self.rows.points(at)
        normal = at.along(self.rows.second, self.rows.w)
        if at.angle is not None:
            return contact.on_plane(centre, self.radius, origin, normal)
        return tyres.wheel_on_plane(centre, self.radius, at.along(self.rows.first, self.rows.u), origin, normal)

    def resistance(self, frame: Any, touching: contact.Contact, push: Array, sliding: Array, q: Array, v: Array) -> Array:
        """Forces (j, d) [N] by slip."""
        return tyres.slip_force(push, sliding, *self._travelling(frame, touching, q, v), self.rub)

    def slip(self, frame: Any, q: Array, v: Array) -> Array:
        """Slips (j, 2) along and across the rolling directions; in the plane (j,)."""
        touching, _ = self._pressed(frame, q, v)
        travel, ahead = self._travelling(frame, touching, q, v)
        ratio = self._sliding(frame, touching, touching.point, q, v) / tyres.reference_speed(travel, self.rub[:, 3])[:, None]
        along = jnp.sum(ratio * ahead, axis=1)
        if frame.dimension == 2:
            return along
        return jnp.stack([along, jnp.sum(ratio * jnp.cross(touching.normal, ahead), axis=1)], axis=1)

    def _travelling(self, frame: Any, touching: contact.Contact, q: Array, v: Array) -> tuple[Array, Array]:
        """Velocities (j, d) [m/s] of the centres along the road, and rolling directions (j, d)."""
        at = frame.placed(q)
        axis = None if at.angle is not None else at.along(self.rows.first, self.rows.u)
        travelling = self._sliding(frame, touching, self.rows.points(at)[0], q, v)
        return travelling, tyres.rolling_directions(axis, touching.normal)


class Loads(eqx.Module):
    """Forces on points and torques on bodies, constant or by laws."""

    rows: Rows  #: bodies ``second``, points ``b``; ``laws`` of the forces
    force: Any = parameter(doc="(j, d) [N]")
    torque: Any = parameter(doc="(j, 3) in space, (j,) in the plane [N m]")
    torques: tuple[OfTime | None, ...] = ()  #: laws of the torques
    follows: tuple[bool, ...] = eqx.field(static=True, default=())  #: whether components are in the body's frame

    def generalised(self, frame: Any, given: dict[str, Any]) -> Array:
        """Generalised force (n,) at what is given by name."""
        q = given["q"]
        at, bodies = frame.placed(q), np.array(self.rows.second)
        found = [_set(self.force, self.rows.laws, given), _set(self.torque, self.torques, given)]
        follows = np.array(self.follows)[:, None]
        turned = [at.along(self.rows.second, x) if x.ndim > 1 else x for x in found]
        force, torque = (jnp.where(follows, x, y) if x.ndim > 1 else y for x, y in zip(turned, found, strict=True))
        return generalised(frame, q, bodies, at.along(self.rows.second, self.rows.b), force, torque)


def generalised(frame: Any, q: Array, bodies: Any, levers: Array, force: Array, torque: Any = 0.0) -> Array:
    """Generalised force (n,) of forces (j, d) [N] at ``levers`` (j, d) [m] from the centres of ``bodies``, and torques."""
    moment = jnp.cross(levers, force) if frame.dimension == 3 else levers[:, 0] * force[:, 1] - levers[:, 1] * force[:, 0]
    k = q.size // frame.size
    sums = [jnp.zeros((k + 1, *x.shape[1:])).at[bodies].add(x)[:k] for x in (force, torque + moment)]
    return jnp.asarray(frame.wrench(q, *sums))


def _set(constant: Array, laws: tuple[OfTime | None, ...], given: dict[str, Any]) -> Array:
    for i, law in enumerate(laws):
        constant = constant if law is None else constant.at[i].set(law(given))
    return constant


def wound(at: Placed, springs: Springs) -> Array:
    """Angles (j,) [rad] of torsion springs; in space not a number where turns can no longer be counted."""
    found = counted(at, springs.rows, springs.near)
    if at.p is None:
        return found
    return found + jnp.where(abs(found - springs.rows.value) < WINDING, 0.0, jnp.nan)  # added: its derivative stays


def offsets(at: Placed, springs: Springs) -> Array:
    """Offsets (j c,) of bushings in the frames of the first bodies: c = 6 in space, translations and rotation vectors
    [m, rad]; 3 in the plane.
    """
    rows = springs.rows
    first, second = rows.points(at)
    one, other = np.array(rows.first), np.array(rows.second)
    A = at.R[one] @ springs.axes[:, 0]
    apart = jnp.einsum("jba,jb->ja", A, second - first)
    if at.angle is not None:
        return jnp.concatenate([apart, angles(at, rows)[:, None]], axis=1).ravel()
    B = at.R[other] @ springs.axes[:, 1]
    return jnp.concatenate([apart, rotation_vector(jnp.einsum("jba,jbc->jac", A, B))], axis=1).ravel()


MEASURES: dict[str, Callable[[Placed, Any], Array]] = {
    "spring": lambda at, springs: lengths(at, springs.rows),
    "torsion": wound,
    "bushing": offsets,
    "contact": lambda at, contacts: contacts.touching(at).gap,
    "ball": lambda at, contacts: contacts.touching(at).gap,
    "tyre": lambda at, tyres: tyres.touching(at).gap,
}
