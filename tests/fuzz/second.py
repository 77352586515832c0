"""A second opinion of a hostile run's motion, wherever it says success.

Steps that resolve what is fastest, clear of lost rank, are integrated anew by the fuzzing's own equations.  Of a run of
which that cannot be done with every step that is looked at, the whole motion is, put so that nothing of it is extreme: in
units in which its size, its masses and what is fastest are about one, from t0 = 0, with rows of scale one.  Where those
equations do not tell it (prescribed steps err by more than roundoff, a function is wrong, friction has several roots), it
has a second run of the same solver beside it, so put, by full matrices, under error control with a tenth of the tolerance.
How much the two may differ follows from what the first may err by and from the conditioning: how far the end moves where
every number is a little off, as a third one shows.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from hhtbench import Solution
from hhtbench.conformance.subject import expect
from tests.fuzz.mechanism import Unit
from tests.fuzz.oracles import EPS, ROUNDED, TOLERANCES, number, own_equations, rounding, sizes
from tests.fuzz.runs import HOSTILE, Setting
from tests.fuzz.systems import Spoil
from tests.fuzz.twins import CLOSE, apart, end

EVERY = 10  # steps of a run that are integrated anew
FINER, FINEST = 0.1, 1e-12  # tolerance of the second run over the first's; no finer than the second
PATIENT = 10 * HOSTILE  # evaluations of the second run
SHAKEN = 1e-6, 1e-2  # relative changes of every number: the tolerance, but no less and no more than these
KEPT = ("places", "anchor", "length")  # numbers that have to agree with one another
UNRESOLVED = r"forces change v\[\d+\] by (\S+),"  # in messages: by how much
UNTOLD = 1e-5  # a derivative that is wrong by less: differences hardly tell it
UNMET = ("nan", "raise")  # spoils that a run which says success has not met
OF_NUMBERS = ("units", "massless")  # spoils that the mechanism has already


def second_opinion(setting: Setting, s: Solution) -> None:
    """What is wrong with the motion is an AssertionError."""
    if s.t.size < 2 or s.t[-1] == s.t[0]:
        return
    with np.errstate(all="ignore"):
        if is_untouched(setting.case.spoil) and own_equations(setting, s, EVERY):
            return
        length, _, time = units = plain_units(setting)
        plain, shake = plainly(setting, s, units), float(np.clip(setting.case.way.rtol, *SHAKEN))
        began = s.q[0] * length, s.v[0] * (length / time)  # where calc_initcond may have moved it
        second, end_of = (integrated(plain, began) if is_known(setting) else None), integrated
        if second is None and not slips(setting):
            second, end_of = arrived(plain), arrived
        if second is None:
            return
        found = s.q * length, s.v * (length / time)
        sizes = [max(size, float(np.abs(x).max())) for size, x in zip(plain.judge.sizes, found, strict=True)]
        third = end_of(plainly(setting, s, units, shake))
        moved = np.inf if third is None else apart(sizes, second, third) / shake
        bound, off = errors(setting, s) * (1.0 + moved), apart(sizes, second, [x[-1] for x in found])
    told = f"the end, row {s.t.size - 1}, is {off:.1e} of the sizes beside that of the same motion in plain units"
    expect(off <= bound, f"{told}, {end_of.__name__}, over {bound:.1e}")


def is_untouched(spoil: Spoil | None) -> bool:
    """Whether motion and multipliers are those of the mechanism, whatever is wrong with the case."""
    return spoil is None or spoil.kind in (*UNMET, "units") or (spoil.where == "force_jacobians" and spoil.kind != "off")


def slips(setting: Setting) -> bool:
    """Whether prescribed steps may pass over slips that friction lets grow back in time."""
    return setting.case.way.backward and setting.case.way.steps > 0 and setting.made.shape.reaction == "friction"


def is_known(setting: Setting) -> bool:
    """Whether the fuzzing's own equations tell where a run under error control ends."""
    way, spoil = setting.case.way, setting.case.spoil
    another = spoil is not None and (spoil.kind == "massless" or (spoil.kind == "wrong" and spoil.where == "force"))
    return not way.steps and way.watch != "change" and not another


def plain_units(setting: Setting) -> tuple[float, float, float]:
    """How many of the units in which size, masses and rate are one make up a metre, a kilogram, a second."""
    size, masses = setting.judge.sizes[0], setting.judge.p.mass
    heavy = np.exp(np.mean(np.log(masses[masses > 0.0]))) if np.any(masses > 0.0) else 1.0
    return 1.0 / (size or 1.0), 1.0 / float(heavy), setting.rate


def plainly(setting: Setting, s: Solution, units: tuple[float, float, float], shake: float = 0.0) -> Setting:
    """The same motion with nothing extreme; its numbers off by ``shake``."""
    case, way, time, random = setting.case, setting.case.way, units[2], np.random.default_rng(0)

    def number(name: str, x: np.ndarray, _: Unit) -> np.ndarray:
        if name in ("scale", "blade_scale"):
            return np.ones_like(x)
        return 0.0 * x if name == "t0" else x if name in KEPT else x * (1.0 + shake * random.uniform(-1.0, 1.0, x.shape))

    options = {**way.options, "linsolver": "dense"}
    if "min_step" in options:
        options["min_step"] *= time
    ended = way.watch == "terminal" and not way.steps  # the other run goes to where this one has ended
    interval = float(s.t[-1] - s.t[0]) if ended or not way.steps else setting.length
    kept = case.spoil is not None and case.spoil.kind not in (*UNMET, *OF_NUMBERS)
    believed = not (kept and case.spoil.kind == "wrong" and "constraint" in case.spoil.where)  # g_t may be too small to tell
    new = replace(
        case,
        made=setting.made.in_units(*units).but(number),
        way=replace(way, options=options, watch="" if ended else way.watch, declares=way.declares and believed),
        spoil=case.spoil if kept else None,
    )
    return Setting(new, setting.solver, interval * time)


def integrated(plain: Setting, began=None):
    """End of its motion by the fuzzing's own equations, from its start or where it ``began``."""
    (t0, t1), (q, v) = plain.span, began or plain.judge.start[:2]
    with suppress(np.linalg.LinAlgError):
        motion = plain.judge.carried(t0, q, v, [t1])
        if motion is not None and np.isfinite(motion).all():
            return np.split(motion[0], 2)
    return None


def arrived(plain: Setting):
    """End of its run, under error control a finer one, if it says success."""
    way = plain.case.way
    found = plain.run(max_evaluations=PATIENT, rtol=None if way.steps else max(FINER * way.rtol, FINEST)).solution
    return end(found) if found is not None and found.success and np.isfinite(found.q[-1]).all() else None


def errors(setting: Setting, s: Solution) -> float:
    """What a run may err by over the sizes, of a motion that is well conditioned."""
    way, spoil = setting.case.way, setting.case.spoil
    found = CLOSE if way.steps else TOLERANCES * max(way.rtol, FINEST) * max(1.0, way.turns)
    crossed = float(np.abs(s.v).max()) / (setting.judge.sizes[0] or 1.0)  # it may have become fast
    changes = np.count_nonzero(np.diff(s.t) == 0.0)
    found += EPS * float(np.abs(s.t).max()) * max(setting.rate, crossed) * (1 + changes)  # of times, of events too
    sigma = setting.judge.sigma(float(s.t[0]), s.q[0]) or 1.0  # 0: no such number, and no allowance by it
    found += ROUNDED * EPS / sigma**2  # of rows nearly alike
    found += max(x / size for x, size in zip(rounding(setting, s), sizes(setting, s), strict=True))
    found += number(UNRESOLVED, s) / setting.judge.sizes[1]  # in a step that does not see it
    return found + (0.0 if spoil is None or not is_felt(spoil) else spoil.since)


def is_felt(spoil: Spoil) -> bool:
    """Whether the motion errs by as much as it: noise, a start, and g_t + g_q v of a derivative that is wrong by little."""
    told = "constraint" not in spoil.where or spoil.since > UNTOLD
    return spoil.kind in ("noise", "off") or (spoil.kind == "wrong" and not told)
