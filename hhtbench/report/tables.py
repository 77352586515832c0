"""Tables of the comparison as text, for the page and for Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from hhtbench import analysis
from hhtbench.analysis import Point
from hhtbench.report.colours import solver_order
from hhtbench.report.words import MEASURES, NOTHING, count, outcome, plural, seconds, shown, work
from hhtbench.store.rows import RunRow

CHEAPEST = 3  # solvers named for each error
TONES = {"wins": "good", "alone": "good", "loses": "bad", "absent": "bad", "level": "", "unknown": ""}
SHORT = {"time": "wall time", "evaluations": "evaluations"}
DRIFT_LEVELS = ("position", "velocity", "acceleration", "energy")
COUNTS = {
    "steps_accepted": "steps",
    "steps_rejected_error": "rejected by error",
    "steps_rejected_newton": "by Newton",
    "newton_iterations": "Newton iterations",
    "residual_evaluations": "evaluations",
    "jacobian_evaluations": "Jacobians",
    "factorisations": "factorisations",
    "linear_solves": "linear solves",
}


class Cell(NamedTuple):
    """Text of one cell; where it is a verdict its colour, good or bad; a second line in small print."""

    text: str
    tone: str = ""
    detail: str = ""


@dataclass(frozen=True, kw_only=True)
class Table:
    """Headers and rows of text."""

    headers: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


def make_table(headers: Sequence[str], rows: Iterable[Sequence[str | Cell]], note: str = "") -> Table:
    """A table of strings and cells."""
    cells = tuple(tuple(cell if isinstance(cell, Cell) else Cell(cell) for cell in row) for row in rows)
    return Table(headers=tuple(headers), rows=cells, note=note)


def against(rows: Sequence[RunRow]) -> Table:
    """HHT against the cheapest other solver: one line for each problem and measure, one column for each error."""
    lines = analysis.compare(rows)
    groups: dict[tuple[str, str], list[analysis.Comparison]] = {}
    for line in lines:
        groups.setdefault((line.problem, line.measure), []).append(line)
    body: list[list[str | Cell]] = [
        [problem, SHORT[measure], *(_verdict(line, rival=True) for line in group)]
        for (problem, measure), group in groups.items()
    ]
    headers = ["problem", "by", *(f"error {target:.0e}" for target in analysis.TARGETS)]
    note = (
        "The best HHT entry against the cheapest of all other solvers at the same achieved error; a dash: nobody gets there."
    )
    return make_table(headers, body, note)


def _verdict(line: analysis.Comparison, rival: bool = False) -> Cell:
    detail = f"against {line.rival.entry}" if rival and line.rival is not None and line.factor is not None else ""
    return Cell(outcome(line), TONES[line.outcome], detail)


def price_of_drift(rows: Sequence[RunRow], problem: str) -> Table:
    """Both sides of every comparison on one problem, with their costs and drifts."""
    body: list[list[str | Cell]] = []
    for line in analysis.compare(rows):
        if line.problem == problem and (line.subject or line.rival):
            cells: list[str | Cell] = []
            for side in (line.subject, line.rival):
                cost = (
                    NOTHING
                    if side is None
                    else ("\N{LESS-THAN OR EQUAL TO} " if side.bound else "") + work(side.value, line.measure)
                )
                drifts = [NOTHING] * 2 if side is None else [shown(side.run.position), shown(side.run.velocity)]
                cells += [NOTHING if side is None else side.entry, cost, *drifts]
            body.append([f"{line.target:.0e}", SHORT[line.measure], _verdict(line), *cells])
    headers = ["error", "by", "HHT", "best HHT", "its cost", "position drift", "velocity drift"]
    headers += ["cheapest other", "its cost", "position drift", "velocity drift"]
    note = (
        "Costs are interpolated in the logarithms between two runs; \N{LESS-THAN OR EQUAL TO}: the loosest run is "
        "already more accurate. "
        "Drifts are those of the run at the accurate end."
    )
    return make_table(headers, body, note)


def cheapest(rows: Sequence[RunRow], problem: str) -> Table:
    """Who reaches each error most cheaply."""
    fronts = {
        measure: [front for front in analysis.fronts(rows, measure) if front.problem == problem] for measure in MEASURES
    }
    body = []
    for measure, found in fronts.items():
        for front in found:
            best = [f"{cost.entry} {work(cost.value, measure)}" for cost in front.costs[:CHEAPEST]]
            reasons = set(front.missing.values())
            missing = plural(len(front.missing), "solver") if front.missing else NOTHING
            if not front.costs and len(reasons) == 1:
                missing += f": {reasons.pop()}"
            body.append([f"{front.target:.0e}", SHORT[measure], *best, *[NOTHING] * (CHEAPEST - len(best)), missing])
    headers = ["error", "by", "cheapest", "second", "third", "do not get there"]
    return make_table(headers, body)


def side_by_side(rows: Sequence[RunRow], problem: str) -> Table:
    """One run of every solver, nearest to the typical error: errors, drift, work, slope over all its runs."""
    own = [row for row in rows if row.problem == problem]
    slopes = {curve.entry: curve.slope for curve in analysis.convergence(own)}
    chosen = typical_runs(own)
    body = []
    for row in own:
        if row.key in chosen:
            slope = slopes[chosen[row.key].entry]
            body.append([*_run_cells(row), NOTHING if slope is None else f"{slope.value:.2f}"])
    note = (
        "For each solver the run whose scaled error (the larger of q and v, largest over the compared times) is nearest to "
        "1e-04. lam, mu: scaled errors of multipliers. position to energy: largest drift. Slope: error against tolerance "
        "or step over all its runs, fitted in the logarithms. A dash: not reported or not there."
    )
    return make_table([*RUN_HEADERS, "slope"], _ordered(body), note)


def counter_table(rows: Sequence[RunRow], problem: str) -> Table:
    """What the same runs cost, counter by counter."""
    own = [row for row in rows if row.problem == problem]
    chosen = typical_runs(own)
    body: list[list[str | Cell]] = []
    for row, line in zip(own, analysis.counters(own), strict=True):
        if row.key in chosen:
            counts = [count(line.counts[name]) for name in COUNTS]
            times = [_time(line.point), seconds(analysis.number(row.timing, "compile_s"))]
            body.append([line.point.entry, line.point.setting.text, *counts, *times, line.provenance])
    headers = ["solver", "setting", *COUNTS.values(), "time", "first solve", "source"]
    note = "First solve: warm-up, compilation included; it is not part of the time. A dash: not reported, which is not zero."
    return make_table(headers, _ordered(body), note)


def all_runs(rows: Sequence[RunRow], problem: str) -> Table:
    """Every run on one problem."""
    return make_table(RUN_HEADERS, _ordered([_run_cells(row) for row in rows if row.problem == problem]))


RUN_HEADERS = ("solver", "setting", "outcome", "error", "lam", "mu", *DRIFT_LEVELS, "time", "steps", "evaluations")


def _run_cells(row: RunRow) -> list[str | Cell]:
    (drift,), (counter,), (multiplier,) = analysis.drift([row]), analysis.counters([row]), analysis.multipliers([row])
    run = drift.point
    return [
        run.entry,
        run.setting.text,
        Cell(run.status, "" if run.success else "bad"),
        shown(run.error),
        shown(multiplier.lam),
        shown(multiplier.mu),
        *(shown(getattr(drift, level)) for level in DRIFT_LEVELS),
        _time(run),
        count(counter.counts["steps_accepted"]),
        count(counter.counts["residual_evaluations"]),
    ]


def _time(run: Point) -> str:
    return seconds(run.time) + ("" if run.alone or run.time is None or not run.success else "*")


def typical_runs(rows: Iterable[RunRow]) -> dict[str, Point]:
    """Key of the row -> its point, for the one run of each problem and solver that is set beside the others."""
    chosen = [analysis.typical(curve.points) for curve in analysis.work_precision(rows)]
    return {run.key: run for run in chosen}


def failure_table(rows: Sequence[RunRow]) -> Table:
    """Every run that did not reach the end, with its reason."""
    body: list[list[str | Cell]] = [
        [line.problem, line.entry, Cell(line.status, "bad"), ", ".join(line.settings), _share(line.reached), line.message]
        for line in analysis.failures(rows)
    ]
    order = {entry: index for index, entry in enumerate(solver_order(str(line[1]) for line in body))}
    places = {problem: index for index, problem in enumerate(analysis.problems(rows))}
    body.sort(key=lambda line: (places[str(line[0])], order[str(line[1])]))
    return make_table(["problem", "solver", "status", "settings", "reached", "message"], body)


def largest_drift(rows: Sequence[RunRow]) -> Table:
    """For every solver the largest drift of all its successful runs, and where it was."""
    runs: dict[str, list[Point]] = analysis.by_entry(analysis.points(rows))
    body: list[list[str | Cell]] = []
    for entry in solver_order(runs):
        good = [run for run in runs[entry] if run.success]
        cells: list[str | Cell] = [entry, f"{len(good)} of {len(runs[entry])}"]
        for level in ("position", "velocity"):
            values = [(getattr(run, level), run) for run in good if getattr(run, level) is not None]
            value, worst = max(values, key=lambda pair: pair[0], default=(None, None))
            cells += [shown(value), NOTHING if worst is None else f"{worst.problem}, {worst.setting.text}"]
        body.append(cells)
    note = (
        "Drift is scaled by the problem's own sizes; the maximum over time, over internal steps where a solver shows them."
    )
    return make_table(["solver", "reached the end", "position drift", "at", "velocity drift", "at"], body, note)


def environments(rows: Sequence[RunRow]) -> list[Mapping[str, object]]:
    """Machine and versions: one mapping for each environment that the rows came from."""
    found = analysis.machines(rows)
    extra = len(found) > 1
    return [{**({"rows": entry.rows} if extra else {}), **entry.environment} for entry in found]


def _ordered(body: list[list[str | Cell]]) -> list[list[str | Cell]]:
    order = {entry: index for index, entry in enumerate(solver_order(str(line[0]) for line in body))}
    return sorted(body, key=lambda line: order[str(line[0])])


def _share(reached: float | None) -> str:
    return NOTHING if reached is None else f"{100 * reached:.3g} %"
