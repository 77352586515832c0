"""The comparison in words; every number is one of the rows or counted from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

from hhtbench import analysis
from hhtbench.analysis import HELD, HELD_TARGETS, NEAR, SUBJECT, TYPICAL_ERROR, Comparison, Newest, Point, family
from hhtbench.report.words import MEASURES, STAR, dearer, factor, listed, plural, shown, uncounted
from hhtbench.store.rows import RunRow


def summary(rows: Sequence[RunRow]) -> list[str]:
    """Paragraphs: what ran, where HHT wins and loses, drift, what the reader must know of the data."""
    if not rows:
        return ["The store holds no rows, so nothing is compared."]
    lines = analysis.compare(rows)
    parts = [_coverage(rows)]
    if not any(run.entry.startswith(SUBJECT) for run in analysis.points(rows)):
        parts.append("No HHT run is among the rows, so HHT is not compared.")
    else:
        parts += [_balance([line for line in lines if line.measure == measure], measure) for measure in MEASURES]
    return [part for part in [*parts, _steady(rows), _drift(rows), _caveats(rows)] if part]


def problem_summary(rows: Sequence[RunRow], problem: str) -> list[str]:
    """Sentences for one problem: wins and losses by both measures."""
    lines = [line for line in analysis.compare(rows) if line.problem == problem]
    return [_sentence([line for line in lines if line.measure == measure], measure) for measure in MEASURES]


def _coverage(rows: Sequence[RunRow]) -> str:
    good = sum(row.success for row in rows)
    failed = [f"{status} {number}" for status, number in analysis.statuses(row for row in rows if not row.success).items()]
    places = "in the table of failures and at the plots' edges, hollow where they came to an end"
    others = f"The others, {places}: {', '.join(failed)}." if failed else ""
    solvers = plural(len(analysis.entries(rows)), "solver")
    problems = plural(len(analysis.problems(rows)), "problem")
    return f"{good} of {plural(len(rows), 'run')} reached the end and are believed ({problems}, {solvers}). {others}".strip()


def _balance(lines: Sequence[Comparison], measure: str) -> str:
    """How often HHT wins and loses by one measure, the extremes, and who does not get to an error."""
    judged = [line for line in lines if line.factor is not None]
    text = f"By {MEASURES[measure]}, "
    if judged:
        tally = {name: [line for line in judged if line.outcome == name] for name in ("wins", "loses", "level")}
        numbers = [f"wins {len(tally['wins'])}", f"loses {len(tally['loses'])}"]
        numbers += [f"is level in {len(tally['level'])}"] if tally["level"] else []
        text += f"at equal achieved error the best HHT entry {listed(numbers)} of {plural(len(judged), 'comparison')}. "
        text += _extreme(tally["loses"], "loses") if tally["loses"] else "It loses none of them. "
        text += _extreme(tally["wins"], "wins") if tally["wins"] else "It wins none of them. "
    else:
        text += "nothing can be compared: HHT and another solver never reach the same error. "
    cases = {
        "absent": "HHT does not get to the error where others do",
        "untried": "HHT was not tried at the error others reach, its finest run is coarser",
        "alone": "Only HHT gets to the error",
        "unrivalled": "Only HHT was tried at the error",
    }
    for name, words in cases.items():
        places = _places([line for line in lines if line.outcome == name])
        text += f"{words}: {places}. " if places else ""
    return text.strip()


def _places(lines: Sequence[Comparison]) -> str:
    """``andrews at 1e-04 and 1e-05; knife_edge at 1e-05``."""
    targets: dict[str, dict[str, None]] = {}
    for line in lines:
        targets.setdefault(line.problem, {})[f"{line.target:.0e}"] = None
    return "; ".join(f"{problem} at {listed(list(own))}" for problem, own in targets.items())


def _extreme(lines: Sequence[Comparison], name: str) -> str:
    line = max(lines, key=dearer)
    if line.subject is None or line.rival is None:
        return ""
    where = f"on {line.problem} at error {line.target:.0e}"
    mine, other = line.subject.entry, line.rival.entry
    if name == "loses":
        text = f"It loses most {where}: {mine} needs {factor(line)} the {MEASURES[line.measure]} of {other}"
    else:
        text = f"It wins most {where}: {other} needs {factor(line)} the {MEASURES[line.measure]} of {mine}"
    return f"{text}{_drifts(line)}. "


def _drifts(line: Comparison) -> str:
    """The price or the gain in drift, both numbers."""
    if line.subject is None or line.rival is None:
        return ""
    parts = []
    for level in ("position", "velocity"):
        mine, other = getattr(line.subject.run, level), getattr(line.rival.run, level)
        if mine is not None and other is not None:
            parts.append(f"{level} {shown(other)} against HHT's {shown(mine)}")
    return f"; drift there: {', '.join(parts)}" if parts else ""


def _sentence(lines: Sequence[Comparison], measure: str) -> str:
    if not any(line.subject or line.rival for line in lines):
        reasons = {reason.text for line in lines for reason in line.missing.values()}
        return f"By {MEASURES[measure]}: nothing can be compared ({'; '.join(sorted(reasons))})."
    parts = []
    for name, verb in (("loses", "loses"), ("level", "is level"), ("wins", "wins")):
        found = [line for line in lines if line.outcome == name and line.rival is not None]
        if found:
            cases = [f"{line.target:.0e} ({factor(line)} against {line.rival.entry})" for line in found if line.rival]
            parts.append(f"{verb} at {listed(cases)}")
    for name, text in ABSENCES.items():
        found = [line for line in lines if line.outcome == name]
        if found:
            own = [line.own_missing.text for line in found if line.own_missing is not None]
            why = f" ({'; '.join(dict.fromkeys(own)).removeprefix('not tried: ')})" if own else ""
            parts.append(f"{text} {listed([f'{line.target:.0e}' for line in found])}{why}")
    return f"By {MEASURES[measure]} HHT {'; '.join(parts)}."


ABSENCES = {
    "absent": "does not get to",
    "untried": "was not tried at",
    "alone": "alone gets to",
    "unrivalled": "alone was tried at",
    "unknown": "is not compared at",
}


def _steady(rows: Sequence[RunRow]) -> str:
    """What it costs to be accurate and to hold the constraints, by both measures."""
    lines = analysis.compare(rows, targets=HELD_TARGETS, held=HELD)
    parts = []
    for measure in MEASURES:
        judged = [line for line in lines if line.measure == measure and line.factor is not None]
        if judged:
            wins, losses = (sum(line.outcome == name for line in judged) for name in ("wins", "loses"))
            best = max(judged, key=lambda line: line.factor or 0.0)
            worst = min(judged, key=lambda line: line.factor or 0.0)
            ends = [f"{line.outcome} {factor(line)} on {line.problem} at {line.target:.0e}" for line in (best, worst)]
            span = f"best: {ends[0]}; worst: {ends[1]}" if len(judged) > 1 else ends[0]
            count = f"wins {wins} and loses {losses} of {plural(len(judged), 'comparison')}"
            parts.append(f"by {MEASURES[measure]} HHT {count} against the cheapest other ({span})")
    unheld = [line for line in lines if line.outcome == "unheld"]
    if unheld:
        parts.append(f"no other run that is as accurate drifts so little on {_places(unheld)}")
    if not parts:
        return ""
    bound = f"whose position and velocity drift both stay within {HELD:.0e}"
    return f"Among runs {bound}, at errors from {HELD_TARGETS[0]:.0e} to {HELD_TARGETS[-1]:.0e}: {'; '.join(parts)}."


def _drift(rows: Sequence[RunRow]) -> str:
    """Drift among runs of one accuracy; an over-accurate run would look steady."""
    found = analysis.equally_accurate(rows)
    mine = [run for entry, runs in found.items() if family(entry) == SUBJECT for run in runs]
    others = {entry: runs for entry, runs in found.items() if family(entry) != SUBJECT}
    parts = []
    for level in ("position", "velocity"):
        own, best = _worst(mine, level), _steadiest(others, level)
        other = _worst([run for runs in others.values() for run in runs], level)
        if own is None:
            continue
        text = f"HHT's largest {level} drift is {shown(getattr(own, level))} ({own.problem})"
        if best is not None and other is not None:
            text += f"; of the others {best.entry} keeps it smallest, at most {shown(getattr(best, level))} on "
            text += f"{plural(_measured(others[best.entry], level), 'problem')}, and {other.entry} lets it grow to "
            text += f"{shown(getattr(other, level))} ({other.problem})"
        parts.append(text + ".")
    head = f"At equal accuracy, errors within a factor {NEAR:g} of {TYPICAL_ERROR:.0e}"
    return f"{head}: {' '.join(parts)}" if parts else ""


def _worst(runs: Sequence[Point], level: str) -> Point | None:
    return max((run for run in runs if getattr(run, level) is not None), key=lambda run: getattr(run, level), default=None)


def _steadiest(groups: Mapping[str, Sequence[Point]], level: str) -> Point | None:
    """The worst run of the entry whose worst run is best, among those measured on the most problems."""
    most = max((_measured(runs, level) for runs in groups.values()), default=0)
    worst = [_worst(runs, level) for runs in groups.values() if _measured(runs, level) == most]
    return min((run for run in worst if run is not None), key=lambda run: getattr(run, level), default=None)


def _measured(runs: Sequence[Point], level: str) -> int:
    return sum(getattr(run, level) is not None for run in runs)


def _caveats(rows: Sequence[RunRow]) -> str:
    runs = [run for run in analysis.points(rows) if run.success]
    parts = []
    unknown = [name for name in analysis.problems(rows) if not any(r.error is not None for r in runs if r.problem == name)]
    if unknown:
        parts.append(
            f"No error is known on {listed(unknown)} (no exact solution, reference or successful run): no costs there."
        )
    once = [name for name in analysis.problems(rows) if {r.compared for r in runs if r.problem == name} == {1}]
    if once:
        parts.append(f"On {listed(once)} errors are compared at 1 time only.")
    parts += _times(runs)
    limited = [run for run in runs if run.error is not None and run.error < run.limit]
    if limited:
        parts.append(f"{plural(len(limited), 'error')} lie below what the reference can judge and are shown as they are.")
    if silent := analysis.silent(rows):
        parts.append(uncounted(silent))
    if len(analysis.machines(rows)) > 1:
        parts.append(
            f"The rows come from {len(analysis.machines(rows))} environments; times of different ones do not compare."
        )
    return " ".join(parts)


def _times(runs: Sequence[Point]) -> list[str]:
    """How far the times can be trusted."""
    timed = [run for run in runs if run.time is not None]
    beside, disturbed = [run for run in timed if not run.alone], [run for run in timed if run.disturbed]
    shares = [run.share for run in timed if run.share is not None]
    parts = []
    if beside:
        parts.append(f"{len(beside)} of {plural(len(timed), 'time')} were taken beside other work: upper bounds.")
    if disturbed:
        parts.append(f"{len(disturbed)} of {plural(len(timed), 'time')} are marked *: {STAR}.")
    if shares:
        parts.append(f"Median CPU/wall of the timed solves: {median(shares):.2f}.")
    return parts


def older(found: Newest) -> list[str]:
    """What was left out of the store's rows."""
    if not found.left_out:
        return []
    cells = f"{plural(found.cells, 'cell')} of the store {'exists' if found.cells == 1 else 'exist'}"
    return [
        f"{cells} in up to {plural(found.versions, 'version')} (other sources, libraries, output times or counting): only "
        f"the newest row of each is reported, {found.left_out} older left out."
    ]
