"""The physics of a mechanism by array formulas, for NumPy and ``jax.numpy``.

``xp`` is one of them, ``p`` holds the parameters: those of a Mechanism, or the System of that shape.
"""

from __future__ import annotations

import numpy as np

from tests.fuzz.mechanism import Shape

SPIN = {d: np.eye(d)[:, [1, 0, 2][:d]] * [[1.0], [-1.0], [0.0]][:d] for d in (2, 3)}  # a quarter turn about the third axis
TINY = 1e-20  # of the size of x: an imaginary step, whose square is no digit


def separations(xp, shape: Shape, p, kind: int, t, x, order: int = 0):
    """(r, d) of rods (0) or springs (1) from coordinates x (n,); of order 1 from velocities, of order 2 accelerations."""
    points, fixed = shape.maps[kind]
    apart = (points @ x).reshape(-1, shape.dim)
    if order == 0:
        apart = apart - fixed @ p.anchor
    if shape.driven:
        w, phase = p.frequency, p.frequency * (t - p.t0)
        motion = (xp.sin(phase), w * xp.cos(phase), -w * w * xp.sin(phase))[order]
        apart = apart - fixed[:, :1] * (motion * p.swing)
    return apart


def back(shape: Shape, kind: int, forces):
    """(n,) what ``forces`` (r, d) along the separations make of the coordinates."""
    return shape.maps[kind][0].T @ forces.ravel()


def masses(xp, shape: Shape, p, q):
    """(n,) on the diagonal."""
    mass = p.mass
    if shape.growing:
        mass = mass * (1.0 + p.growth * (q.reshape(-1, shape.dim) ** 2).sum(axis=1))
    return xp.repeat(mass, shape.dim)


def force(xp, shape: Shape, p, t, q, v):
    """(n,) weights, springs with their dampers, drag, and what growing masses bring along."""
    total = (p.mass[:, None] * p.gravity).ravel() - p.drag * v
    if shape.springs:
        d, u = separations(xp, shape, p, 1, t, q), separations(xp, shape, p, 1, t, v, 1)
        length = xp.sqrt((d * d).sum(axis=1))
        pull = (p.stiffness * (1.0 - p.natural / length))[:, None] * d + p.damper[:, None] * u
        total = total - back(shape, 1, pull)
    if shape.growing:
        x, u = q.reshape(-1, shape.dim), v.reshape(-1, shape.dim)
        along, square = (x * u).sum(axis=1)[:, None], (u * u).sum(axis=1)[:, None]
        total = total + ((p.mass * p.growth)[:, None] * (square * x - 2.0 * along * u)).ravel()
    return total


def constraint(xp, shape: Shape, p, t, q):
    """(m,) of the rods."""
    d = separations(xp, shape, p, 0, t, q)
    return p.scale * ((d * d).sum(axis=1) - p.length**2) / 2.0


def jacobian(xp, shape: Shape, p, t, q):
    """(m, n)."""
    d = p.scale[:, None] * separations(xp, shape, p, 0, t, q)
    return (d[:, :, None] * shape.maps[0][0].reshape(-1, shape.dim, shape.n)).sum(axis=1)


def time_derivative(xp, shape: Shape, p, t, q):
    """(m,) g_t."""
    d = separations(xp, shape, p, 0, t, q)
    return p.scale * (d * separations(xp, shape, p, 0, t, 0.0 * q, 1)).sum(axis=1)


def curvature(xp, shape: Shape, p, t, q, v):
    """(m,) g_tt + 2 g_tq v + g_qq(v, v)."""
    d, u = separations(xp, shape, p, 0, t, q), separations(xp, shape, p, 0, t, v, 1)
    return p.scale * (u * u + d * separations(xp, shape, p, 0, t, 0.0 * q, 2)).sum(axis=1)


def blade_row(xp, shape: Shape, p, q):
    """(1, n) k_v."""
    of, to = shape.blade_maps
    return ((p.blade_scale * (p.along + p.turn * (SPIN[shape.dim] @ (to @ q)))) @ of)[None]


def blade(xp, shape: Shape, p, q, v):
    """(1,) k."""
    return blade_row(xp, shape, p, q) @ v - p.blade_scale * p.speed


def blade_curvature(xp, shape: Shape, p, q, v):
    """(1,) k_q v."""
    of, to = shape.blade_maps
    return (p.blade_scale * p.turn * ((of @ v) @ (SPIN[shape.dim] @ (to @ v))))[None]


def brakes(xp, shape: Shape, p, t, q, v, lam):
    """(n,) friction: every rod slows its ends' motion against one another in proportion to its tension."""
    d, u = separations(xp, shape, p, 0, t, q), separations(xp, shape, p, 0, t, v, 1)
    tension = xp.abs(p.scale * lam) * xp.sqrt((d * d).sum(axis=1))
    slowed = u / xp.sqrt((u * u).sum(axis=1) + p.creep**2)[:, None]
    return -p.friction * back(shape, 0, tension[:, None] * slowed)


def reaction(xp, shape: Shape, p, t, q, v, lam):
    """(n,) declared: of the rods, with friction where the shape has it."""
    own = -(jacobian(xp, shape, p, t, q).T @ lam)
    return own + brakes(xp, shape, p, t, q, v, lam) if shape.reaction == "friction" else own


def force_jacobians(shape: Shape, p, t, q, v):
    """(n, n) each, by q and by v: imaginary parts at imaginary steps, to the last digit."""

    def by(function, x):
        step = TINY * (np.abs(x).max() or 1.0)
        return np.imag([function(x + 1j * step * e) for e in np.eye(shape.n)]).T / step

    return by(lambda x: force(np, shape, p, t, x, v), q), by(lambda x: force(np, shape, p, t, q, x), v)
