r"""Flexible cables: elements with position and slope at their nodes, in the plane and in space; cords that only pull.

Sources: J. Gerstmayr, A. A. Shabana, Analysis of thin beams and cables using the absolute nodal co-ordinate formulation,
Nonlinear Dynamics 45 (2006) 109-130 (the cable element); J. Gerstmayr, H. Irschik, On the correct representation of bending
and axial deformation in the absolute nodal coordinate formulation with an elastic line approach, Journal of Sound and
Vibration 318 (2008) 461-487 (its strains).

A cable of j elements has the coordinates ``nodes`` (j + 1, 2, d): position r and slope r' = dr/dx of each node, x the length
along the unstretched cable, d = 2 or 3.  Between nodes ``length`` [m] apart r(x) is cubic.  Energy of an element:

    1/2 int EA eps^2 + EI |k|^2 dx,   eps = |r'| - 1,   k = dt/dx = (r'' - t (t . r'')) / |r'|,   t = r' / |r'|

k is the change of the unit tangent; ``|k| = |r' x r''| / |r'|^2`` is the curvature, without the kink of a norm at a straight
cable.  eps is taken at the 3 points of Lobatto and k at the 2 points of Gauss: with more, bent elements lock, as r' cannot
have the length 1 all along them.  There is no stiffness against twist.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.contact import depth

#: points in [0, 1] and weights: Lobatto's for the axial strain, Gauss's for the curvature
AXIAL = np.array([0.0, 0.5, 1.0]), np.array([1.0, 4.0, 1.0]) / 6
BENDING = 0.5 + np.array([-0.5, 0.5]) / np.sqrt(3.0), np.array([0.5, 0.5])
HERMITE = np.array([[1.0, 0.0, -3.0, 2.0], [0.0, 1.0, -2.0, 1.0], [0.0, 0.0, 3.0, -2.0], [0.0, 0.0, -1.0, 1.0]])


def shapes(at: Any, order: int = 0) -> Any:
    """Cubic Hermite polynomials (p, 4), or their derivatives of an ``order``, at the points ``at`` (p,) in [0, 1].

    They multiply the position and ``length`` times the slope of the first node, then of the second.
    """
    return np.stack([np.polynomial.Polynomial(row).deriv(order)(np.asarray(at)) for row in HERMITE], axis=-1)


def derivative_at(nodes: Any, length: Any, at: Any, order: int = 0) -> Array:
    """Derivatives (j, p, d) of the position by x, ``order`` times, at the points ``at`` (p,) in [0, 1] of each element."""
    ends = jnp.stack([nodes[:, 0], length * nodes[:, 1]], axis=1)
    elements = jnp.concatenate([ends[:-1], ends[1:]], axis=1)
    return jnp.einsum("ps,jsd->jpd", shapes(at, order), elements) / length**order


def strains(nodes: Array, length: Any) -> Array:
    """Strains (j, 3 + 2 d) of each element: 3 axial strains [1], then 2 changes of the tangent, d components each [1/m].

    They are the measure of ``forces.force_of``; all are zero, and stay so in any rotation, where a cable is straight and
    unstretched.
    """
    stretch = jnp.linalg.norm(derivative_at(nodes, length, AXIAL[0], 1), axis=-1) - 1.0
    slope, bend = (derivative_at(nodes, length, BENDING[0], order) for order in (1, 2))
    size = jnp.linalg.norm(slope, axis=-1, keepdims=True)
    tangent = slope / size
    change = (bend - tangent * jnp.sum(tangent * bend, axis=-1, keepdims=True)) / size
    return jnp.concatenate([stretch, change.reshape(len(change), -1)], axis=1)


def section(axial: Any, bending: Any, length: Any, dimension: int) -> Array:
    """Factors (3 + 2 d,) of :func:`strains` in a linear law: ``axial`` and ``bending`` times the weights of the points.

    ``section(EA, EI, length, d)`` are stiffnesses from EA [N] and EI [N m^2], ``section(c, 0, length, d)`` dampers with the
    axial force c eps' from c [N s].  Dampers against k' would not be independent of the frame.
    """
    weights = (AXIAL[1], np.repeat(BENDING[1], dimension))
    return length * jnp.concatenate([part * weight for part, weight in zip((axial, bending), weights, strict=True)])


def mass_matrix(elements: int, dimension: int, mass: Any, length: Any) -> Array:
    """Consistent mass matrix (n, n), n = 2 d (j + 1), of j elements with ``mass`` per length [kg/m]; it is constant."""
    points, weights = np.polynomial.legendre.leggauss(4)  # exact for the products of cubics
    values = shapes((points + 1) / 2)
    one, whole = values.T @ (weights[:, None] / 2 * values), np.zeros((2 * elements + 2, 2 * elements + 2))
    rows = 2 * np.arange(elements)[:, None] + np.arange(4)
    np.add.at(whole, (rows[:, :, None], rows[:, None, :]), one)
    size = jnp.tile(jnp.stack([jnp.ones_like(length), length]), elements + 1)
    return jnp.kron(mass * length * size[:, None] * whole * size, np.eye(dimension))


def uniform(elements: int, vector: Any) -> Array:
    """Velocities or accelerations (n,) of a cable all of whose points have the same ``vector`` (d,).

    With the mass matrix M and gravity, ``M @ uniform(j, gravity)`` is the weight and ``-q @`` it its potential energy;
    ``uniform(j, e) @ M @ v`` is the momentum along e.
    """
    vector = jnp.asarray(vector)
    return jnp.tile(jnp.stack([vector, jnp.zeros_like(vector)]), (elements + 1, 1)).ravel()


def cord(stiffness: Any, damping: Any, free: Any, width: Any) -> Callable[[Array, Array], Array]:
    """Return the force law ``k p(l - l0) + c p'(l - l0) l'`` [N] of cords that only pull, for ``forces.force_of``.

    ``p(s) = (s + sqrt(s^2 + width^2)) / 2`` is the smooth depth of contacts, of the gap -s.  Neither the spring k [N/m] nor
    the damper c [N s/m] acts on a slack cord, shorter than l0 by many ``width`` [m].
    """

    def law(length: Array, rate: Array) -> Array:
        stretch = length - free
        share = (1 + stretch / jnp.hypot(stretch, width)) / 2
        return stiffness * depth(-stretch, width) + damping * share * rate

    return law


def cord_energy(length: Array, stiffness: Any, free: Any, width: Any) -> Array:
    """Energies (j,) [J] of cords of the law :func:`cord` at lengths (j,) [m]: ``k`` times the integral of p."""
    stretch = length - free
    size = jnp.hypot(stretch, width)
    return stiffness / 4 * (stretch**2 + stretch * size + width**2 * jnp.arcsinh(stretch / width))
