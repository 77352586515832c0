r"""Geometrically exact beams of two-node elements, in the plane and in space: strains, and lengths for their mass.

Source: J. C. Simo, L. Vu-Quoc, On the dynamics in space of rods undergoing large motions, Computer Methods in Applied
Mechanics and Engineering 66 (1988) 125-161, for the strains; I. Romero, The interpolation of rotations and its application
to finite element models of geometrically exact rods, Computational Mechanics 34 (2004) 121-133, for the quaternions.

An element runs from node a to node b, is ``L`` long without strain, and is integrated at its middle, which is what keeps
thin beams from locking.  With R the rotation of the section there, x' = (x_b - x_a) / L and e_1 the axis at rest:

    Gamma = R^T x' - e_1 (extension, shear),    K: curvature (twist, bending),    strain energy = L / 2 sum C (Gamma, K)^2

In the plane R turns by the mean of both angles and K = (angle_b - angle_a) / L.  In space R belongs to ``p = (p_a + p_b)
/ 2`` and K = 2 G(p) (p_b - p_a) / (L p.p), which has the length 4 tan(phi / 4) / L for a relative rotation by phi; neither
changes when the whole beam moves as a rigid body, nor when p is scaled.  p_a and p_b need the same sign.

The strains are the measure and ``forces.spring_damper(L C, beta L C, 0)`` the law of ``forces.force_of``; beta [s] is the
damping over the stiffness.  All functions take j elements at once.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.space import body_rate, rotation


def strains_in_plane(a: Array, b: Array, length: Any) -> Array:
    """Extension, shear [1] and curvature [1/m], (j, 3), of elements between the nodes ``a`` and ``b`` (j, 3): x, y, angle.

    ``length``: without strain [m], a number or (j, 1).  The angle of a node is that of the unstrained axis there.
    """
    slope, angle = (b - a) / length, (a[:, 2] + b[:, 2]) / 2
    c, s = jnp.cos(angle), jnp.sin(angle)
    extension, shear = c * slope[:, 0] + s * slope[:, 1] - 1, c * slope[:, 1] - s * slope[:, 0]
    return jnp.stack([extension, shear, slope[:, 2]], axis=1)


def strains_in_space(a: Array, b: Array, frames: Any, length: Any) -> Array:
    """Extension, two shears [1], twist and two curvatures [1/m], (j, 6), of elements between ``a`` and ``b`` (j, 7).

    A node is its position and its quaternion.  ``frames`` (j, 3, 3) holds the axes of the unstrained sections as columns, in
    the body frame of the nodes; the first is the axis of the beam.  ``length``: without strain [m], a number or (j, 1).
    """
    slope, p = (b - a) / length, (a[:, 3:] + b[:, 3:]) / 2
    size = jnp.sum(p**2, axis=1, keepdims=True)
    along = jnp.einsum("jba,jb->ja", rotation(p), slope[:, :3]) / size
    parts = jnp.stack([along, body_rate(p, slope[:, 3:]) / size], axis=1)
    unstrained = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return jnp.einsum("jab,jka->jkb", jnp.asarray(frames), parts).reshape(-1, 6) - unstrained


def strain_energy(strains: Array, stiffness: Any, length: Any) -> Array:
    """Energy [J] of elements with ``strains`` (j, s) and the ``stiffness`` (s,) or (j, s) of their sections [N, N m^2]."""
    return jnp.sum(length * stiffness * strains**2) / 2


def lumped_lengths(n: int, length: Any) -> Array:
    """Lengths (n + 1,) [m] that the nodes of a chain of ``n`` elements carry: half of each element beside them."""
    return jnp.asarray(length) * np.r_[0.5, np.ones(n - 1), 0.5]


def consistent_lengths(n: int, length: Any) -> Array:
    """Matrix (n + 1, n + 1) [m] of the integrals of the linear shapes times each other over a chain of ``n`` elements.

    ``jnp.kron`` with the diagonal matrix of the masses and moments of inertia per length is the consistent mass matrix.
    """
    ends = np.r_[1.0, 2.0 * np.ones(n - 1), 1.0]
    return jnp.asarray(length) * (2 * np.diag(ends) + np.eye(n + 1, k=1) + np.eye(n + 1, k=-1)) / 6
