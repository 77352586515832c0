"""Regret of a choice: its cost divided by the best in hindsight, on held-out problems."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hhtbench.advice.criteria import Criteria
from hhtbench.advice.database import ACCURACIES, Database, Scene
from hhtbench.advice.nearest import Space, expected, key_of
from hhtbench.protocol.arguments import Matrix, Vector

TWICE = 2.0
SAMPLES = 1000  # samples of the bootstrap over families
LEVEL = (2.5, 97.5)  # percentiles of an interval that holds 95 %
STIFF = 100.0  # stiffness above which the rule of thumb takes an implicit method
ADVICE, FREE, BEST_FIXED, THUMB = "advice", "advice, features free", "best fixed of the others", "rule of thumb"


@dataclass(frozen=True, kw_only=True)
class Line:
    """Statistics of the regret of one policy over all scenes; each scene counts once, with its mean log regret over the
    errors.
    """

    policy: str
    median: float  #: regret, 1 is the best in hindsight
    high: float  #: 95th percentile of the regret
    mean: float  #: geometric
    twice: float  #: share of the scenes within twice the best
    closed: float  #: share of the gap between the best fixed choice and the best per scene that is closed
    interval: tuple[float, float]  #: confidence interval of ``closed``
    gain: tuple[float, float]  #: interval of the median of the logarithm of the regret over the best fixed choice's
    spoken: float = 1.0  #: share of the questions that were answered; the others take the best fixed choice
    right: float = float("nan")  #: share of the answers within twice the best
    silent: float = float("nan")  #: share within twice the best of the fixed choices taken without an answer
    right_high: float = float("nan")  #: 95th percentile of the regret of the answers, one vote a scene and error
    silent_high: float = float("nan")  #: 95th percentile of the regret of the fixed choices taken without an answer


def thumb(scene: Scene) -> str:
    """Return the textbook's choice: BDF with constraints, Radau for stiff problems, Dormand-Prince for the others."""
    if scene.features.position or scene.features.velocity:
        return "ida(form=ggl)"
    return "scipy(method=Radau)" if scene.features.stiffness > STIFF else "scipy(method=DOP853)"


def judge(database: Database, asked: Callable[[float], Criteria], same: Callable[[Scene, Scene], bool]) -> tuple[Line, ...]:
    """Measure the regret of all policies on every scene, with the scenes that are ``same`` as it held out; advice comes
    first.
    """
    ratios = np.array([_ratios(scene, asked(ACCURACIES[0]), database.budget) for scene in database.scenes])
    answered = [_asked(database, index, asked, same, ratios) for index in range(len(database.scenes))]
    advice, free, fixed, answers = (np.array(parts) for parts in zip(*answered, strict=True))
    samples = _resampled([scene.family for scene in database.scenes])
    rule = [_index(database, thumb(scene)) for scene in database.scenes]
    base = _votes(fixed)
    lines = [
        _line(ADVICE, advice, base, samples, answers),
        _line(FREE, free, base, samples, answers),
        _line(BEST_FIXED, fixed, base, samples),
        _line(THUMB, ratios[np.arange(len(rule)), rule], base, samples),
    ]
    each = [_line(entry, ratios[:, j], base, samples) for j, entry in enumerate(database.entries)]
    return (*lines, *sorted(each, key=lambda line: line.mean))


def _ratios(scene: Scene, criteria: Criteria, budget: float) -> Matrix:
    """Logarithm of the cost over the best cost, (entries, accuracies).

    Where an entry does not reach the accuracy it is that of the budget over the shortest time, at least 0; NaN where no
    entry does.
    """
    costs, times = scene.costs[key_of(criteria)], scene.costs["time", key_of(criteria)[1]]
    best, fastest = costs.min(axis=0), times.min(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        lost = np.maximum(budget / fastest, 1.0)
        found = np.log(np.where(np.isfinite(costs), costs / best, lost))
    return np.where(np.isfinite(best), found, np.nan)


def _asked(
    database: Database,
    index: int,
    asked: Callable[[float], Criteria],
    same: Callable[[Scene, Scene], bool],
    ratios: Matrix,
) -> tuple[Vector, Vector, Vector, Vector]:
    """Return, for one scene and each error: log regret of the advice, the same without the cost of the features, log
    regret of the
    best fixed choice on the other scenes, and whether the advice gave an answer.
    """
    scene = database.scenes[index]
    kept = [i for i, other in enumerate(database.scenes) if not same(scene, other)]
    train = database.without(lambda other: not same(scene, other))
    space = Space.of(train)
    fixed = int(np.argmin(np.nanmean(np.nanmean(ratios[kept], axis=2), axis=0)))
    advice, free, spoke = [], [], []
    for column, accuracy in enumerate(ACCURACIES):
        criteria = asked(accuracy)
        found = expected(train, space, scene.features, criteria)
        chosen = fixed if found.doubt else _index(database, found.order[0][0])
        spent = scene.probe_seconds if criteria.on == "time" else scene.probe_evaluations
        best = scene.costs[key_of(criteria)][:, column].min()
        free.append(ratios[index, chosen, column])
        advice.append(np.log(np.exp(ratios[index, chosen, column]) + spent / best))
        spoke.append(not found.doubt)
    return np.array(advice), np.array(free), ratios[index, fixed], np.array(spoke)


def _index(database: Database, entry: str) -> int:
    return database.entries.index(entry)


def _votes(logs: Matrix) -> Vector:
    """Mean over the errors that some solver reaches, (scenes,)."""
    return np.nanmean(logs, axis=1)


def _line(policy: str, logs: Matrix, base: Vector, samples: Sequence[Vector], answers: Matrix | None = None) -> Line:
    votes = _votes(logs)
    closed = [1.0 - votes[some].mean() / base[some].mean() for some in samples if base[some].mean() > 0]
    gain = [np.median(votes[some] - base[some]) for some in samples]
    more = {}
    if answers is not None:
        known = np.isfinite(logs)
        spoken, silent = logs[answers & known], logs[np.logical_not(answers) & known]
        more = {
            "spoken": float(answers.mean()),
            "right": _share(spoken <= np.log(TWICE)),
            "silent": _share(silent <= np.log(TWICE)),
            "right_high": _high(spoken),
            "silent_high": _high(silent),
        }
    return Line(
        policy=policy,
        median=float(np.exp(np.median(votes))),
        high=_high(votes),
        mean=float(np.exp(votes.mean())),
        twice=float(np.mean(votes <= np.log(TWICE))),
        closed=float(1.0 - votes.mean() / base.mean()) if base.mean() > 0 else 0.0,
        interval=_interval(closed),
        gain=_interval(gain),
        **more,
    )


def _high(logs: Vector) -> float:
    """Return the 95th percentile of the regret from its logarithms."""
    return float(np.exp(np.percentile(logs, 95))) if logs.size else float("nan")


def _share(hits: Vector) -> float:
    return float(hits.mean()) if hits.size else float("nan")


def _interval(values: Sequence[float]) -> tuple[float, float]:
    low, high = np.percentile(values, LEVEL) if len(values) else (np.nan, np.nan)
    return float(low), float(high)


def _resampled(families: Sequence[str]) -> list[Vector]:
    """Return bootstrap samples: indices of the scenes of families drawn with replacement; the same for every policy."""
    names = sorted(set(families))
    members = {name: np.flatnonzero(np.array(families) == name) for name in names}
    random = np.random.default_rng(0)
    return [np.concatenate([members[name] for name in random.choice(names, len(names))]) for _ in range(SAMPLES)]
