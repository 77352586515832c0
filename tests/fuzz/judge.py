"""What holds of a mechanism's motion, by equations that no solver sees: start, levels, rank, accelerations, a tight step."""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from tests.fuzz import formulas
from tests.fuzz.formulas import Numbers
from tests.fuzz.mechanism import Mechanism

SWEEPS = 15  # of friction by the tensions of before: with more of it the root is not plain
CLEAR = 0.03  # least singular value of the unit rows, over the root of the mass, of a mechanism far from lost rank
NEAR = 0.1  # of the size of a mechanism: no rod and no spring is shorter


class Rows(NamedTuple):
    """Of the constraints over the root of the mass, each of length one."""

    unit: np.ndarray  #: (m + p, n)
    length: np.ndarray  #: (m + p,)
    root: np.ndarray  #: (n,) of the mass


class Judge:
    """The equations of one mechanism."""

    def __init__(self, made: Mechanism) -> None:
        self.made, self.shape, self.p = made, made.shape, Numbers(made)
        pairs = [frozenset(pair) for pair in made.shape.rods]
        self.distinct = [i for i, pair in enumerate(pairs) if pair not in pairs[:i]]
        if made.shape.blade:
            self.distinct.append(len(pairs))

    def rows(self, t, q):
        """(m + p, n)."""
        of_rods = formulas.jacobian(np, self.shape, self.p, t, q)
        return np.concatenate([of_rods, formulas.blade_row(np, self.shape, self.p, q)]) if self.shape.blade else of_rods

    def drift(self, t, q, v):
        """(m + p,) of the velocity level."""
        of_rods = (
            formulas.time_derivative(np, self.shape, self.p, t, q) + formulas.jacobian(np, self.shape, self.p, t, q) @ v
        )
        return np.concatenate([of_rods, formulas.blade(np, self.shape, self.p, q, v)]) if self.shape.blade else of_rods

    def unit(self, t, q) -> Rows:
        """Unit rows; a row of zeros stays."""
        root = np.sqrt(formulas.masses(np, self.shape, self.p, q))
        rows = self.rows(t, q) / root
        length = np.linalg.norm(rows, axis=1)
        return Rows(rows / np.where(length > 0, length, 1.0)[:, None], length, root)

    def sigma(self, t, q) -> float:
        """Least singular value of the distinct unit rows; 1 without any, 0 for more than coordinates or a mass of zero."""
        unit = self.unit(t, q).unit[self.distinct]
        if len(unit) > self.shape.n or not np.isfinite(unit).all():
            return 0.0
        return float(np.linalg.svd(unit, compute_uv=False)[-1]) if len(unit) else 1.0

    @cached_property
    def start(self):
        """q0 and v0 (n,), and whether they meet the velocity level."""
        q, v, t = np.array(self.made.places).ravel(), np.array(self.made.velocities).ravel(), self.made.t0
        rows = self.rows(t, q)
        length = np.linalg.norm(rows, axis=1, keepdims=True)
        length = np.where(length > 0.0, length, 1.0)
        rows, off = rows / length, self.drift(t, q, v) / length[:, 0]
        v, given = v - np.linalg.pinv(rows) @ off, np.abs(v).max()
        v = np.where(np.abs(v) > 1e-13 * given, v, 0.0)  # at rest: a start is measured by its own velocities
        left = self.drift(t, q, v) / length[:, 0]
        return q, v, bool(np.abs(left).max(initial=0.0) <= 1e-12 * (np.abs(v).max() + np.abs(off).max(initial=0.0)))

    @cached_property
    def sound(self) -> bool:
        """Whether the start is far from everything that ends a run."""
        with np.errstate(all="ignore"):
            q, v, consistent = self.start
            apart = [formulas.separations(np, self.shape, self.p, kind, self.made.t0, q) for kind in (0, 1)]
            shortest = min((float(np.linalg.norm(x, axis=1).min(initial=np.inf)) for x in apart), default=np.inf)
            finite = np.isfinite(q).all() and np.isfinite(v).all() and min(self.made.masses) > 0.0
            near = shortest < NEAR * np.abs(q).max()
        return bool(finite and consistent and not near and self.sigma(self.made.t0, q) > CLEAR)

    def acceleration(self, t, q, v):
        """vdot (n,), the multipliers (m + p,) of least norm in unit rows, and whether friction has settled."""
        unit, length, root = self.unit(t, q)
        applied = formulas.force(np, self.shape, self.p, t, q, v) / root
        bend = formulas.curvature(np, self.shape, self.p, t, q, v)
        if self.shape.blade:
            bend = np.concatenate([bend, formulas.blade_curvature(np, self.shape, self.p, q, v)])
        inverse, bend, m = np.linalg.pinv(unit), bend / length, len(self.shape.rods)
        brakes, lam, rough = np.zeros_like(root), np.zeros(len(unit)), self.shape.reaction == "friction"
        for _ in range(SWEEPS if rough else 1):
            before, pulled = lam, applied + brakes
            across = inverse @ (unit @ pulled + bend)
            lam = (inverse.T @ across) / length
            if rough:
                brakes = formulas.brakes(np, self.shape, self.p, t, q, v, lam[:m]) / root
        settled = not rough or bool(np.abs(lam - before).max(initial=0.0) <= 1e-12 * np.abs(lam).max(initial=1e-300))
        return (pulled - across) / root, lam, settled

    def rate(self, t, q, v) -> float:
        """[1/s] of what is fastest at a state: springs, dampers, turns, falls, tensions, the drive."""
        shape, p = self.shape, self.p
        by_q, by_v = formulas.force_jacobians(shape, p, t, q, v)
        root = np.sqrt(formulas.masses(np, shape, p, q))
        vdot, lam, _ = self.acceleration(t, q, v)
        found = [np.linalg.norm(by_v / root / root[:, None], 2), p.frequency * shape.driven]
        found += [np.sqrt(np.linalg.norm(by_q / root / root[:, None], 2)), np.sqrt(np.abs(vdot).max() / np.abs(q).max())]
        found.append(np.abs(v).max() / np.abs(q).max())
        for kind in (0, 1):
            d, u = (formulas.separations(np, shape, p, kind, t, x, order) for order, x in enumerate((q, v)))
            length, points = np.linalg.norm(d, axis=1), shape.maps[kind][0]
            if length.size:
                fall = np.linalg.norm((points @ vdot).reshape(d.shape), axis=1)
                found += [(np.linalg.norm(u, axis=1) / length).max(), np.sqrt((fall / length).max())]
                if kind == 0:
                    light = ((points.reshape(*d.shape, -1)[:, 0] / root[:, None].T) ** 2).sum(axis=1)
                    found.append(np.sqrt(np.abs(p.scale * lam[: length.size] * light).max()))
        if shape.blade:
            found.append(np.linalg.norm(p.turn) * np.abs(v).max() / np.linalg.norm(self.rows(t, q)[-1] / p.blade_scale))
        return float(np.linalg.norm(found))

    @cached_property
    def sizes(self) -> tuple[float, float]:
        """Typical ones of q and of v, the second as large as falling over the first makes it."""
        q, v, _ = self.start
        size, fall = float(np.abs(q).max()), 0.0
        with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):  # without a mass there is no such number
            fall = float(np.sqrt(np.abs(self.acceleration(self.made.t0, q, v)[0]).max() * size))
        return size, max(float(np.abs(v).max()), fall if np.isfinite(fall) else 0.0) or 1.0

    def off(self, t, q, v, size_v: float) -> tuple[float, float]:
        """Both levels, the largest of each over the size of its row."""
        g, rows, drift = formulas.constraint(np, self.shape, self.p, t, q), self.rows(t, q), self.drift(t, q, v)
        size = np.abs(rows).sum(axis=1)
        position = np.abs(g) / (size[: g.size] * max(np.abs(q).max(), self.sizes[0]))
        velocity = np.abs(drift) / (size * max(size_v, self.sizes[1]))
        return float(position.max(initial=0.0)), float(velocity.max(initial=0.0))

    def carried(self, t, q, v, t1):
        """q and v (2n,) at ``t1`` of the motion through (t, q, v), to ten digits; None where friction does not settle."""
        n, settled = q.size, True

        def rate(s, y):
            nonlocal settled
            vdot, _, well = self.acceleration(s, y[:n], y[n:])
            settled = settled and well
            return np.concatenate([y[n:], vdot])

        atol = 1e-13 * np.repeat(self.sizes, n)
        found = solve_ivp(rate, (t, t1), np.concatenate([q, v]), "DOP853", rtol=1e-11, atol=atol)
        return found.y[:, -1] if found.success and settled else None

    def energy(self, t, q, v) -> float:
        """[J]."""
        return float(formulas.energy(self.shape, self.p, t, q, v))

    @property
    def conserves(self) -> bool:
        """Whether nothing feeds or takes energy."""
        made, shape = self.made, self.shape
        fed = shape.driven or (shape.blade and made.speed) or made.drag or any(c for *_, c in made.springs)
        return not fed and shape.reaction != "friction"
