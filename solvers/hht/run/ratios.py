"""Prescribed steps of changing length that amplify what vibrates too fast for them, (H53), and motions that show it."""

from __future__ import annotations

import math

import numpy as np

from hhtbench.arguments import Matrix, Vector
from solvers.hht.equations.coefficients import Coefficients, Method
from solvers.hht.equations.formulas import MUCH_SHORTER

HARMLESS = 1.5  # ratio of neighbouring steps up to which no sequence amplifies anything: that of error control
ALL_DIGITS = 1e16  # times: roundoff has become as large as the motion
FEW = 6  # turns, one after the other with the steps, and new heights in them, that no contact has
JUMPS = 2  # new heights that a blow may have given
GROWN = 10.0  # times beside these: so much more has a vibration that the steps have made grow
SEEN = 1e-6  # of the speeds' range up to there: less is how the motion itself is cut up
VISIBLE = 1e-3  # of that range: what is told of
TOLD = 5  # coordinates at most: each takes a product over the steps
DIGITS = 1e-9  # of speeds, and of places over the time: less is roundoff, or harmless


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

    Each from the row before it; ``h`` is 0 where no step has led to a row.  Mere changes of the step harm no motion that
    has no vibration which they do not resolve, and what they have made grow is there whatever moves beside it.
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
        found = grown_ones(h, q, v, method.coefficients)
    if not found:
        return ""
    times = max(found.values())
    alpha, more = method.coefficients.alpha, "more than " if times >= ALL_DIGITS else ""
    within = f"below {limit(alpha):.3g}, where alternating steps are stable with alpha = {alpha:.3g}"
    return (
        f"growth: steps that change by up to {largest:.3g} times amplify vibrations far faster than they are "
        f"{more}{times:.1g} times, (H53), and the speeds of coordinates {list(found)} "
        f"have grown so; keep the ratios of neighbouring steps {within}, or give rtol instead of steps"
    )


def turns(h: Vector, v: Matrix) -> Matrix:
    """(k, n) By how much v bends at the rows, min(h0, h1) times the change of its slope; nan where it is not known.

    What steps do not resolve bends to and fro with them; a motion that they resolve, seen from anywhere, one way for long.
    """
    bends = np.full(v.shape, np.nan)
    steps = np.where(h == 0.0, np.nan, h)[1:, None]
    slopes = np.diff(v, axis=0) / steps
    bends[2:] = np.minimum(np.abs(steps[1:]), np.abs(steps[:-1])) * np.diff(slopes, axis=0)
    return bends


def grown_ones(h: Vector, q: Matrix, v: Matrix, c: Coefficients) -> dict[int, float]:
    """Coordinates that go to and fro with the steps, ever further, and how many times those steps amplify, (H53).

    The first ``TOLD`` of them.
    """
    bends = turns(h, v)
    ranges = (np.maximum.accumulate(v) - np.minimum.accumulate(v)).max(axis=1)
    digits = DIGITS * float(np.abs(v).max() + np.abs(q).max() / np.abs(h).sum())
    bends[~(np.abs(bends) > SEEN * ranges[:, None])] = np.nan
    seen = np.abs(bends) > np.maximum(VISIBLE * ranges, digits)[:, None]
    found: dict[int, float] = {}
    for i in np.flatnonzero(seen.any(axis=0)).tolist():
        for lag in (1, 2):  # with each step or, far beyond (H54) at a small alpha, with each second one
            first, last = to_and_fro(bends[:, i], seen[:, i], lag)
            grown = growth(np.abs(bends[first:last, i]))
            if grown >= GROWN:
                times = amplification(c, np.abs(h[max(first - 1, 1) : last]))
                if times >= min(grown, ALL_DIGITS):
                    found[i] = max(times, found.get(i, 0.0))
        if len(found) == TOLD:
            break
    return found


def to_and_fro(bends: Vector, seen: Vector, lag: int) -> tuple[int, int]:
    """From where up to its largest one that is seen ``bends`` (k,) turn with each ``lag``-th of them; (0, 0): never so."""
    turned = np.zeros(bends.size, dtype=bool)
    turned[lag:] = bends[lag:] * bends[:-lag] < 0.0
    before = np.where(turned, 0, np.arange(bends.size))
    before = np.maximum.accumulate(before)  # the last row that has not turned
    long = turned & seen & (np.arange(bends.size) - before >= FEW)
    if not long.any():
        return 0, 0
    largest = int(np.where(long, np.abs(bends), 0.0).argmax())
    return int(before[largest]) + 1 - lag, largest + 1


def growth(sizes: Vector) -> float:
    """How many times ``sizes`` (k,) have grown beside what a blow may have given; 1 where they have not again and again."""
    heights = np.unique(np.maximum.accumulate(sizes))
    return float(np.prod(np.sort(heights[1:] / heights[:-1])[:-JUMPS])) if heights.size >= FEW else 1.0
