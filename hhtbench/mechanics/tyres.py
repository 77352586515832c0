r"""Simple tyres: thin wheels on planes, whose forces along the road follow from slip.

The normal force is that of a contact, ``contact.hunt_crossley``, with the gap at the wheel's lowest point.  Slip is that of
the wheel's material at the road: the rolling radius is the loaded one.  With its velocity w against the road, the speed V
of the centre along the road, normal force N, friction coefficient mu and stiffnesses c_x along and c_y across the rolling
direction, per unit of slip and of N:

    s = (c_x w_x, c_y w_y) / (mu sqrt(V^2 + V0^2)),    F = -mu N s / sqrt(1 + |s|^2)

so small slips give ``-c N w / V`` (c_y N is the cornering stiffness [N/rad]), large ones Coulomb's friction.  V0 keeps the
wheel at rest smooth, where it creeps.  There is no relaxation length, no camber thrust and no aligning moment.

Source: the friction ellipse of combined slips as in H. B. Pacejka, Tire and Vehicle Dynamics, chapter 3, with the root that
``contact.friction`` takes in place of the brush model's cubic.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array

from hhtbench.mechanics.contact import Contact, on_plane


def wheel_on_plane(centre: Array, radius: Any, axis: Any, origin: Any, normal: Any) -> Contact:
    """Contacts of wheels with half-spaces: ``axis`` (j, 3) are unit vectors along their axles, the rest as
    :func:`hhtbench.mechanics.contact.on_plane`.  No wheel may lie flat.
    """
    normal = jnp.broadcast_to(normal, centre.shape)
    up = normal - jnp.sum(normal * axis, axis=-1, keepdims=True) * jnp.asarray(axis)
    up = up / jnp.linalg.norm(up, axis=-1, keepdims=True)
    return on_plane(centre - jnp.asarray(radius)[..., None] * up, 0.0, origin, normal)


def rolling_directions(axis: Any, normal: Array) -> Array:
    """Unit vectors (j, d) along the road in which wheels roll; in the plane, with ``axis`` None, to the right of the
    ``normal`` (j, d).
    """
    if axis is None:
        return jnp.stack([normal[:, 1], -normal[:, 0]], axis=1)
    ahead = jnp.cross(jnp.asarray(axis), normal)
    return ahead / jnp.linalg.norm(ahead, axis=-1, keepdims=True)


def reference_speed(travel: Array, slow: Any) -> Array:
    """Speeds (j,) [m/s] over which slips are taken, of the arguments of :func:`slip_force`."""
    return jnp.sqrt(jnp.sum(travel**2, axis=-1) + jnp.asarray(slow) ** 2)


def slip_force(push: Array, sliding: Array, travel: Array, ahead: Array, grip: Any) -> Array:
    """Forces (j, d) [N] along the road on tyres under the normal forces ``push`` (j,) [N].

    Parameters
    ----------
    sliding, travel
        (j, d) velocities along the road [m/s]: of the wheels where they touch, and of their centres.
    ahead
        (j, d) unit vectors along which they roll.
    grip
        (4,) or (j, 4): coefficient of friction; stiffnesses along and across per unit of slip and of load; the speed
        [m/s], above 0, below which the wheel counts as standing.
    """
    mu, along, across, slow = jnp.moveaxis(jnp.asarray(grip), -1, 0)
    forward = jnp.sum(sliding * ahead, axis=-1)
    aside = sliding - forward[:, None] * ahead
    slip = (along * forward)[:, None] * ahead + jnp.asarray(across)[..., None] * aside
    full = jnp.asarray(mu * reference_speed(travel, slow))
    return -(mu * push / jnp.sqrt(full**2 + jnp.sum(slip**2, axis=-1)))[:, None] * slip
