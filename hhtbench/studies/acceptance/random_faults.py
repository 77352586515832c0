"""Random systems and injected faults (rows R8, R9)."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.subject import Declined
from hhtbench.lowering import CONSISTENT
from hhtbench.studies.acceptance.asked import Asked
from hhtbench.studies.acceptance.callbacks import PLACES, spoiled
from hhtbench.studies.acceptance.linear_algebra_events import WRONG_JACOBIANS, claiming
from hhtbench.studies.acceptance.rows import Finding, every, row
from hhtbench.studies.acceptance.scenes import Q0, V0, Rod, ends, plane, problem
from hhtbench.studies.acceptance.side_effects import raising, spoiling

STATUS = hb.Status
FINE = 1e-5  # tolerances below which differences may not suffice
MANY = 1_000  # steps that a budget must have been spent on


@row(
    "R8",
    "200 random systems, options and faults",
    "no hang, no crash; what is sound succeeds, on the constraints; what is not is named",
    long=True,
)
def random_cases(asked: Asked) -> Finding:
    """By seed; hypothesis and 10,000 cases are the fuzzing's.

    The first row is the start as it was given, which counts as consistent to 1e-8 of its size.  At tolerances below 1e-5
    functions whose derivatives are differences may end at roundoff or with a budget, by name.  Between sound and broken
    are functions that fail within 0.01 s of the end or shortly after it, and starts about as much off as that.
    """
    random, faults = np.random.default_rng(11), {}
    for count in range(200):
        faults[f"case {count}"] = _random_case(asked, random)
    return every(faults)


def _unreachable(found: hb.Solution) -> bool:
    """Whether a run ended since its tolerance is too fine, and says so: at roundoff, or after many steps with a budget."""
    if found.status in (STATUS.max_steps, STATUS.deadline, STATUS.evaluation_budget):
        return (found.counters.steps_accepted or 0) >= MANY
    return found.status is STATUS.step_too_small and "roundoff" in found.message


def _random_case(asked: Asked, random: np.random.Generator) -> str:
    name, bad = str(random.choice(list(PLACES))), float(random.choice([np.nan, np.inf]))
    since, broken = random.uniform(0.0, 2.0), random.random() < 0.5
    system = spoiled(name, bad, lambda t, n: broken and t >= since)
    span = (0.0, float(10.0 ** random.uniform(-3, 0.3)))
    off = 10.0 ** random.uniform(-18, 0) * (random.random() < 0.3)
    way = dict(asked.ways())
    request = dict(way[str(random.choice(list(way)))])
    if "rtol" in request:
        request["rtol"] = float(10.0 ** random.uniform(-8, -2))
    began = time.perf_counter()
    found = asked.solve(problem(system, Q0 * (1 + off), V0, span), **request, max_seconds=5.0)
    if time.perf_counter() - began > 10.0:
        return "hangs"
    inside, outside = broken and since < span[1] - 0.01, not broken or since > 2 * span[1]
    causes = {name: STATUS.nonfinite_callback} if broken and not outside else {}
    causes |= {"g[0]": STATUS.inconsistent_initial} if off > 0.1 * CONSISTENT else {}
    if not found.success:
        if asked.engine == "python" and found.status is STATUS.deadline:  # 5 s are not many steps there
            return ""
        if request.get("rtol", 1.0) < FINE and _unreachable(found):
            return ""
        named = any(found.status is status and word in found.message for word, status in causes.items())
        return "" if named else ends(found, *causes.values()) or f"does not name {' or '.join(causes)}: {found.message[:90]}"
    if inside or off > 10 * CONSISTENT:
        return f"silent: {' and '.join(causes)}"
    levels = np.maximum(
        np.abs((found.q**2).sum(axis=1) - 1), np.abs((found.q * found.v).sum(axis=1)) / np.abs(found.v).max()
    )
    level = float(levels[1:].max() if levels[0] <= 2 * CONSISTENT else np.inf)
    allowed = 2e-9 if asked.is_hht else 10 * request.get("rtol", 1e-6) + 3 * off  # of 2 |g| and of |q . v| over |v|
    finite = all(np.isfinite(getattr(found, x)).all() for x in ("q", "v", "lam"))
    return "" if finite and level <= allowed else f"silent: level {level:.1e}"


def _always(t: float, count: int) -> bool:
    return True


def _system(**functions: Any) -> Callable[[], hb.NumpySystem]:
    return lambda: plane(**functions)


def _late(since: float, t: float, count: int) -> bool:
    return t >= since


RADII = _system(
    constraint=lambda t, q: np.array([q @ q - 1, q @ q - 1.21]) / 2, constraint_jacobian=lambda t, q: np.stack([q, q])
)
LONG = _system(force_jacobians=lambda t, q, v: (np.zeros((2, 3)), np.zeros((3, 2))))
LONG_CONSTRAINT = _system(constraint_jacobian=lambda t, q: np.zeros((3, 2)))
JUMP = _system(force=lambda t, q, v: np.array([0.0, -9.81 if t < 1 else -1e12]))
MASSLESS = hb.NumpySystem(mass_matrix=[1.0, 0.0], force=lambda t, q, v: np.array([0.0, -9.81]))
CRAWL, UNTIMED = (
    50_000,
    600.0,
)  # evaluations, [s]: more than ten times what the longest of these runs takes; no machine is so slow
Fault = tuple[dict[str, Any], tuple[hb.Status, ...], tuple[str, ...]]


def injected() -> dict[str, Fault]:
    """What is solved, with the status and the words that name its cause."""
    off, nan, faults = (STATUS.inconsistent_initial,), (STATUS.nonfinite_callback,), dict[str, Fault]()
    for name in PLACES:
        for since in (-1.0, 1.0):
            system = spoiled(name, np.nan, partial(_late, since))
            faults[f"NaN in {name} from {since:g}"] = {"system": system}, nan, (name,)
    faults |= {
        "infinite Jacobian": ({"system": claiming(lambda x: x * np.nan)}, nan, ("force_jacobians",)),
        "start off g": ({"q0": Q0 * 1.05}, off, ("g[0]",)),
        "start off Gv": ({"v0": V0 + 0.2 * Q0}, off, ("g_q v",)),
        **{
            f"force Jacobian {case}": (
                {"system": claiming(change), "t_span": (0.0, 0.02)},
                (STATUS.success, STATUS.newton_failed),
                ("force_jac",),
            )
            for case, change in WRONG_JACOBIANS.items()
        },
        "NaN constraint Jacobian": ({"system": spoiled("constraint_jacobian", np.nan, _always)}, nan, ("constraint_jac",)),
        "shape of the force Jacobian": ({"system": LONG()}, (), ("force_jac",)),
        "shape of the constraint Jacobian": ({"system": LONG_CONSTRAINT()}, (), ("constraint_jac",)),
        "contradiction": ({"system": RADII()}, off, ("g[1]",)),
        "no mass": ({"system": MASSLESS}, (STATUS.singular_iteration_matrix,), ("mass",)),
        "steps": ({"max_num_steps": 3}, (STATUS.max_steps,), ("3 steps",)),
        "evaluations": ({"max_evaluations": 9}, (STATUS.evaluation_budget,), ("9 evaluations",)),
        "seconds": ({"max_seconds": 1e-9}, (STATUS.deadline,), ("seconds",)),
        "times": ({"t_span": (1e15, 1e15 + 1)}, (STATUS.time_resolution,), ("1000000000000000",)),
        "text for a force": ({"system": plane(force=lambda t, q, v: "ab")}, (), ("force",)),
        "a column for a force": ({"system": plane(force=lambda t, q, v: np.zeros((2, 1)))}, (), ("force", "(2, 1)")),
        "q changed in place": ({"system": plane(force=spoiling(0))}, (), ("read-only",)),
        "v changed in place": ({"system": plane(force=spoiling(1))}, (), ("read-only",)),
        "a negative tolerance": ({"rtol": -1e-6}, (), ("rtol",)),
        "an end of NaN": ({"t_span": (0.0, np.nan)}, (), ("t_span",)),
        "an unknown option": ({"stepp": 0.1}, (), ("stepp",)),
        "an overflowing weight": ({"system": Rod(gravity=1e308)}, nan, ("force[1]",)),
        "a huge jump": ({"system": JUMP()}, (STATUS.step_too_small, STATUS.success), ()),
        "exception": (
            {"system": raising(ZeroDivisionError("own"), "force", 1.0)},
            (STATUS.user_exception,),
            ("ZeroDivision",),
        ),
    }
    return faults


def _solved(asked: Asked, given: dict[str, Any]) -> hb.Solution:
    counted = {"max_evaluations": CRAWL, "max_seconds": UNTIMED} if asked.is_hht else {}  # a crawl is counted, not timed
    request = {"rtol": 1e-4, **counted, **given}
    place = (request.pop(name, value) for name, value in (("system", Rod()), ("q0", Q0), ("v0", V0), ("t_span", (0.0, 1.5))))
    return asked.solve(problem(*place), **request)


@row("R9", "every injected fault of C, O, P, J", "the reported cause is the injected one in at least 95 %, within 10 s each")
def causes(asked: Asked) -> Finding:
    """The status, and the words of the message."""
    faults, slowest = {}, 0.0
    for case, (given, statuses, words) in injected().items():
        began = time.perf_counter()
        try:
            found = _solved(asked, given)
            right = found.success and STATUS.success in statuses  # there is no cause to name
            faults[case] = ends(found, *statuses, words=() if right else words)
        except Declined:
            continue
        except ZeroDivisionError:
            faults[case] = "" if case == "exception" else "raises"
        except (ValueError, TypeError) as error:
            named = not statuses and all(word in str(error) for word in words)
            faults[case] = "" if named else f"raises {type(error).__name__}: {str(error)[:60]}"
        finally:
            slowest = max(slowest, time.perf_counter() - began)
    wrong = sum(map(bool, faults.values()))
    judged = every(faults, f"slowest {slowest:.2g} s", in_time=slowest <= 10.0)
    return replace(judged, holds=wrong <= 0.05 * len(faults))
