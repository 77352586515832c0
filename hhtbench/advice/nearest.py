"""Expect the cheapest solver on a problem from measurements on the most similar known problems."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hhtbench.advice.criteria import Criteria
from hhtbench.advice.database import ACCURACIES, HELD, Database
from hhtbench.advice.features import NAMES, Features
from hhtbench.protocol.arguments import Matrix, Vector

NEIGHBOURS = 5  # more would reach from few flexible scenes into the soft ones, where others win
PRIOR = 1.0  # weight of the mean over all scenes, in neighbours: it breaks ties
REACH = 1.0  # quantile of distances between a scene and the nearest of another family: no advice beyond it
WEIGHTS = {  # of a feature's standard deviation: what is stiff decides, what the equations look like hardly
    "size": 0.5,
    "position": 0.25,
    "velocity": 0.25,
    "redundant": 0.25,
    "variable_mass": 0.25,
    "vibration": 2.0,
    "decay": 1.0,
    "pace": 0.5,
    "share": 1.0,
}
STIFFEST = (
    4.0  # log of a rate over the motion's from which all are alike: explicit steps are out, implicit ones do not see it
)
LOST = 30.0  # cost ratio counted for a neighbour on which a solver does not reach the error
TWICE = 2.0  # a neighbour supports a solver up to this ratio to the cheapest
AGREED = 0.4  # share of the neighbours that must support the choice


@dataclass(frozen=True, kw_only=True)
class Expectation:
    """Solvers in the order of their expected cost."""

    order: tuple[tuple[str, float], ...]  #: entry and mean cost over the cheapest, best first
    neighbours: tuple[str, ...]  #: specs, the nearest first
    distance: float  #: distance of the nearest known problem, in standard deviations of the features
    reach: float  #: distance up to which the database speaks; infinite where all scenes are of one family
    agreed: float  #: share of the neighbours on which the first is within twice the cheapest

    @property
    def unknown(self) -> str:
        """Why the database has too few known problems for any statement, or ""."""
        count = len(self.neighbours)
        if count < NEIGHBOURS:
            return f"too few known problems: on {count} somebody reaches this error, {NEIGHBOURS} are needed"
        one_family = "the known problems are of one family, two are needed to say how far they speak"
        return one_family if np.isinf(self.reach) else ""

    @property
    def doubt(self) -> str:
        """Why no solver can be recommended, or ""."""
        if self.unknown:
            return self.unknown
        if self.distance > self.reach:
            return f"the nearest known problem is {self.distance:.2g} away, the database speaks up to {self.reach:.2g}"
        few = f"of {len(self.neighbours)} neighbours only {self.agreed:.0%} have {self.order[0][0]} within twice the best"
        return few if self.agreed < AGREED else ""


@dataclass(frozen=True)
class Space:
    """Features of a database's scenes by :func:`compared`, each divided by its standard deviation and weighted."""

    points: Matrix  #: (scenes, features)
    centre: Vector
    spread: Vector
    reach: float

    @classmethod
    def of(cls, database: Database) -> Space:
        """Standardise the features of ``database``; the reach is a quantile of distances between families."""
        points = compared(database.points)
        centre, spread = points.mean(axis=0), points.std(axis=0)
        spread = np.where(spread > 0, spread, 1.0) / np.array([WEIGHTS[name] for name in NAMES])
        points = (points - centre) / spread
        families = np.array([scene.family for scene in database.scenes])
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        apart[families[:, None] == families] = np.inf
        nearest = apart.min(axis=1)
        reach = float(np.quantile(nearest[np.isfinite(nearest)], REACH)) if np.any(np.isfinite(nearest)) else np.inf
        return cls(points, centre, spread, reach)

    def distances(self, features: Features) -> Vector:
        """Return the distances from ``features`` to every scene, (scenes,)."""
        return np.linalg.norm(self.points - (compared(features.vector) - self.centre) / self.spread, axis=1)


def compared(points: Matrix) -> Matrix:
    """Return features (..., features) with the rates of vibration and decay over the motion's, at most ``STIFFEST``.

    The share of the fastest vibrations counts the less the less fast they are.
    """
    found, pace = np.array(points), points[..., NAMES.index("pace")]
    for name in ("vibration", "decay"):
        found[..., NAMES.index(name)] = np.minimum(found[..., NAMES.index(name)] - pace, STIFFEST)
    found[..., NAMES.index("share")] *= np.clip(found[..., NAMES.index("vibration")] / STIFFEST, 0.0, 1.0)
    return found


def expected(database: Database, space: Space, features: Features, criteria: Criteria) -> Expectation:
    """Order solvers by mean log cost on the ``NEIGHBOURS`` nearest scenes where an error was reached, with all scenes as
    prior.

    ``space`` is that of ``database``.
    """
    columns = [_column(accuracy) for accuracy in criteria.accuracies]
    distances = space.distances(features)
    costly = database.ratios[key_of(criteria)][:, :, columns]
    reached = np.isfinite(costly.min(axis=1)).all(axis=1)  # infinite over infinite is NaN, and so is its minimum
    known = [int(i) for i in np.argsort(distances, kind="stable") if reached[i]]
    if not known:
        return Expectation(order=(), neighbours=(), distance=np.inf, reach=space.reach, agreed=0.0)
    every = np.log(np.minimum(costly[known], LOST)).mean(axis=2)
    near, ratios = known[:NEIGHBOURS], every[:NEIGHBOURS]
    means = (ratios.sum(axis=0) + PRIOR * every.mean(axis=0)) / (len(near) + PRIOR)
    order = [int(j) for j in np.argsort(means, kind="stable")]
    return Expectation(
        order=tuple((database.entries[j], float(np.exp(means[j]))) for j in order),
        neighbours=tuple(database.scenes[i].spec for i in near),
        distance=float(distances[near[0]]),
        reach=space.reach,
        agreed=float(np.mean(ratios[:, order[0]] <= np.log(TWICE) + 1e-12)),
    )


def key_of(criteria: Criteria) -> tuple[str, float | None]:
    """Return the key (measure, drift bound) of the database's table for ``criteria``; a looser bound uses the table
    without.

    To first order a scaled drift is at most the weighted mean of the scaled errors in its row: a bound that is no
    tighter than the error asked for is met by every run that reaches the error.
    """
    free = criteria.drift is None or criteria.drift >= criteria.accuracies[0]
    return criteria.on, None if free else HELD[1]


def error_of(accuracy: float) -> float:
    """Return the error of the database that is nearest to ``accuracy`` by its logarithm."""
    return ACCURACIES[_column(accuracy)]


def _column(accuracy: float) -> int:
    return int(np.argmin(np.abs(np.log10(np.array(ACCURACIES)) - np.log10(accuracy))))
