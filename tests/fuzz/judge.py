"""What holds of a mechanism's motion, by equations that no solver sees: start, levels, rank, accelerations, a tight step."""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from tests.fuzz import formulas
from tests.fuzz.mechanism import Mechanism

SWEEPS = 15  # of friction by the tensions of before: with more of it the root is not plain
CLEAR = 0.03  # least singular value of the unit rows, over the root of the mass, of a mechanism far from lost rank
MOST = 20_000  # evaluations of a motion: two seconds
NEAR = 0.1  # of the size of a mechanism: no rod and no spring is shorter


class Spent(Exception):
    """What a motion may take is used up, or it is none."""


class Accelerations(NamedTuple):
    """What the acceleration level asks for."""

    vdot: np.ndarray  #: (n,)
    of_force: np.ndarray  #: (n,) of it, without the reactions
    lam: np.ndarray  #: (m + p,) multipliers of least norm in unit rows
    settled: bool  #: friction has one plain root


def lengths(rows):
    """Of each row, 1 of one that is zero."""
    length = np.linalg.norm(rows, axis=1)
    return np.where(length > 0.0, length, 1.0)


class Judge:
    """The equations of one mechanism."""

    def __init__(self, made: Mechanism) -> None:
        self.made, self.shape, self.p = made, made.shape, made.p
        self.t0 = float(self.p.t0)
        pairs = [frozenset(pair) for pair in made.shape.rods]
        self.distinct = [i for i, pair in enumerate(pairs) if pair not in pairs[:i]]
        if made.shape.blade:
            self.distinct.append(len(pairs))

    def _levels(self, of_rods, of_blade):
        """Of the rods, and of the blade if there is one."""
        return np.concatenate([of_rods, of_blade()]) if self.shape.blade else of_rods

    def rows(self, t, q):
        """(m + p, n)."""
        of_rods = formulas.jacobian(np, self.shape, self.p, t, q)
        return self._levels(of_rods, lambda: formulas.blade_row(np, self.shape, self.p, q))

    def drift(self, t, q, v):
        """(m + p,) of the velocity level."""
        f = formulas
        of_rods = f.time_derivative(np, self.shape, self.p, t, q) + f.jacobian(np, self.shape, self.p, t, q) @ v
        return self._levels(of_rods, lambda: f.blade(np, self.shape, self.p, q, v))

    def unit(self, t, q):
        """(m + p, n) rows over the root of the mass, of length one or zero; their lengths; that root (n,)."""
        root = np.sqrt(formulas.masses(np, self.shape, self.p, q))
        rows = self.rows(t, q) / root
        length = lengths(rows)
        return rows / length[:, None], length, root

    def sigma(self, t, q) -> float:
        """Least singular value of the distinct unit rows; 1 without any, 0 for more than coordinates or a mass of zero."""
        unit = self.unit(t, q)[0][self.distinct]
        if len(unit) > self.shape.n or not np.isfinite(unit).all():
            return 0.0
        return float(np.linalg.svd(unit, compute_uv=False)[-1]) if len(unit) else 1.0

    @cached_property
    def start(self):
        """q0 and v0 (n,), and whether they meet the velocity level."""
        q, v, t = self.p.places.ravel(), self.p.velocities.ravel(), self.t0
        rows = self.rows(t, q)
        length = lengths(rows)
        off, given = self.drift(t, q, v) / length, np.abs(v).max()
        v = v - np.linalg.pinv(rows / length[:, None]) @ off
        v = np.where(np.abs(v) > 1e-13 * given, v, 0.0)  # at rest: a start is measured by its own velocities
        left = np.abs(self.drift(t, q, v) / length).max(initial=0.0)
        return q, v, bool(left <= 1e-12 * (np.abs(v).max() + np.abs(off).max(initial=0.0)))

    @cached_property
    def sound(self) -> bool:
        """Whether the start is far from everything that ends a run."""
        with np.errstate(all="ignore"):
            q, v, consistent = self.start
            near = self.shortest(self.t0, q) < NEAR * np.abs(q).max()
            finite = np.isfinite(q).all() and np.isfinite(v).all() and self.p.mass.min() > 0.0
        return bool(finite and consistent and not near and self.sigma(self.t0, q) > CLEAR)

    def shortest(self, t, q) -> float:
        """Length of rods and springs."""
        apart = [formulas.separations(np, self.shape, self.p, kind, t, q) for kind in (0, 1)]
        return min(float(np.linalg.norm(x, axis=1).min(initial=np.inf)) for x in apart)

    def acceleration(self, t, q, v) -> Accelerations:
        """At a state."""
        unit, length, root = self.unit(t, q)
        applied = formulas.force(np, self.shape, self.p, t, q, v) / root
        bend = formulas.curvature(np, self.shape, self.p, t, q, v)
        bend = self._levels(bend, lambda: formulas.blade_curvature(np, self.shape, self.p, q, v)) / length
        inverse, m = np.linalg.pinv(unit), len(self.shape.rods)
        brakes, lam, rough = np.zeros_like(root), np.zeros(len(unit)), self.shape.reaction == "friction"
        for _ in range(SWEEPS if rough else 1):
            before, pulled = lam, applied + brakes
            across = inverse @ (unit @ pulled + bend)
            lam = (inverse.T @ across) / length
            if rough:
                brakes = formulas.brakes(np, self.shape, self.p, t, q, v, lam[:m]) / root
        moved = [(np.abs(lam[x] - before[x]), np.abs(lam[x])) for x in (slice(m), slice(m, None))]  # in units of their own
        settled = not rough or all(change.max(initial=0.0) <= 1e-12 * size.max(initial=1e-300) for change, size in moved)
        return Accelerations((pulled - across) / root, applied / root, lam, settled)

    def rate(self, t, q, v) -> float:
        """[1/s] of what is fastest at a state: springs, dampers, turns, falls, tensions, the drive."""
        shape, p, f = self.shape, self.p, formulas
        by_q, by_v = f.force_jacobians(shape, p, t, q, v)
        root, shortest = np.sqrt(f.masses(np, shape, p, q)), min(self.shortest(t, q), np.abs(q).max())
        vdot, _, lam, _ = self.acceleration(t, q, v)
        found = [np.linalg.norm(by_v / root / root[:, None], 2), p.frequency, np.abs(v).max() / shortest]
        found += [np.sqrt(np.linalg.norm(by_q / root / root[:, None], 2)), np.sqrt(np.abs(vdot).max() / shortest)]
        if shape.rods:
            light = ((shape.maps[0][0][:: shape.dim] / root) ** 2).sum(axis=1)
            found.append(np.sqrt(np.abs(p.scale * lam[: light.size] * light).max()))
        if shape.blade:
            found.append(abs(p.turn) * np.abs(v).max() / np.linalg.norm(self.rows(t, q)[-1] / p.blade_scale))
        return float(np.linalg.norm(found))

    @cached_property
    def sizes(self) -> tuple[float, float]:
        """Typical ones of q and of v, the second as large as what is applied would make it over the first."""
        q, v, _ = self.start
        size, fall = float(np.abs(q).max()), 0.0
        with suppress(np.linalg.LinAlgError), np.errstate(all="ignore"):  # without a mass there is no such number
            found = self.acceleration(self.t0, q, v)
            fall = float(np.sqrt(max(np.abs(found.of_force).max(), np.abs(found.vdot).max()) * size))
        return size, max(float(np.abs(v).max()), fall if np.isfinite(fall) else 0.0) or 1.0

    def off(self, t, q, v):
        """g (m,) and the velocity level (m + p,), in units of q and of v."""
        size = np.abs(self.rows(t, q)).sum(axis=1)
        g, drift = formulas.constraint(np, self.shape, self.p, t, q), self.drift(t, q, v)
        return np.abs(g) / size[: g.size], np.abs(drift) / size

    def strained(self, t, q, v, lam) -> float:
        """The largest of accelerations by forces and multipliers lam (m + p,), before reactions cancel one another."""
        held = np.abs(formulas.force(np, self.shape, self.p, t, q, v)) + np.abs(self.rows(t, q).T) @ np.abs(lam)
        masses = formulas.masses(np, self.shape, self.p, q)
        return float((held / np.where(masses > 0.0, masses, 1.0)).max())  # what has none moves with rows of size one, (H19)

    def carried(self, t, q, v, times):
        """q and v (2n,) at ``times`` of the motion through (t, q, v), to ten digits; None where friction does not settle.

        And where it takes more than ``MOST`` evaluations.
        """
        n, settled, found, left = q.size, True, [], MOST

        def rate(s, y):
            nonlocal settled, left
            left -= 1
            if left < 0 or not np.isfinite(y).all():  # a first step that is nan would be shortened for ever
                raise Spent
            vdot, _, _, well = self.acceleration(s, y[:n], y[n:])
            settled = settled and well
            return np.concatenate([y[n:], vdot])

        y = np.concatenate([q, v])
        atol = 1e-13 * np.repeat(self.sizes, n)
        with suppress(Spent):
            for end in times:
                run = solve_ivp(rate, (t, end), y, "DOP853", rtol=1e-11, atol=atol)
                settled = settled and run.success
                found.append(run.y[:, -1])
        return np.array(found) if settled and len(found) == len(times) else None
