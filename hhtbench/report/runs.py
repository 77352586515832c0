"""Tables of single runs: side by side, their counters, all of them, those that failed, drift at equal accuracy."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hhtbench import analysis
from hhtbench.analysis import DOUBTED, NEAR, TYPICAL_ERROR, Point
from hhtbench.report.colours import solver_order
from hhtbench.report.tables import Cell, Table, make_table, ordered
from hhtbench.report.words import BESIDE, NOTHING, STAR, brief, compared, count, doubt, listed, seconds, shown, timed
from hhtbench.store.rows import RunRow

COUNTS = {
    "steps_accepted": "steps",
    "steps_rejected_error": "rejected by error",
    "steps_rejected_newton": "by Newton",
    "newton_iterations": "Newton iterations",
    "residual_evaluations": "evaluations",
    "output_evaluations": "for output",
    "jacobian_evaluations": "Jacobians",
    "factorisations": "factorisations",
    "linear_solves": "linear solves",
}


def side_by_side(rows: Sequence[RunRow], problem: str) -> Table:
    """One run of every solver, nearest to the typical error: errors, drift, work, slope over all its runs."""
    own = [row for row in rows if row.problem == problem]
    slopes = {curve.entry: curve.slope for curve in analysis.convergence(own)}
    chosen = typical_runs(own)
    shown_rows = [row for row in own if row.key in chosen]
    body = [[*_run_cells(row), slope_text(slopes[chosen[row.key].entry])] for row in shown_rows]
    note = (
        f"For each solver the run whose scaled error is nearest to {TYPICAL_ERROR:.0e}. Slope: error against tolerance or "
        "step over all its runs with errors up to 0.1, fitted in the logarithms, \N{PLUS-MINUS SIGN} the farthest point's "
        f"distance from the line in decades. {_run_note(shown_rows)}"
    )
    return make_table([*RUN_HEADERS, "slope"], ordered(body), note)


def slope_text(slope: analysis.Slope | None) -> str:
    """Value and spread."""
    return NOTHING if slope is None else f"{slope.value:.2f} \N{PLUS-MINUS SIGN} {slope.spread:.2f}"


def counter_table(rows: Sequence[RunRow], problem: str) -> Table:
    """What the same runs cost, counter by counter."""
    own = [row for row in rows if row.problem == problem]
    chosen = typical_runs(own)
    body: list[list[str | Cell]] = []
    sources: dict[str, list[str]] = {}
    for row, line in zip(own, analysis.counters(own), strict=True):
        if row.key in chosen:
            counts = [count(line.counts[name]) for name in COUNTS]
            times = [timed(line.point), seconds(analysis.number(row.timing, "compile_s"))]
            body.append([line.point.entry, line.point.setting.text, *counts, *times])
            sources.setdefault(line.provenance, []).append(line.point.entry)
    headers = ["solver", "setting", *COUNTS.values(), "time", "first solve"]
    note = (
        "For output: evaluations for the output rows, in no other counter. First solve: warm-up, compilation included, not "
        "part of the time; it depends on who compiled the same functions first, and on the cache on disk. A dash: not "
        f"reported, which is not zero. {_marks([chosen[row.key] for row in own if row.key in chosen])}"
    )
    origins = "; ".join(f"{', '.join(solver_order(entries))}: {source}" for source, entries in sources.items())
    return make_table(headers, ordered(body), f"{note} Where the counts come from. {origins}.")


def all_runs(rows: Sequence[RunRow], problem: str) -> Table:
    """Every run on one problem."""
    own = [row for row in rows if row.problem == problem]
    return make_table(RUN_HEADERS, ordered([_run_cells(row) for row in own]), _run_note(own))


RUN_HEADERS = (
    *("solver", "setting", "outcome", "error", "lam", "mu", "position", "max |g|", "velocity", "acceleration", "energy"),
    *("time", "steps", "evaluations"),
)


def _run_cells(row: RunRow) -> list[str | Cell]:
    (drift,), (counter,), (multiplier,) = analysis.drift([row]), analysis.counters([row]), analysis.multipliers([row])
    run = drift.point

    def bracketed(value: float | None) -> str:
        return f"({brief(value)})" if run.status == DOUBTED and value is not None else brief(value)

    return [
        run.entry,
        run.setting.text,
        Cell(run.status, "" if run.success else "bad"),
        *map(bracketed, (run.error if run.doubted is None else run.doubted, multiplier.lam, multiplier.mu)),
        *map(brief, (drift.position, run.absolute, drift.velocity, drift.acceleration, drift.energy)),
        timed(run),
        count(counter.counts["steps_accepted"]),
        count(counter.counts["residual_evaluations"]),
    ]


def _run_note(rows: Sequence[RunRow]) -> str:
    """What the columns of a table of runs mean, and what its marks say."""
    runs = analysis.points(rows)
    parts = [
        f"Error: the larger of q and v, scaled{compared(runs)}; lam, mu: scaled errors of the multipliers. Position to "
        "energy: largest drift over the whole interval, scaled by the problem's own sizes; max |g|: the position "
        "constraints as they are. A dash: not reported or not there."
    ]
    notes: dict[str, list[str]] = {}
    for line in analysis.drift(rows):
        if line.note:
            notes.setdefault(line.note, []).append(line.point.entry)
    parts += [f"No acceleration level for {listed(list(solver_order(own)))} ({note})." for note, own in notes.items()]
    if any(run.doubted is not None for run in runs):
        parts.append("In brackets: the error of a run that is not believed.")
    return " ".join([*parts, _marks(runs)]).strip()


def _marks(runs: Sequence[Point]) -> str:
    """The marks of times that occur."""
    beside = any(run.time and run.success and not run.alone for run in runs)
    found = {f"*: {STAR}": any(run.disturbed for run in runs), BESIDE: beside}
    return " ".join(f"{text}." for text, there in found.items() if there)


def typical_runs(rows: Iterable[RunRow]) -> dict[str, Point]:
    """Key of the row -> its point, for the one run of each problem and solver that is set beside the others."""
    chosen = [analysis.typical(curve.points) for curve in analysis.work_precision(rows)]
    return {run.key: run for run in chosen}


def failures_by_reason(rows: Sequence[RunRow], problem: str) -> Table:
    """The runs on one problem that failed or are not believed; messages that differ by their numbers are one reason."""
    body: list[list[str | Cell]] = []
    found = analysis.failures(row for row in rows if row.problem == problem)
    for one in sorted(found, key=lambda failure: -len(failure.rows)):
        message = doubt(one.text) if one.status == DOUBTED else one.text
        far = NOTHING if one.reached is None else f"{100 * one.reached:.3g} %"
        body.append([Cell(one.status, "bad"), str(len(one.rows)), _counted(one.rows), far, message])
    note = "Reached: the largest share of the interval."
    return make_table(["status", "runs", "solvers", "reached", "message"], body, note)


def _counted(rows: Sequence[RunRow]) -> str:
    """Solvers with their settings, or how many runs there are."""
    settings: dict[str, list[str]] = {}
    for run in analysis.points(rows):
        settings.setdefault(run.entry, []).append(run.setting.text)
    parts = {entry: own[0] if len(own) == 1 else f"{len(own)} runs" for entry, own in settings.items()}
    return "; ".join(f"{entry}, {parts[entry]}" for entry in solver_order(parts))


def equal_drift(rows: Sequence[RunRow]) -> Table:
    """For every solver the largest drift among its runs of one accuracy, and where it was."""
    total = len(analysis.problems(rows))
    found = analysis.equally_accurate(rows)
    body: list[list[str | Cell]] = []
    for entry in solver_order(found):
        runs = found[entry]
        cells: list[str | Cell] = [entry, f"{len(runs)} of {total}"]
        for level in ("position", "absolute", "velocity"):
            values = [(getattr(run, level), run) for run in runs if getattr(run, level) is not None]
            value, worst = max(values, key=lambda pair: pair[0], default=(None, None))
            where = "" if worst is None else f"{worst.problem}, {worst.setting.text}, error {shown(worst.error)}"
            cells.append(Cell(shown(value), "", where))
        body.append(cells)
    note = (
        f"At equal accuracy: on each problem the solver's run nearest to the error {TYPICAL_ERROR:.0e}, where that is "
        f"within a factor {NEAR:g} of it; a drift that is small only because a run was far more accurate is not here. "
        "Position and velocity are scaled by the problem's own sizes, max |g| is not; the maximum over time, over internal "
        "steps where a solver shows them."
    )
    headers = ["solver", "problems with such a run", "largest position drift", "largest max |g|", "largest velocity drift"]
    return make_table(headers, body, note)
