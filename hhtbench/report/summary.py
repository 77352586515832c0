"""Findings of the comparison as sentences; every number is one of the rows or counted from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from statistics import median

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import NEAR, SUBJECT, TYPICAL_ERROR, Point, family
from hhtbench.campaign.analysis.drift import equally_accurate
from hhtbench.campaign.analysis.fronts import BOUNDS, STEADY, Comparison
from hhtbench.campaign.analysis.missing import NOT_RUN, UNREFINED
from hhtbench.campaign.analysis.outcomes import Newest, machines
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.words import (
    KINDS,
    MEASURES,
    STAR,
    bounded,
    dearer,
    factor,
    listed,
    plural,
    shown,
    uncounted,
)


def summary(rows: Sequence[RunRow]) -> list[str]:
    """Paragraphs: what ran, where HHT wins and loses, drift, what the reader must know of the data."""
    if not rows:
        return ["The store holds no rows, so nothing is compared."]
    parts = [_coverage(rows), _reached(rows)]
    if not any(family(run.entry) == SUBJECT for run in analysis.points(rows)):
        parts.append("No HHT run is among the rows, so HHT is not compared.")
    else:
        compared = {bound: analysis.compare(rows, held=bound) for bound in BOUNDS}
        parts += [_balance(compared, measure) for measure in MEASURES]
        parts.append(_held_out(rows))
    return [part for part in [*parts, _drift(rows), _caveats(rows)] if part]


def _coverage(rows: Sequence[RunRow]) -> str:
    good = sum(row.success for row in rows)
    failed = [f"{status} {number}" for status, number in analysis.statuses(row for row in rows if not row.success).items()]
    others = f"The others: {', '.join(failed)}." if failed else ""
    solvers = plural(len(analysis.entries(rows)), "solver")
    problems = plural(len(analysis.problems(rows)), "problem")
    return (
        f"{good} of {plural(len(rows), 'run')} reached the end with a sound result ({problems}, {solvers}). {others}".strip()
    )


def _reached(rows: Sequence[RunRow]) -> str:
    """How many errors the solvers reached on their problems, and why not the others."""
    fronts = analysis.fronts(rows, "time")
    reached = sum(len(front.costs) for front in fronts)
    kinds = Counter(reason.kind for front in fronts for reason in front.missing.values())
    total = reached + sum(kinds.values())
    ends = [f"{words} {kinds[kind]}" for kind, words in KINDS.items() if kinds[kind]]
    rest = f" The others: {', '.join(ends)}." if ends else ""
    return (
        f"Of {plural(total, 'goal')}, each a problem, a solver and an error, {reached} "
        f"{'is' if reached == 1 else 'are'} reached.{rest} Not tried: {sum(kinds[kind] for kind in (NOT_RUN, *UNREFINED))}."
    )


def _balance(compared: Mapping[float | None, Sequence[Comparison]], measure: str) -> str:
    """How often HHT wins and loses by one measure, at every bound of the drift, and the extremes without one."""
    bounds: dict[str, list[str]] = {}  # tally -> bounds of the drift that have it
    for bound, lines in compared.items():
        own = [line for line in lines if line.measure == measure]
        if any(line.outcome != "unknown" for line in own):
            bounds.setdefault(_tally(own), []).append(bounded(bound))
    parts = [f"{listed(found)}, HHT {tally}" for tally, found in bounds.items()]
    if not parts:
        return f"By {MEASURES[measure]}, nothing can be compared: HHT and another solver never reach the same error."
    judged = [line for line in compared[None] if line.measure == measure and line.factor is not None]
    text = (
        f"By {MEASURES[measure]}, HHT's best entry is compared with the cheapest other solver at the same achieved error. "
    )
    text += f"{'. '.join(sentence[0].upper() + sentence[1:] for sentence in parts)}. "
    text += "".join(_extreme([line for line in judged if line.outcome == verb], verb) for verb in ("loses", "wins"))
    return text.strip()


def _tally(lines: Sequence[Comparison]) -> str:
    """``wins 3, loses 2 and is equal in 1 of 6 comparisons; in 2 more only HHT reaches the error``."""
    counts = Counter(line.outcome for line in lines)
    judged = [line for line in lines if line.factor is not None]
    text = f"wins {counts['wins']}, loses {counts['loses']} and is equal in {counts['level']} of "
    text += plural(len(judged), "comparison")
    more = {
        "alone": "only HHT reaches the error",
        "unheld": "the others drift more",
        "absent": "only others reach the error",
    }
    found = [f"in {counts[name]} more {said}" for name, said in more.items() if counts[name]]
    return f"{text}; {listed(found)}" if found else text


def _held_out(rows: Sequence[RunRow]) -> str:
    """The same, on the held-out problems alone."""
    names = dict.fromkeys(run.problem for run in analysis.points(rows) if run.held_out)
    own = [line for line in analysis.compare(rows) if line.problem in names and line.measure == "time"]
    if not any(line.outcome != "unknown" for line in own):
        return ""
    count = plural(len(names), "problem")
    return f"On the {count} that {'was' if len(names) == 1 else 'were'} held out, by {MEASURES['time']}, HHT {_tally(own)}."


def _extreme(lines: Sequence[Comparison], verb: str) -> str:
    line = max(lines, key=dearer, default=None)
    if line is None or line.subject is None or line.rival is None:
        return ""
    cheap, dear = (line.subject, line.rival) if verb == "wins" else (line.rival, line.subject)
    needs = f"{dear.entry} needs {factor(line)} the {MEASURES[line.measure]} of {cheap.entry}"
    noun = {"wins": "win", "loses": "loss"}[verb]
    return f"Its largest {noun} is on {line.problem} at an error of {line.target:.0e}: {needs}. "


def _drift(rows: Sequence[RunRow]) -> str:
    """Drift among runs of one accuracy; a run that is more accurate than the others would drift less."""
    found = equally_accurate(rows)
    mine = [run for entry, runs in found.items() if family(entry) == SUBJECT for run in runs]
    others = {entry: runs for entry, runs in found.items() if family(entry) != SUBJECT}
    parts = []
    for level in ("position", "velocity"):
        own, other = _worst(mine, level), _worst([run for runs in others.values() for run in runs], level)
        if own is None:
            continue
        text = f"HHT's largest {level} drift is {shown(getattr(own, level))} (on {own.problem})"
        if other is not None:
            steady = sum(_holds(runs, level) for runs in others.values())
            measured = sum(_worst(runs, level) is not None for runs in others.values())
            text += f"; {steady} of {plural(measured, 'other')} stay at or below {STEADY:.0e} at this accuracy"
            text += f"; the largest is {shown(getattr(other, level))} ({other.entry} on {other.problem})"
        parts.append(text + ".")
    head = f"At equal accuracy (errors within a factor {NEAR:g} of {TYPICAL_ERROR:.0e})"
    return f"{head}: {' '.join(parts)}" if parts else ""


def _holds(runs: Sequence[Point], level: str) -> bool:
    worst = _worst(runs, level)
    return worst is not None and getattr(worst, level) <= STEADY


def _worst(runs: Sequence[Point], level: str) -> Point | None:
    return max((run for run in runs if getattr(run, level) is not None), key=lambda run: getattr(run, level), default=None)


def _caveats(rows: Sequence[RunRow]) -> str:
    runs = [run for run in analysis.points(rows) if run.success]
    parts = []
    unknown = [name for name in analysis.problems(rows) if not any(r.error is not None for r in runs if r.problem == name)]
    if unknown:
        parts.append(
            f"No error is known on {listed(unknown)}, which have no exact solution, no reference or no successful run."
        )
    once = [name for name in analysis.problems(rows) if {r.compared for r in runs if r.problem == name} == {1}]
    if once:
        parts.append(f"On {listed(once)} errors are compared at 1 time only.")
    parts += _times(runs)
    limited = [run for run in runs if run.error is not None and run.error < run.limit]
    if limited:
        parts.append(f"{plural(len(limited), 'error')} lie below the error bar of the reference and are shown as they are.")
    if silent := analysis.silent(rows):
        parts.append(uncounted(silent))
    if len(machines(rows)) > 1:
        parts.append(f"The rows come from {len(machines(rows))} environments, whose times do not compare.")
    return " ".join(parts)


def _times(runs: Sequence[Point]) -> list[str]:
    """How far the times can be trusted."""
    timed = [run for run in runs if run.time is not None]
    counted = {
        "were taken beside other work and are upper bounds": sum(not run.alone for run in timed),
        f"are marked *: {STAR}": sum(run.disturbed for run in timed),
    }
    parts = [f"{number} of {plural(len(timed), 'time')} {text}." for text, number in counted.items() if number]
    shares = [run.share for run in timed if run.share is not None]
    if shares:
        parts.append(f"The median ratio of processor time to wall time of the timed solves is {median(shares):.2f}.")
    return parts


def older(found: Newest) -> list[str]:
    """What was left out of the store's rows."""
    if not found.left_out:
        return []
    cells = f"{plural(found.cells, 'cell')} of the store {'exists' if found.cells == 1 else 'exist'}"
    return [
        f"{cells} in up to {plural(found.versions, 'version')} (other sources, libraries, output times or counting). Only "
        f"the newest row of each is reported; {found.left_out} older are left out."
    ]
