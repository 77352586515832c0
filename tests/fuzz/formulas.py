"""The physics of a mechanism by array formulas, for NumPy and ``jax.numpy``.

``xp`` is one of them, ``p`` holds the numbers: a :class:`Numbers` or the System of that shape.
"""

from __future__ import annotations

import numpy as np

from tests.fuzz.mechanism import Mechanism, Shape


class Numbers:
    """The numbers of a mechanism as arrays, by the names of a System's parameters."""

    def __init__(self, made: Mechanism) -> None:
        shape = made.shape
        self.mass, self.anchor, self.gravity = np.array(made.masses), np.array(made.anchor), np.array(made.gravity)
        self.swing = np.array(made.swing or np.zeros(shape.dim))
        self.frequency, self.drag, self.growth = made.frequency, made.drag, made.growth
        self.scale, self.stiffness, self.natural, self.damper = np.array(made.scales), *np.zeros((3, len(shape.springs)))
        q = np.array(made.places).ravel()
        apart = [separations(np, shape, self, kind, made.t0, q) for kind in (0, 1)]
        self.length, distance = (np.linalg.norm(x, axis=1) for x in apart)
        if made.springs:
            self.stiffness, ratio, self.damper = np.array(made.springs).T
            self.natural = ratio * distance
        self.along, self.turn = np.array(made.along or np.zeros(shape.dim)), np.zeros((shape.dim, shape.dim))
        if made.turn:
            self.turn = np.array(made.turn)
        self.speed, self.blade_scale, self.friction, self.creep = made.speed, made.blade_scale, made.friction, made.creep

    def values(self) -> dict:
        """By name."""
        return dict(vars(self))


def anchors(xp, shape: Shape, p, t, order: int):
    """(a, d) places of the anchors, or their velocities or accelerations."""
    if not shape.driven:
        return p.anchor if order == 0 else xp.zeros((shape.anchors, shape.dim))
    w, first = p.frequency, np.eye(shape.anchors)[:, :1]
    motion = (xp.sin(w * t), w * xp.cos(w * t), -w * w * xp.sin(w * t))[order] * first * p.swing
    return p.anchor + motion if order == 0 else motion


def separations(xp, shape: Shape, p, kind: int, t, x, order: int = 0):
    """(r, d) of rods (0) or springs (1) from coordinates; of order 1 from velocities."""
    points, fixed = shape.maps[kind]
    return (points @ x).reshape(-1, shape.dim) - fixed @ anchors(xp, shape, p, t, order)


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
    assert shape.blade is not None
    of, to = shape.blade
    places = np.eye(shape.points)
    row = p.blade_scale * (p.along + p.turn @ (places[to] @ q.reshape(-1, shape.dim)))
    return (places[of][:, None] * row).reshape(1, -1)


def blade(xp, shape: Shape, p, q, v):
    """(1,) k."""
    return blade_row(xp, shape, p, q) @ v - p.blade_scale * p.speed * np.ones(1)


def blade_curvature(xp, shape: Shape, p, q, v):
    """(1,) k_q v."""
    assert shape.blade is not None
    of, to = shape.blade
    u = v.reshape(-1, shape.dim)
    return p.blade_scale * (np.ones((1, 1)) * (u[of] @ (p.turn @ u[to]))).ravel()


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


def energy(shape: Shape, p, t, q, v):
    """Kinetic, of weights and springs."""
    d = np.linalg.norm(separations(np, shape, p, 1, t, q), axis=1)
    height = (p.mass[:, None] * p.gravity).ravel() @ q
    return 0.5 * (masses(np, shape, p, q) * v) @ v - height + 0.5 * p.stiffness @ (d - p.natural) ** 2


def force_jacobians(shape: Shape, p, t, q, v):
    """(n, n) each, by q and by v."""
    n, dim = shape.n, shape.dim
    by_q, by_v = np.zeros((n, n)), -p.drag * np.eye(n)
    d = separations(np, shape, p, 1, t, q)
    for row, (x, k, natural, c) in enumerate(zip(d, p.stiffness, p.natural, p.damper, strict=True)):
        place, r = shape.maps[1][0][row * dim : (row + 1) * dim], np.linalg.norm(x)
        by_q -= place.T @ (k * (1 - natural / r) * np.eye(dim) + k * natural / r**3 * np.outer(x, x)) @ place
        by_v -= c * place.T @ place
    for i in range(shape.points if shape.growing else 0):
        block = slice(i * dim, (i + 1) * dim)
        x, u, grown = q[block], v[block], p.mass[i] * p.growth
        by_q[block, block] += grown * (u @ u * np.eye(dim) - 2 * np.outer(u, u))
        by_v[block, block] += grown * 2 * (np.outer(x, u) - np.outer(u, x) - x @ u * np.eye(dim))
    return by_q, by_v
