"""Random systems and injected faults (rows R8, R9)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Finding, Lane, row
from hhtbench.conformance.rows.judging import Cases, ends, judged
from hhtbench.conformance.rows.judging import row as case_row
from hhtbench.conformance.scenes.rod import (
    MASSLESS,
    PLACES,
    Q0,
    V0,
    WRONG_JACOBIANS,
    Rod,
    claiming,
    mutating,
    plane,
    raising,
    spoiled,
    two_rods,
)
from hhtbench.conformance.subject import Declined, Subject
from hhtbench.lowering import CONSISTENT

STATUS = hb.Status
FINE = 1e-5  # tolerances below which differences may not suffice
SPENT = 1_000  # steps that a run must have taken before the end of a budget names a cause


@case_row(
    "R8",
    "200 random systems, options and faults",
    "no hang, no crash; what is sound succeeds, on the constraints; what is not is named",
    lane=Lane.slow,
)
def random_cases(subject: Subject) -> Cases:
    """By seed; hypothesis and 10,000 cases are the fuzzing's.

    The first row is the start as it was given, which counts as consistent to 1e-8 of its size.  At tolerances below 1e-5
    functions whose derivatives are differences may end at roundoff or with a budget, by name.  Between sound and broken
    are functions that fail within 0.01 s of the end or shortly after it, and starts about as much off as that.
    """
    random = np.random.default_rng(11)
    for count in range(200):
        yield f"case {count}", _random_case(subject, random)


def _unreachable(found: hb.Solution) -> bool:
    """Whether a run ended since its tolerance is too fine, and says so: at roundoff, or after many steps with a budget."""
    if found.status in (STATUS.max_steps, STATUS.deadline, STATUS.evaluation_budget):
        return (found.counters.steps_accepted or 0) >= SPENT
    return found.status is STATUS.step_too_small and "roundoff" in found.message


def _random_case(subject: Subject, random: np.random.Generator) -> str:
    name, bad = str(random.choice(list(PLACES))), float(random.choice([np.nan, np.inf]))
    since, broken = random.uniform(0.0, 2.0), random.random() < 0.5
    system = spoiled(name, bad, lambda t, n: broken and t >= since)
    span = (0.0, float(10.0 ** random.uniform(-3, 0.3)))
    off = 10.0 ** random.uniform(-18, 0) * (random.random() < 0.3)
    way = subject.ways()
    request = dict(way[str(random.choice(list(way)))])
    if "rtol" in request:
        request["rtol"] = float(10.0 ** random.uniform(-8, -2))
    found = subject.ask(system, span, q0=Q0 * (1 + off), **request, max_seconds=5.0)
    if subject.took[-1] > 10.0:
        return "hangs"
    causes = {name: STATUS.nonfinite_callback} if broken and since <= 2 * span[1] else {}
    causes |= {"g[0]": STATUS.inconsistent_initial} if off > 0.1 * CONSISTENT else {}
    if not found.success:
        slow = subject.engine == "python" and found.status is STATUS.deadline  # 5 s are not many steps there
        if slow or (request.get("rtol", 1.0) < FINE and _unreachable(found)):
            return ""
        named = any(found.status is status and word in found.message for word, status in causes.items())
        return "" if named else ends(found, *causes.values()) or f"does not name {' or '.join(causes)}: {found.message[:90]}"
    if (broken and since < span[1] - 0.01) or off > 10 * CONSISTENT:
        return f"silent: {' and '.join(causes)}"
    position = np.abs((found.q**2).sum(axis=1) - 1)
    levels = np.maximum(position, np.abs((found.q * found.v).sum(axis=1)) / np.abs(found.v).max())
    level = float(levels[1:].max() if levels[0] <= 2 * CONSISTENT else np.inf)
    allowed = 2e-9 if subject.is_hht else 10 * request.get("rtol", 1e-6) + 3 * off  # of 2 |g| and of |q . v| over |v|
    finite = all(np.isfinite(getattr(found, x)).all() for x in ("q", "v", "lam"))
    return "" if finite and level <= allowed else f"silent: level {level:.1e}"


Fault = tuple[dict[str, Any], tuple[hb.Status, ...], tuple[str, ...]]
JUMP = plane(force=lambda t, q, v: np.array([0.0, -9.81 if t < 1 else -1e12]))
LONG = plane(force_jacobians=lambda t, q, v: (np.zeros((2, 3)), np.zeros((3, 2))))
LONG_CONSTRAINT = plane(constraint_jacobian=lambda t, q: np.zeros((3, 2)))


def injected() -> dict[str, Fault]:
    """What is solved, with the status and the words that name its cause; no status: it is refused."""
    off, nan = (STATUS.inconsistent_initial,), (STATUS.nonfinite_callback,)
    either, own = (STATUS.success, STATUS.newton_failed), ZeroDivisionError("own")
    faults: dict[str, Fault] = {}
    for name in PLACES:
        for since in (-1.0, 1.0):
            late: Callable[..., bool] = lambda t, n, since=since: t >= since  # noqa: E731
            faults[f"NaN in {name} from {since:g}"] = {"given": spoiled(name, np.nan, late)}, nan, (name,)
    for case, change in WRONG_JACOBIANS.items():
        faults[f"force Jacobian {case}"] = {"given": claiming(change), "t_span": (0.0, 0.02)}, either, ("force_jac",)
    return faults | {
        "infinite Jacobian": ({"given": claiming(lambda x: x * np.nan)}, nan, ("force_jacobians",)),
        "start off g": ({"q0": Q0 * 1.05}, off, ("g[0]",)),
        "start off Gv": ({"v0": V0 + 0.2 * Q0}, off, ("g_q v",)),
        "shape of the force Jacobian": ({"given": LONG}, (), ("force_jac",)),
        "shape of the constraint Jacobian": ({"given": LONG_CONSTRAINT}, (), ("constraint_jac",)),
        "contradiction": ({"given": two_rods()}, off, ("g[1]",)),
        "no mass": ({"given": MASSLESS}, (STATUS.singular_iteration_matrix,), ("mass",)),
        "steps": ({"max_num_steps": 3}, (STATUS.max_steps,), ("3 steps",)),
        "evaluations": ({"max_evaluations": 9}, (STATUS.evaluation_budget,), ("9 evaluations",)),
        "seconds": ({"max_seconds": 1e-9}, (STATUS.deadline,), ("seconds",)),
        "times": ({"t_span": (1e15, 1e15 + 1)}, (STATUS.time_resolution,), ("1000000000000000",)),
        "text for a force": ({"given": plane(force=lambda t, q, v: "ab")}, (), ("force",)),
        "a column for a force": ({"given": plane(force=lambda t, q, v: np.zeros((2, 1)))}, (), ("force", "(2, 1)")),
        "q changed in place": ({"given": mutating(0)}, (), ("read-only",)),
        "v changed in place": ({"given": mutating(1)}, (), ("read-only",)),
        "a negative tolerance": ({"rtol": -1e-6}, (), ("rtol",)),
        "an end of NaN": ({"t_span": (0.0, np.nan)}, (), ("t_span",)),
        "an unknown option": ({"stepp": 0.1}, (), ("stepp",)),
        "an overflowing weight": ({"given": Rod(gravity=1e308)}, nan, ("force[1]",)),
        "a huge jump": ({"given": JUMP}, (STATUS.step_too_small, STATUS.success), ()),
        "exception": ({"given": raising(own, "force", 1.0)}, (STATUS.user_exception,), ("ZeroDivision",)),
    }


CRAWL, UNTIMED = 50_000, 600.0  # evaluations, [s]: more than ten times the longest of these runs; no machine is so slow


def _causes(subject: Subject) -> Cases:
    counted = {"max_evaluations": CRAWL, "max_seconds": UNTIMED} if subject.is_hht else {}  # a crawl is counted, not timed
    for case, (request, statuses, words) in injected().items():
        try:
            found = subject.ask(**{"given": Rod(), "rtol": 1e-4, **counted, **request})
            right = found.success and STATUS.success in statuses  # there is no cause to name
            yield case, ends(found, *statuses, words=() if right else words)
        except Declined:
            continue
        except ZeroDivisionError:
            yield case, "" if case == "exception" else "raises"
        except (ValueError, TypeError) as error:
            named = not statuses and all(word in str(error) for word in words)
            yield case, "" if named else f"raises {type(error).__name__}: {str(error)[:60]}"


@row(
    "R9",
    "every injected fault of C, O, P, J",
    "the reported cause is the injected one in at least 95 %, within 10 s each",
    known={"ida": (("force Jacobian 1e6",), "a Jacobian that is wrong by 1e6: at 6.6e-4 to 1.1e-2 s after 20 s")},
)
def causes(subject: Subject) -> Finding:
    """The status, and the words of the message."""
    found = judged(_causes(subject), subject, 10.0)
    return replace(found, holds=len(found.failing) <= 0.05 * len(injected()))
