"""Rank that velocity constraints lose by v, (H52): looked for in the steps of a run, since Newton may pass it by luck."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import linalg
from scipy.optimize import minimize_scalar

from hhtbench.arguments import Matrix
from hhtbench.counting import uncounted
from hhtbench.errors import BudgetSpent, NonFiniteValue
from solvers._start import Failure, finite_levels, of_dynamics
from solvers.hht.loops import memory as mem
from solvers.hht.run import singular
from solvers.hht.run.engine import Engine
from solvers.hht.run.history import History
from solvers.hht.run.singular import (
    LONGEST,
    MAY_BE_SINGULAR,
    Place,
    SingularPosition,
    UnitRows,
    dense,
    dependent_at,
    places_of,
    seconds_of_look,
    told,
)

BESIDE = 3  # steps from a pole of mu, on one side at least: above what it is there it stands out
SHARP = 1.5  # times that, at least
AHEAD = 2.0  # steps within which rank is lost
FURTHER = 4.0  # than the last look beyond a run that has failed: its steps may be far shorter than what is left of it
FALLS = 0.95  # of a singular value, at most, after a tenth of them, if it is on its way to zero
GONE = 1e-3  # of it, at most, where it is zero
LEFT = 0.5  # of it, at most, where t and q alone lose rank
MET = 1e-2  # of the change of v, at most, that v there may be off the constraints
WITHIN: Any = {"bounds": (0.0, 1.0), "method": "bounded", "options": {"xatol": 1e-5}}  # from none to all of AHEAD
MOST, SAME = 30, 1e-4  # changes by Newton's iteration, which halve v where it vanishes, and the one that ends it, of v
ASKED = 0.1  # of what they give v here: so much do rows ask for, at least, along what is lost, where v grows with 1/sigma
UNBOUNDED = "the constraints ask for a velocity that they leave no direction for, and v grows beyond all bounds there"
ENDS = "No motion goes on beyond; end before it"
OPEN = "k_v loses rank with v, and v' may take another direction there"


def lost_by_velocity(engine: Engine, history: History, made: int) -> Failure | None:
    """That rank was lost in the last ``made`` steps or just before, which ``history`` then ends before; else None."""
    if not (engine.structure.p and _may_be_lost(engine)):
        return None
    t, q, v, mu = history.last(made + 2 * BESIDE, (0, 2, 3, 7))
    for i in poles(mu).tolist():
        for j in range(max(i - 2, 1), min(i + 1, len(t) - 1)):
            if float(t[j, 0]) in history.looked:  # with these very steps
                continue
            history.looked.add(float(t[j, 0]))
            place = places_of(t[j - 1 : j + 1], q[j - 1 : j + 1], v[j - 1 : j + 1])[0]
            failure = _lost(engine, place, AHEAD * float(t[j + 1, 0] - t[j, 0]))
            if failure is not None:
                beyond = len(t) - 1 - j
                history.cut(beyond)
                engine.work.add("steps_accepted", -beyond)
                return failure
    return None


def cause_of(engine: Engine, failure: Failure, places: list[Place]) -> SingularPosition | Failure:
    """The singular position that has caused the ``failure`` of a run through ``places``; else that, with a cause by v."""
    found = singular.cause_of(engine, failure, places)
    if found is not failure or failure.status not in MAY_BE_SINGULAR or not (places and _may_be_lost(engine)):
        return found
    last, ahead = places[-1], 2 * AHEAD * float(engine.loops.section(mem.ATTEMPT)[mem.H_TRIED])
    while True:
        lost = _lost(engine, last, ahead)
        if lost or not abs(ahead) < singular.BESIDE * last.scale < np.inf:
            return lost or failure
        ahead *= FURTHER


def _may_be_lost(engine: Engine) -> bool:
    """Whether constraints may lose rank with v, or ask for a velocity: told once, at the start, at two times."""
    s = engine.structure
    if seconds_of_look(engine.dynamics) > LONGEST or not s.constrained:
        return False
    if s.rheonomic or not s.p or s.velocity_jacobian_uses_v:
        return s.rheonomic or s.p > 0
    if engine.asks is None:
        levels, at = of_dynamics(engine.dynamics).levels, engine.place
        with uncounted():
            found = [levels.at(t, at.q, np.zeros_like(at.v)).velocity_drift for t in (at.t, at.t + 1.0)]
        engine.asks = bool(np.any(found))
    return engine.asks


def poles(mu: Matrix) -> Any:
    """Steps at which a column of ``mu`` (k, p) is larger than about them."""
    size = np.pad(np.abs(mu), ((BESIDE, BESIDE), (0, 0)), mode="edge")

    def moved(steps: int) -> Matrix:
        return size[BESIDE + steps : len(size) - BESIDE + steps]

    beside = np.maximum(np.maximum(moved(-1), moved(1)), SHARP * np.minimum(moved(-BESIDE), moved(BESIDE)))
    return np.flatnonzero(((moved(0) > 0.0) & (moved(0) >= beside)).any(axis=1))


def _lost(engine: Engine, place: Place, s: float) -> Failure | None:
    """That rank is lost by v within ``s`` [s] after ``place``, on the constraints, or v itself; else None."""
    try:
        return _lost_within(UnitRows(engine.dynamics, engine.place), place, s)
    except (BudgetSpent, NonFiniteValue, linalg.LinAlgError):
        return None


def _lost_within(rows: UnitRows, place: Place, s: float) -> Failure | None:
    here = rows.least(place)
    if rows.least(_there(rows, place, s / 10)[0]) > FALLS * here:
        return None
    found, lacks = _there(rows, place, s * minimize_scalar(lambda x: rows.least(_there(rows, place, x * s)[0]), **WITHIN).x)
    if rows.least(found) > GONE * here or lacks > MET * float(np.linalg.norm(found.v - place.v)):
        return None
    left = linalg.svd(rows.at(found))[0][:, -1:]
    if rows.least(replace(found, v=place.v)) > LEFT * here:
        return told(dependent_at(rows, found, left), OPEN)
    speed = float(np.linalg.norm(rows.root(place).T @ place.v))
    if np.abs(rows.asked(found) @ left).max() > ASKED * here * speed:
        return told(dependent_at(rows, found, left), UNBOUNDED, ENDS)
    return None


def _there(rows: UnitRows, place: Place, s: float) -> tuple[Place, float]:
    """``s`` [s] after ``place``, with v on the constraints by Newton's iteration from its own, and the last change.

    Each change is the least in the metric of the mass: along the reactions.  Not the nearest v, to which no iteration
    leads where constraints bend within the way.
    """
    there, changed = replace(place.moved(s), v=place.v), np.inf
    root = rows.root(there)
    for _ in range(MOST):
        at = finite_levels(rows.projection.levels, there.t, there.q, there.v)
        across = linalg.solve_triangular(root, dense(at.rows).T, lower=True).T
        change = linalg.solve_triangular(root, linalg.lstsq(across, -at.velocity_drift)[0], trans=1, lower=True)
        there, changed = replace(there, v=there.v + change), float(np.linalg.norm(change))
        if changed <= SAME * np.linalg.norm(there.v):
            break
    return there, changed
