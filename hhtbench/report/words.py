"""Numbers and short phrases of the comparison, the same on the page and in the summary."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from hhtbench.campaign.analysis.cells import Point, family
from hhtbench.campaign.analysis.fronts import Comparison

MEASURES = {"time": "processor time", "evaluations": "residual evaluations"}
SHORT = {"time": "processor time", "evaluations": "evaluations"}
NOTHING = "\N{EN DASH}"
EQUAL = "equal within noise"  # said of two times that differ by no more than repeats of one solve
AT_MOST = "\N{LESS-THAN OR EQUAL TO}"
STAR = "the process had to wait: its median solve took clearly more wall time than processor time"
BESIDE = f"{AT_MOST} taken beside other work: an upper bound"
VERBS = {"level": "equal,"}
KINDS = {  # why a target is not reached
    "capped": "limit of the campaign",
    "standstill": "no gain from finer settings",
    "fails": "fails",
    "refused": "not supported",
    "drifts": "too much drift",
    "unjudged": "reference too coarse",
    "uncounted": "evaluations not counted",
    "not run": "not run",
    "unfinished": "campaign interrupted",
    "not asked": "no run so accurate",
}
UNCOUNTED = {"diffrax": "not counted: its Newton iterations run inside compiled code, counting needs a second compilation"}


def short(entry: str) -> str:
    """A solver's spec without the names of options that are clear from their values: method, form, a negative alpha."""
    return re.sub(r"\b(?:method|form|solver)=|\balpha=(?=-)", "", entry)


def shown(value: float | None) -> str:
    """Three digits; a dash where nothing was measured."""
    return NOTHING if value is None else f"{value:.3g}"


def brief(value: float | None) -> str:
    """Two digits, for tables of many columns."""
    return NOTHING if value is None else f"{value:.1e}" if 0 < abs(value) < 0.01 else f"{value:.2g}"


def count(value: float | None) -> str:
    """A whole number."""
    return NOTHING if value is None else f"{value:.0f}"


def seconds(value: float | None) -> str:
    """A time in the unit that suits its size."""
    if value is None:
        return NOTHING
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if value * factor >= 1:
            return f"{value * factor:.3g} {unit}"
    return f"{value * 1e6:.3g} \N{MICRO SIGN}s"


def work(value: float | None, measure: str) -> str:
    """A cost with its unit."""
    return seconds(value) if measure == "time" else count(value)


def times(factor: float) -> str:
    """``12.3×``."""
    return f"{factor:,.0f}\N{MULTIPLICATION SIGN}" if factor >= 1000 else f"{factor:.3g}\N{MULTIPLICATION SIGN}"


def plural(number: int, word: str) -> str:
    """``1 run``, ``2 runs``."""
    ending = "" if number == 1 else "es" if word.endswith("s") else "s"
    return f"{number} {word}{ending}"


def listed(parts: list[str]) -> str:
    """``a, b and c``."""
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def dearer(line: Comparison) -> float:
    """The factor between the two, above 1, whoever wins; 1 where there is none."""
    factor = line.factor or 1.0
    return max(factor, 1.0 / factor)


def factor(line: Comparison) -> str:
    """:func:`dearer` with "at most" where the dearer side's cost is an upper bound, "at least" where the other's is."""
    if line.subject is None or line.rival is None:
        return NOTHING
    winner, loser = (line.subject, line.rival) if (line.factor or 0) > 1 else (line.rival, line.subject)
    return bound_of(loser.bound, winner.bound) + times(dearer(line))


def repeats(level: float) -> str:
    """The factor by which repeats of one solve differ; a level of exactly 1 comes from none."""
    return f"a factor of {level:.3g}" if level > 1.0 else "of which none were timed"


def sign_of(at_most: bool, at_least: bool) -> str:
    """The same as :func:`bound_of` as a sign, for tables."""
    signs = {(True, False): AT_MOST, (False, True): "\N{GREATER-THAN OR EQUAL TO}", (True, True): "\N{ALMOST EQUAL TO}"}
    return f"{signs[at_most, at_least]} " if at_most or at_least else ""


def bound_of(at_most: bool, at_least: bool) -> str:
    """What stands before a number that rests on upper bounds, or on lower ones, or on both."""
    return {(True, False): "at most ", (False, True): "at least ", (True, True): "about "}.get((at_most, at_least), "")


def bound_label(bound: float | None) -> str:
    """A bound of the drift on a button, in a table."""
    return "any" if bound is None else f"{AT_MOST} {bound:.0e}"


def bounded(bound: float | None) -> str:
    """A bound of the drift, as the end of a clause."""
    return "whatever the drift" if bound is None else f"with drift of at most {bound:.0e}"


def outcome(line: Comparison) -> str:
    """Who costs less, by which factor; or who reaches the error at all."""
    if line.outcome == "absent":
        return "HHT does not reach it"
    if line.outcome == "unknown":
        reason = line.own_missing
        return (
            reason.text
            if reason is not None
            else "no HHT run"
            if line.subject is None
            else "no other solver to compare with"
        )
    texts = {"alone": "only HHT reaches it", "unheld": "the others drift more"}
    return texts.get(line.outcome) or f"{VERBS.get(line.outcome, line.outcome)} {factor(line)}"


def behind(line: Comparison) -> str:
    """Who the other side is, why one side does not reach the error, and what it would cost at least."""
    if line.factor is not None and line.rival is not None:
        return f"against {short(line.rival.entry)}"
    least = line.least_factor
    more = f"more than {times(least)}" if least is not None and least > 1 else ""
    if line.outcome == "alone":
        return f"the others need {more}" if more else ""
    if line.outcome != "absent" or line.own_missing is None:
        return ""
    return f"{line.own_missing.text}{f'; it needs {more}' if more else ''}"


def doubt(message: str) -> str:
    """Why the result of a run that came to an end is rejected."""
    return f"result rejected: {message}"


def compared(runs: Iterable[Point]) -> str:
    """At how many times errors were taken, as the end of a phrase; "" where it is not known."""
    counts = sorted({run.compared for run in runs if run.compared is not None})
    if not counts:
        return ""
    if counts == [1]:
        return ", compared at 1 time only"
    return f", the largest over {f'{counts[0]} to ' if len(counts) > 1 else ''}{counts[-1]} compared times"


def timed(run: Point) -> str:
    """Processor time; an upper bound beside other work, with a star where the process had to wait."""
    if run.time is None:
        return NOTHING
    bound = "" if run.alone or not run.success else AT_MOST + " "
    return f"{bound}{seconds(run.time)}{'*' if run.disturbed else ''}"


def weighed(runs: Iterable[Point]) -> str:
    """What an evaluation is."""
    counted = [run for run in runs if run.evaluations is not None]
    calls = [(run.entry.startswith("minimal("), run.call) for run in counted if run.call is not None]
    most = {minimal: max((call for own, call in calls if own == minimal), default=0.0) for minimal in (False, True)}
    unknown = len({run.problem for run in counted if run.call is None})
    known = (
        "An evaluation is one of the residual of the problem's equations; what a solver evaluates counts by its operations, "
        f"an acceleration as up to {most[False]:.1f}"
        + (f", a call on minimal coordinates as up to {most[True]:.1f}." if most[True] else ".")
    )
    alike = f"On {plural(unknown, 'problem')} a solver's call counts as one whatever it is: its operations are not known."
    return " ".join([known] * bool(calls) + [alike] * (unknown > 0))


def uncounted(entries: Sequence[str]) -> str:
    """Who is in no ranking by evaluations, and why; "" where all are counted."""
    if not entries:
        return ""
    reasons: dict[str, list[str]] = {}
    for entry in entries:
        reasons.setdefault(UNCOUNTED.get(family(entry), "not counted"), []).append(entry)
    texts = [f"{listed(own)} ({reason})" for reason, own in reasons.items()]
    return f"Not ranked by evaluations: {'; '.join(texts)}."
