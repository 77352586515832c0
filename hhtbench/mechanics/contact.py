r"""Contact by penalty forces and regularised friction: points, circles, spheres with planes, circles, spheres, cylinders.

A point is a circle or sphere of radius 0; a negative second radius is a hollow one (drum), touched from inside.  All
functions take positions (j, d), d = 2 or 3, of the centres, as ``points_on`` returns them, and serve j contacts at once.

Normal force: ``forces.force_of(gaps, hunt_crossley(...), q, v)`` with the gaps ``on_plane(...).gap`` and so on.
With the smooth depth ``s = (sqrt(gap^2 + e^2) - gap) / 2``, which is ``-gap`` deep inside and ``e^2 / (4 gap)`` far apart:

    push N = k s^n max(0, 1 + 1.5 c s'),  s' = -gap',     energy  k (s^(n + 1) / (n + 1) + e^2 s^(n - 1) / (4 (n - 1)))

the energy because ``-d gap = (1 + e^2 / (4 s^2)) d s``; at n = 1 its last term is ``k e^2 / 4 log(s / e)``.  It never pulls.
A body that arrives slowly with speed u leaves with ``u (1 - c u)``.  Friction of a sliding velocity w:
``-mu N w / sqrt(|w|^2 + w0^2)``, smooth at rest, where it creeps.

Source: K. H. Hunt and F. R. E. Crossley, Coefficient of restitution interpreted as damping in vibroimpact, Journal of
Applied Mechanics 42 (1975) 440-445, for e = 0 and without a bound at 0.  The square roots round off ``max`` and Coulomb's
sign.
"""

from __future__ import annotations

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import Array

from hhtbench.mechanics.forces import distances, force_at
from hhtbench.mechanics.shapes import expect_pairs


class Contact(NamedTuple):
    """Nearest points of j pairs: ``gap`` (j,) [m], below 0 inside; unit ``normal`` (j, d) towards the first body;
    ``point`` (j, d) [m] on the surface of the second.
    """

    gap: Array
    normal: Array
    point: Array


def on_plane(centre: Array, radius: Any, origin: Any, normal: Any) -> Contact:
    """Contacts of circles or spheres ``radius`` [m] at ``centre`` (j, d) with half-spaces below ``origin`` (j, d) or (d,)
    and their unit ``normal``.
    """
    normal = jnp.broadcast_to(normal, centre.shape)
    height = jnp.sum((centre - jnp.asarray(origin)) * normal, axis=-1)
    return Contact(height - jnp.asarray(radius), normal, centre - height[:, None] * normal)


def on_sphere(centre: Array, radius: Any, other: Any, other_radius: Any) -> Contact:
    """Contacts of circles or spheres ``radius`` [m] at ``centre`` (j, d) with others ``other_radius`` at ``other``; a
    negative ``other_radius`` is hollow and holds the first inside.  The centres must be apart.
    """
    other, side = jnp.broadcast_to(other, centre.shape), jnp.where(jnp.asarray(other_radius) < 0.0, -1.0, 1.0)
    apart = distances(centre, other)
    outward = (centre - other) / apart[:, None]
    surface = other + jnp.abs(jnp.asarray(other_radius))[..., None] * outward
    return Contact(side * apart - jnp.asarray(other_radius) - jnp.asarray(radius), (side * outward.T).T, surface)


def on_cylinder(centre: Array, radius: Any, other: Any, axis: Any, other_radius: Any) -> Contact:
    """Contacts of points or spheres with long cylinders (wheels, drums) through ``other`` (j, 3) along the unit ``axis``
    (j, 3) or (3,), as :func:`on_sphere`.
    """
    along = jnp.sum((centre - jnp.asarray(other)) * jnp.asarray(axis), axis=-1, keepdims=True)
    return on_sphere(centre, radius, jnp.asarray(other) + along * jnp.asarray(axis), other_radius)


def depth(gap: Array, onset: Any) -> Array:
    """Smooth depth (j,) [m], above 0, of ``gap`` (j,): ``onset`` [m], above 0, is the gap over which contact sets in."""
    root = jnp.sqrt(gap**2 + jnp.asarray(onset) ** 2)
    apart = gap > 0  # without cancellation on either side
    return jnp.where(apart, jnp.asarray(onset) ** 2 / (2 * jnp.where(apart, root + gap, 1.0)), (root - gap) / 2)


def hunt_crossley(stiffness: Any, loss: Any, onset: Any, power: Any = 1.5) -> Callable[[Array, Array], Array]:
    """Return the law of contact for ``forces.force_of``: the tension (j,) [N], below 0, of gaps and their rates.

    ``stiffness`` [N/m^power], ``loss`` c [s/m] (a slow impact at u keeps ``1 - c u`` of its speed), ``onset`` of
    :func:`depth` [m]; ``power``, at least 1, is 1.5 for Hertz's contact.
    """
    bound = jnp.asarray(1.5 * jnp.asarray(loss))
    return lambda gap, rate: -jnp.asarray(stiffness) * depth(gap, onset) ** power * jnp.maximum(1 - bound * rate, 0.0)


def contact_energy(gap: Array, stiffness: Any, onset: Any, power: Any = 1.5) -> Array:
    """Energy [J] of all contacts with gaps ``gap`` (j,): that of :func:`hunt_crossley` without loss, up to a constant."""
    s = depth(gap, onset)
    linear = jnp.asarray(power) == 1.0
    more = jnp.where(linear, 1.0, power - 1.0)
    tail = jnp.where(linear, jnp.log(s / jnp.asarray(onset)), s**more / more)
    return jnp.sum(jnp.asarray(stiffness) * (s ** (power + 1) / (power + 1) + jnp.asarray(onset) ** 2 / 4 * tail))


def friction(push: Array, sliding: Array, coefficient: Any, creep: Any) -> Array:
    """Friction (j, d) [N] against the velocities ``sliding`` (j, d) [m/s] under the forces ``push`` (j,) [N]; ``creep``
    [m/s] is the speed at which 0.71 of it acts.
    """
    speed = jnp.sqrt(jnp.sum(sliding**2, axis=-1) + jnp.asarray(creep) ** 2)
    return -(jnp.asarray(coefficient) * push / speed)[:, None] * sliding


def friction_force(
    frame: ModuleType, first: Any, second: Any, contact: Contact, push: Array, law: tuple[Any, Any], q: Array, v: Array
) -> Array:
    """Generalised force (n,) of friction between bodies ``first`` (j,) and ``second`` at their contacts.

    ``frame`` is the module ``plane`` or ``space`` that ``q`` is laid out by.  One body serves all contacts.  ``push`` (j,)
    [N] is the normal force, ``law`` the coefficient and the creep of :func:`friction`, at ``contact.point`` on both.
    """
    return sliding_force(frame, first, second, contact, lambda sliding: friction(push, sliding, *law), q, v)


def sliding_force(
    frame: ModuleType, first: Any, second: Any, contact: Contact, law: Callable[[Array], Array], q: Array, v: Array
) -> Array:
    """Generalised force (n,) of the forces ``law(sliding)`` (j, d) [N] on ``first`` at ``contact.point``.

    ``sliding`` (j, d) [m/s] is the velocity of ``first`` against ``second`` there, along the surface; otherwise as
    :func:`friction_force`.
    """
    apart = distances_of_material(frame, first, second, contact.point, q)
    return force_at(apart, law(along_surface(apart, contact, q, v)), q)


def along_surface(apart: Callable[[Array], Array], contact: Contact, q: Array, v: Array) -> Array:
    """Rates (j, d) of the vectors ``apart(q)`` (j, d) less their parts along the normals."""
    _, rate = jax.jvp(apart, (q,), (v,))
    return along(rate, contact.normal)


def along(velocity: Array, normal: Array) -> Array:
    """Velocities (j, d) less their parts along the unit normals (j, d)."""
    return velocity - jnp.sum(velocity * normal, axis=-1, keepdims=True) * normal


def distances_of_material(frame: ModuleType, first: Any, second: Any, point: Array, q: Array) -> Callable[[Array], Array]:
    """Function of q: vectors (j, d) [m] from material points of ``second`` to those of ``first``.

    The material points are at ``point`` (j, d) at the given ``q``, where the vectors are zero; their rate is the velocity of
    one body against the other there.
    """
    at = frame.placed_with_ground(q)
    first, second = (jnp.broadcast_to(body, point.shape[:1]) for body in expect_pairs(first, second, len(at.x)))
    local = [frame.in_frame(at, body, point - at.x[body]) for body in (first, second)]

    def apart(q: Array) -> Array:
        at = frame.placed_with_ground(q)
        return frame.points_on(at, first, local[0]) - frame.points_on(at, second, local[1])

    return apart
