"""A second opinion of a hostile run's motion, wherever it says success.

Steps that resolve what is fastest, clear of lost rank, are integrated anew by the fuzzing's own equations.  Under error
control, where that cannot be done with every step that is chosen, the whole motion is integrated anew, so that nothing of
it is extreme: in units in which its size, its masses and what is fastest are about one, from t0 = 0, with rows of scale one.
How much the two may differ follows from what the run may err by and from the conditioning: how far the end moves where
every number is a little off, as a third motion shows.
"""

from __future__ import annotations

from contextlib import suppress

import numpy as np

from hhtbench import Solution
from hhtbench.conformance.subject import expect
from tests.fuzz.judge import Judge
from tests.fuzz.mechanism import Mechanism
from tests.fuzz.oracles import EPS, ROUNDED, TOLERANCES, number, own_equations, rounding, sizes
from tests.fuzz.runs import Setting
from tests.fuzz.twins import apart, end

EVERY = 10  # steps of a run that are integrated anew
FINEST = 1e-12  # tolerance that is believed
SHAKEN = 1e-6, 1e-2  # relative changes of every number: the tolerance, but no less and no more than these
KEPT = ("places", "anchor", "length")  # numbers that have to agree with one another
PLAIN = {"scale": 1.0, "blade_scale": 1.0, "t0": 0.0}  # numbers that do not change the motion
UNRESOLVED = r"forces change v\[\d+\] by (\S+),"  # in messages: by how much


def second_opinion(setting: Setting, s: Solution) -> None:
    """What is wrong with the motion is an AssertionError."""
    way, judge = setting.case.way, setting.judge
    if s.t.size < 2 or s.t[-1] == s.t[0] or not has_its_own_motion(setting):
        return
    with np.errstate(all="ignore"):
        if own_equations(setting, s, EVERY) or way.steps or way.watch == "change":
            return
        length, mass, time = 1.0 / judge.sizes[0], float(np.exp(-np.mean(np.log(judge.p.mass)))), setting.rate
        made, interval = setting.made.in_units(length, mass, time), float(s.t[-1] - s.t[0]) * time
        exact = integrated(shaken(made, 0.0), interval, (s.q[0] * length, s.v[0] * (length / time)))
        if exact is None:
            return
        shake = float(np.clip(way.rtol, *SHAKEN))
        third = integrated(shaken(made, shake), interval)
        size_q, size_v = sizes(setting, s)
        scales = size_q * length, size_v * (length / time)
        moved = np.inf if third is None else apart(scales, exact, third) / shake
        q, v = end(s)
        off, bound = apart(scales, exact, (q * length, v * (length / time))), errors(setting, s) * (1.0 + moved)
    expect(off <= bound, f"the end, row {s.t.size - 1}, is {off:.1e} of the sizes beside the exact one, over {bound:.1e}")


def has_its_own_motion(setting: Setting) -> bool:
    """Whether motion and multipliers are those of the mechanism, whatever is wrong with the case."""
    spoil = setting.case.spoil
    if spoil is None or spoil.kind in ("nan", "raise", "units"):
        return True
    return spoil.kind == "wrong" and spoil.where == "force_jacobians"


def shaken(made: Mechanism, shake: float) -> Mechanism:
    """In plain numbers, off by up to ``shake``."""
    random = np.random.default_rng(0)

    def number(name: str, x: np.ndarray, _) -> np.ndarray:
        if name in PLAIN:
            return np.full_like(x, PLAIN[name])
        return x if name in KEPT else x * (1.0 + shake * random.uniform(-1.0, 1.0, x.shape))

    return made.but(number)


def integrated(made: Mechanism, interval: float, began=None):
    """End of a motion by the fuzzing's own equations, from its start or where it ``began``."""
    judge = Judge(made)
    with suppress(np.linalg.LinAlgError):
        motion = judge.carried(0.0, *(began or judge.start[:2]), [interval])
        if motion is not None and np.isfinite(motion).all():
            return np.split(motion[0], 2)
    return None


def errors(setting: Setting, s: Solution) -> float:
    """What a run may err by over the sizes, of a motion that is well conditioned."""
    way, judge = setting.case.way, setting.judge
    found = TOLERANCES * max(way.rtol, FINEST) * max(1.0, way.turns)
    crossed = float(np.abs(s.v).max()) / judge.sizes[0]  # it may have become fast
    found += EPS * float(np.abs(s.t).max()) * max(setting.rate, crossed)  # of times
    sigma = judge.sigma(float(s.t[0]), s.q[0]) or 1.0  # 0: no such number, and no allowance by it
    found += ROUNDED * EPS / sigma**2  # of rows nearly alike
    found += max(x / size for x, size in zip(rounding(setting, s), sizes(setting, s), strict=True))
    return found + number(UNRESOLVED, s) / judge.sizes[1]  # in a step that does not see it
