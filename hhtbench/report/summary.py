"""The comparison in words; every number is one of the rows or counted from them."""

from __future__ import annotations

from collections.abc import Sequence

from hhtbench import analysis
from hhtbench.analysis import SUBJECT, Comparison, Point
from hhtbench.report.words import MEASURES, dearer, factor, listed, plural, shown
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
    return [part for part in [*parts, _drift(rows), _caveats(rows)] if part]


def problem_summary(rows: Sequence[RunRow], problem: str) -> list[str]:
    """Sentences for one problem: wins and losses by both measures."""
    lines = [line for line in analysis.compare(rows) if line.problem == problem]
    return [_sentence([line for line in lines if line.measure == measure], measure) for measure in MEASURES]


def _coverage(rows: Sequence[RunRow]) -> str:
    good = sum(row.success for row in rows)
    failed = [f"{status} {number}" for status, number in analysis.statuses(row for row in rows if not row.success).items()]
    others = (
        f"The others, which stand at the plots' edges and in the table of failures: {', '.join(failed)}." if failed else ""
    )
    solvers = plural(len(analysis.entries(rows)), "solver")
    problems = plural(len(analysis.problems(rows)), "problem")
    return f"{good} of {plural(len(rows), 'run')} reached the end ({problems}, {solvers}). {others}".strip()


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
    cases = {"absent": "HHT does not get to the error at all where others do", "alone": "Only HHT gets to the error"}
    for name, words in cases.items():
        places = _places([line for line in lines if line.outcome == name])
        text += f"{words}: {places}. " if places else ""
    return text.strip()


def _places(lines: Sequence[Comparison]) -> str:
    """``andrews at 1e-04 and 1e-05; knife_edge at 1e-05``."""
    targets: dict[str, list[str]] = {}
    for line in lines:
        targets.setdefault(line.problem, []).append(f"{line.target:.0e}")
    return "; ".join(f"{problem} at {listed(own)}" for problem, own in targets.items())


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
        reasons = {reason for line in lines for reason in line.missing.values()}
        return f"By {MEASURES[measure]}: nothing can be compared ({'; '.join(sorted(reasons))})."
    parts = []
    for name, verb in (("loses", "loses"), ("level", "is level"), ("wins", "wins")):
        found = [line for line in lines if line.outcome == name and line.rival is not None]
        if found:
            cases = [f"{line.target:.0e} ({factor(line)} against {line.rival.entry})" for line in found if line.rival]
            parts.append(f"{verb} at {listed(cases)}")
    for name, text in (("absent", "does not get to"), ("alone", "alone gets to"), ("unknown", "is not compared at")):
        found = [line for line in lines if line.outcome == name]
        if found:
            parts.append(f"{text} {listed([f'{line.target:.0e}' for line in found])}")
    return f"By {MEASURES[measure]} HHT {'; '.join(parts)}."


def _drift(rows: Sequence[RunRow]) -> str:
    good = [run for run in analysis.points(rows) if run.success]
    parts = []
    for level in ("position", "velocity"):
        mine = _worst([run for run in good if analysis.family(run.entry) == SUBJECT], level)
        best = _steadiest([run for run in good if analysis.family(run.entry) != SUBJECT], level)
        other = _worst([run for run in good if analysis.family(run.entry) != SUBJECT], level)
        if mine is None:
            continue
        text = f"HHT's largest {level} drift over all its successful runs is {shown(getattr(mine, level))} ({mine.problem})"
        if best is not None and other is not None:
            text += f"; of the others {best.entry} keeps it smallest, at most {shown(getattr(best, level))}, "
            text += f"and {other.entry} lets it grow to {shown(getattr(other, level))}"
        parts.append(text + ".")
    return " ".join(parts)


def _worst(runs: Sequence[Point], level: str) -> Point | None:
    return max((run for run in runs if getattr(run, level) is not None), key=lambda run: getattr(run, level), default=None)


def _steadiest(runs: Sequence[Point], level: str) -> Point | None:
    """The worst run of the entry whose worst run is best."""
    worst = [_worst(group, level) for group in analysis.by_entry(runs).values()]
    return min((run for run in worst if run is not None), key=lambda run: getattr(run, level), default=None)


def _caveats(rows: Sequence[RunRow]) -> str:
    runs = [run for run in analysis.points(rows) if run.success]
    parts = []
    unknown = [name for name in analysis.problems(rows) if not any(r.error is not None for r in runs if r.problem == name)]
    if unknown:
        parts.append(
            f"No error is known on {listed(unknown)} (no exact solution, reference or successful run): no costs there."
        )
    beside = [run for run in runs if run.time is not None and not run.alone]
    if beside:
        parts.append(f"{len(beside)} of {plural(len(runs), 'time')} were taken beside other work (marked *): upper bounds.")
    limited = [run for run in runs if run.error is not None and run.error < run.limit]
    if limited:
        parts.append(f"{plural(len(limited), 'error')} lie below what the reference can judge and are shown as they are.")
    hidden = sorted({run.entry for run in runs if run.evaluations is None})
    if hidden:
        parts.append(f"Evaluations are not reported by {listed(hidden)}.")
    if len(analysis.machines(rows)) > 1:
        parts.append(
            f"The rows come from {len(analysis.machines(rows))} environments; times of different ones do not compare."
        )
    return " ".join(parts)
