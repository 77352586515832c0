"""Prescribed steps of changing length that amplify what vibrates too fast for them, (H53), and motions that show it."""

from __future__ import annotations

import math

import numpy as np

from hhtbench.arguments import Matrix, Vector
from solvers.hht.equations.coefficients import Coefficients, Method
from solvers.hht.equations.formulas import MUCH_SHORTER

HARMLESS = 1.5  # ratio of neighbouring steps up to which no sequence amplifies anything: that of error control
AMPLIFIED = 1e3  # times: what steps do to speeds at least before a motion is blamed on them
ALL_DIGITS = 1e16  # times: roundoff has become as large as the motion
GROWN = 10.0  # times a speed at the start: so much more has a vibration that the steps have made grow
FEW = 10  # states at the start
OFF = 0.5  # of the way at the largest speed: where steps resolve a motion it is far nearer that way
VISIBLE = 1e-6  # of the largest speed


def stiff_step(c: Coefficients, ratio: float) -> Matrix:
    """(3, 3) map of (h f, v, h a) by a step and the change to one ``ratio`` times as long, h omega -> infinity, (H53)."""
    alpha, beta, gamma = c.alpha, c.beta, c.gamma
    a = np.array([0.0, -1.0 / beta, -(0.5 - beta) / beta])
    v = np.array([0.0, 1.0, 1.0 - gamma]) + gamma * a
    f = (a + np.array([alpha, 0.0, 0.0])) / (1.0 + alpha)
    a = f if ratio < MUCH_SHORTER else f + ratio * (a - f)
    return np.array([ratio * f, v, ratio * a])


def amplification(c: Coefficients, lengths: Vector) -> float:
    """By how much steps of ``lengths`` (k,) amplify the speed of an infinitely fast vibration somewhere on their way, (H53).

    From there on where nothing is left of what was before; ``ALL_DIGITS`` stands for all that is more.
    """
    product, most = np.eye(3), 1.0
    for ratio in (lengths[1:] / lengths[:-1]).tolist():
        product = stiff_step(c, ratio) @ product
        most = max(most, float(np.abs(product[1]).max()))
        if most >= ALL_DIGITS:
            break
        if np.abs(product).max() < 1.0:
            product = np.eye(3)
    return min(most, ALL_DIGITS)


def limit(alpha: float) -> float:
    """The ratio r of steps 1 : r : 1 : r ... beyond which they amplify infinitely fast vibrations, (H54); infinite: none."""
    if alpha == 0.0:
        return math.inf
    return (1.0 + math.sqrt(1.0 - 4.0 * alpha * alpha)) / (-2.0 * alpha)


def amplified(method: Method, h: Vector, q: Matrix, v: Matrix) -> str:
    """What steps of ``h`` (k,) to ``q`` and ``v`` (k, n) have made grow, in words with a remedy; or none.

    Each from the row before it; ``h`` is 0 where no step has led to a row.  A component that steps do not resolve is seen
    where it is fastest: its way is not that of its speed; mere changes of the step harm no motion that has none.
    """
    lengths = np.abs(h[h != 0.0])
    plain = method.equations == "hht" and method.coefficients.alpha_m == 0.0 and method.rescale_a
    if not plain or lengths.size < 2:
        return ""
    ratios = lengths[1:] / lengths[:-1]
    largest = float(max(ratios.max(), 1.0 / ratios.min()))
    if not largest > HARMLESS:
        return ""
    with np.errstate(all="ignore"):
        grown = grown_ones(h, q, v)
    times = amplification(method.coefficients, lengths) if grown else 1.0
    if times < AMPLIFIED:
        return ""
    alpha, more = method.coefficients.alpha, "more than " if times >= ALL_DIGITS else ""
    within = f"below {limit(alpha):.3g}, where alternating steps are stable with alpha = {alpha:.3g}"
    return (
        f"growth: steps that change by up to {largest:.3g} times amplify vibrations far faster than they are "
        f"{more}{times:.1g} times, (H53), and the speeds of coordinates {grown} "
        f"have grown so; keep the ratios of neighbouring steps {within}, or give rtol instead of steps"
    )


def grown_ones(h: Vector, q: Matrix, v: Matrix) -> list[int]:
    """The coordinates that steps do not resolve and that have become faster than at the start."""
    way, speed = np.abs(np.diff(q, axis=0)), np.maximum(np.abs(v[1:]), np.abs(v[:-1]))
    full, fastest = np.abs(h[1:, None]) * speed, speed.max(axis=0)
    unresolved = (speed > fastest / 2.0) & (np.abs(way - full) > OFF * full)
    least = np.maximum(GROWN * np.abs(v[:FEW]).max(axis=0), VISIBLE * float(fastest.max()))
    return [int(i) for i in np.flatnonzero(unresolved.any(axis=0) & (fastest > least))]
