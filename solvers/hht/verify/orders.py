"""Order two over alpha, b and the choices of the reaction, at constant and at variable steps."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.arguments import Vector
from hhtbench.evidence import Row
from solvers.hht.verify.measure import Case, Progress, errors, integrate, order_row, slope

ALPHAS = (0.0, -0.05, -0.15, -0.3, -1.0 / 3.0)
NAMES = {0.0: "0", -0.05: "-0.05", -0.15: "-0.15", -0.3: "-0.3", -1.0 / 3.0: "-1/3"}
MARGIN = 0.05
LOST = (0.7, 1.3)  # orders within it are order one: the second is lost
SEED = 20070101  # of the random step pattern; any other gives second order too
PATTERN = 8  # steps in one period of the random pattern


@dataclass(frozen=True)
class Levels:
    """Refinements of one case: the number of constant steps, and of periods of a step pattern."""

    constant: tuple[int, ...]
    periods: tuple[int, ...]
    b: float  #: of the methods on variable steps
    lost: tuple[int, ...]  #: finer periods: the first-order part grows out of the second-order one only there


def methods() -> Iterator[dict[str, Any]]:
    """Every member of the family that must be of order two."""
    for alpha in ALPHAS:
        for reaction, b in itertools.product(("implicit", "predictor"), (0.0, 0.3, 1.0)):
            yield {"alpha": alpha, "b": b, "reaction": reaction}
        for reaction in ("midpoint", "midpoint_predictor"):
            yield {"alpha": alpha, "b": 0.0, "reaction": reaction}


def constant_steps(case: Case, levels: Levels, progress: Progress) -> list[Row]:
    """RMS orders of q, v, a for every method."""
    rows = []
    for method in methods():
        progress(f"order: {case.name} {method}")
        rms, end = measured_orders(case, list(levels.constant), method)
        name = f"{method['reaction']}, b = {method['b']:g}, alpha = {NAMES[method['alpha']]}"
        rows.append(order_row(f"order/{case.name}", f"{name}: order of q, v, a (RMS)", rms, 2.0, MARGIN))
        if method["reaction"] == "implicit":
            text = ", ".join(f"{key} {value:.3f}" for key, value in end.items())
            claim = f"{name}: slopes at the end point"
            rows.append(Row(id=f"order/{case.name}", claim=claim, measured=text, bound="not judged", passed=None))
    return rows


def measured_orders(
    case: Case, refinements: list[int] | list[Vector], method: dict[str, Any], keys: tuple[str, ...] = ("q", "v", "a")
) -> tuple[dict[str, float], dict[str, float]]:
    """Slopes against the mean step over the refinements: of the RMS errors, and of the end-point errors."""
    span = case.t_end - case.problem.t_span[0]
    steps = [span / (n if isinstance(n, int) else n.size) for n in refinements]
    found = [errors(case, integrate(case, n, **method), method["alpha"]) for n in refinements]
    rms = {key: slope(steps, [x.rms[key] for x in found]) for key in keys}
    return rms, {key: slope(steps, [x.end[key] for x in found]) for key in keys}


def alternating(case: Case, periods: int) -> Vector:
    """Steps h/3, 2h/3, h/3, ... with ``periods`` pairs."""
    h = (case.t_end - case.problem.t_span[0]) / periods
    return np.tile([h / 3, 2 * h / 3], periods)


def random_pattern(case: Case, periods: int) -> Vector:
    """A fixed random pattern with ratios of neighbours in [1/2, 2], its period closed, repeated ``periods`` times."""
    generator = np.random.default_rng(SEED)
    while True:
        logs = np.concatenate([[0.0], np.cumsum(generator.uniform(-1.0, 1.0, PATTERN - 1))])
        if abs(logs[0] - logs[-1]) <= 1.0:  # the step from one period to the next keeps the ratio too
            break
    pattern = 2.0**logs
    h = (case.t_end - case.problem.t_span[0]) / periods
    return np.tile(pattern / pattern.sum() * h, periods)


def variable_steps(case: Case, levels: Levels, progress: Progress) -> list[Row]:
    """Order with and without (H11) on alternating steps, with it on the random pattern."""
    rows = []
    for alpha in ALPHAS:
        progress(f"variable steps: {case.name} alpha = {NAMES[alpha]}")
        method = {"alpha": alpha, "b": levels.b, "reaction": "implicit"}
        pairs = [alternating(case, 4 * n) for n in levels.periods]
        random = [random_pattern(case, n) for n in levels.periods]
        name = f"b = {levels.b:g}, alpha = {NAMES[alpha]}"
        kept, _ = measured_orders(case, pairs, method)
        rows.append(order_row(f"steps/{case.name}", f"{name}: alternating h/3, 2h/3 with (2.3)", kept, 2.0, MARGIN))
        fitted, _ = measured_orders(case, random, method)
        rows.append(order_row(f"steps/{case.name}", f"{name}: random ratios in [1/2, 2] with (2.3)", fitted, 2.0, MARGIN))
        fine = [alternating(case, n) for n in levels.lost]
        lost, _ = measured_orders(case, fine, {**method, "rescale_a": False})
        rows.append(_lost_row(case, name, alpha, lost))
    return rows


def _lost_row(case: Case, name: str, alpha: float, orders: dict[str, float]) -> Row:
    """Without (H11) the order is lost unless alpha = 0, where a0 is not used off its time."""
    claim = f"{name}: alternating h/3, 2h/3 without (2.3)"
    if alpha == 0.0:
        return order_row(f"steps/{case.name}", claim, orders, 2.0, MARGIN)
    text = ", ".join(f"{key} {value:.3f}" for key, value in orders.items())
    passed = all(LOST[0] < order < LOST[1] for order in orders.values())
    return Row(id=f"steps/{case.name}", claim=claim, measured=text, bound=f"{LOST[0]} .. {LOST[1]}", passed=passed)
