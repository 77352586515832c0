"""Rows R8, R9: random systems, and whether messages name injected faults."""

from __future__ import annotations

from contextlib import suppress

import numpy as np

import hhtbench as hb
from hhtbench.conformance.entry import Lane
from hhtbench.conformance.rows import callbacks, derivatives_events, inputs, options, physics
from hhtbench.conformance.rows.judging import Cases, ends, row
from hhtbench.conformance.scenes.rod import PLACES, Q0, spoiled
from hhtbench.conformance.subject import Declined, Subject
from hhtbench.lowering import CONSISTENT

STATUS = hb.Status
FINE = 1e-5  # tolerances below which differences may not suffice
SPENT = 1_000  # steps that a run must have taken before the end of a budget names a cause


@row("R8", "200 random systems, options and faults", "what is sound succeeds, what is not is named", lane=Lane.slow)
def random_cases(subject: Subject) -> Cases:
    """Yield the cases of row R8: 200 random systems, options and faults.

    By seed; hypothesis and 10,000 cases are the fuzzing's.

    The first row is the start as it was given, which counts as consistent to 1e-8 of its size.  At tolerances below 1e-5
    functions whose derivatives are differences may end at roundoff or with a budget, by name.  Between sound and broken
    are functions that fail within 0.01 s of the end or shortly after it, and starts about as much off as that.
    """
    random = np.random.default_rng(11)
    for count in range(200):
        yield f"case {count}", _random_case(subject, random)


def _unreachable(found: hb.Solution) -> bool:
    """True if a run ended because its tolerance is too small and says so: at roundoff, or at a budget after many steps."""
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


INJECTED = (
    *(inputs.off_the_constraints, inputs.sizes, callbacks.from_the_start, callbacks.from_one_second_on),
    *(callbacks.wrong_returns, callbacks.changes_in_place, callbacks.own_exceptions, callbacks.exits),
    *(options.bad_tolerances, options.budgets, options.unknown_option, options.beyond_the_resolution),
    *(options.bad_intervals, physics.singular_matrix, physics.contradictory, physics.overflows),
    *(derivatives_events.altogether_wrong, derivatives_events.broken),
)


@row(
    "R9",
    f"the faults of {', '.join(x.entry.id for x in INJECTED)}",
    "the reported cause is the injected one in at least 95 %, within 10 s each",
    seconds=10.0,
    most_failing=0.05,
    lane=Lane.slow,
)
def causes(subject: Subject) -> Cases:
    """What a solver declines is left out."""
    for measure in INJECTED:
        with suppress(Declined):
            for case, found in measure.cases(subject):
                yield f"{measure.entry.id} {case}", found
