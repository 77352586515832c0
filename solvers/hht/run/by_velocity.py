"""Rank that velocity constraints lose by v, (H52): looked for in the steps of a run, since Newton may pass it by luck."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import linalg
from scipy.optimize import minimize_scalar

from hhtbench.arguments import Matrix
from hhtbench.errors import BudgetSpent, NonFiniteValue
from solvers._start import Failure
from solvers.hht.run.engine import Engine
from solvers.hht.run.history import History
from solvers.hht.run.singular import (
    LONGEST,
    Place,
    SingularPosition,
    UnitRows,
    dependent_at,
    places_of,
    seconds_of_look,
    told,
)

BESIDE = 3  # steps on either side of a pole of mu, above which it stands out
SHARP = 1.5  # times their size, at least
AHEAD = 2.0  # steps within which rank is lost
LEFT = 0.5  # of a singular value, at most, where it is: v' by a difference leads past its zero
OPEN = "k_v loses rank with v, and v' may take another direction there"


def lost_by_velocity(engine: Engine, history: History, made: int) -> Failure | None:
    """That rank was lost in the last ``made`` steps or just before, which ``history`` then ends before; else None."""
    s = engine.structure
    if not (s.p and s.velocity_jacobian_uses_v) or seconds_of_look(engine.dynamics) > LONGEST:
        return None
    t, q, v, mu = history.last(made + 2 * BESIDE, (0, 2, 3, 7))
    try:
        for i in poles(mu).tolist():
            for j in range(max(i - 2, 1), min(i + 1, len(t) - 1)):
                place = places_of(t[j - 1 : j + 1], q[j - 1 : j + 1], v[j - 1 : j + 1])[0]
                position = _position(UnitRows(engine.dynamics, engine.place), place, AHEAD * float(t[j + 1, 0] - t[j, 0]))
                if position is not None:
                    beyond = len(t) - 1 - j
                    history.cut(beyond)
                    engine.work.add("steps_accepted", -beyond)
                    return told(position, OPEN)
    except (BudgetSpent, NonFiniteValue, linalg.LinAlgError):
        return None
    return None


def poles(mu: Matrix) -> Any:
    """Steps at which a column of ``mu`` (k, p) is larger than about them."""
    size = np.pad(np.abs(mu), ((BESIDE, BESIDE), (0, 0)))

    def moved(steps: int) -> Matrix:
        return size[BESIDE + steps : len(size) - BESIDE + steps]

    beside = np.maximum(np.maximum(moved(-1), moved(1)), SHARP * np.maximum(moved(-BESIDE), moved(BESIDE)))
    return np.flatnonzero(((moved(0) > 0.0) & (moved(0) >= beside)).any(axis=1))


def _position(rows: UnitRows, place: Place, s: float) -> SingularPosition | None:
    """Where v loses rank within ``s`` [s] after ``place``."""
    here, bound = rows.at(place), LEFT * rows.least(place)
    if np.linalg.norm(rows.at(place.moved(s)) - here, 2) < bound:  # as far as rows are straight: it changes by no more
        return None
    found = place.moved(s * minimize_scalar(lambda x: rows.least(place.moved(x * s)), bounds=(0.0, 1.0), method="bounded").x)
    if rows.least(found) > bound or rows.least(replace(found, v=place.v)) <= bound:
        return None
    return dependent_at(rows, found, linalg.svd(rows.at(found))[0][:, len(here) - 1 :])
