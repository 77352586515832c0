"""Tables of single runs: side by side, their counters, all of them, those that failed, drift at equal accuracy."""

from __future__ import annotations

from collections.abc import Sequence

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.accuracy import Slope
from hhtbench.campaign.analysis.cells import DOUBTED, TYPICAL_ERROR, Point, by_entry, typical
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.colours import solver_order
from hhtbench.report.tables import Cell, Table, make_table, ordered
from hhtbench.report.words import BESIDE, NOTHING, STAR, brief, compared, count, doubt, listed, seconds, timed

COUNTS = {
    "steps_rejected_error": "rejected by error",
    "steps_rejected_newton": "by Newton",
    "newton_iterations": "Newton iterations",
    "output_evaluations": "for output",
    "jacobian_evaluations": "Jacobians",
    "factorisations": "factorisations",
    "linear_solves": "linear solves",
}


def one_run_each(rows: Sequence[RunRow]) -> Table:
    """One run of every solver, nearest to the typical error: errors, drift, work, counters, slope over all its runs."""
    slopes = {curve.entry: curve.slope for curve in analysis.convergence(rows)}
    chosen = typical_runs(rows)
    body: list[list[str | Cell]] = []
    sources: dict[str, list[str]] = {}
    for run in chosen:
        counts = [count(run.counts.get(name)) for name in COUNTS]
        body.append([*_run_cells(run), slope_text(slopes[run.entry]), *counts, seconds(run.first)])
        sources.setdefault(run.provenance, []).append(run.entry)
    origins = "; ".join(f"{', '.join(solver_order(entries))}: {source}" for source, entries in sources.items())
    note = (
        f"Each solver's run with a scaled error nearest to {TYPICAL_ERROR:.0e}. Slope: of log error against log tolerance "
        "or step over its runs with errors up to 0.1, \N{PLUS-MINUS SIGN} the largest distance of a point from the line in "
        "decades. For output: evaluations for the output rows, in no other counter. First solve: with compilation, not part "
        f"of the time. {_run_note(chosen)} Source of the counts. {origins}."
    )
    return make_table([*RUN_HEADERS, "slope", *COUNTS.values(), "first solve"], ordered(body), note)


def slope_text(slope: Slope | None) -> str:
    """Value and spread."""
    return NOTHING if slope is None else f"{slope.value:.2f} \N{PLUS-MINUS SIGN} {slope.spread:.2f}"


def all_runs(rows: Sequence[RunRow]) -> Table:
    """Every run."""
    runs = analysis.points(rows)
    return make_table(RUN_HEADERS, ordered([_run_cells(run) for run in runs]), _run_note(runs))


RUN_HEADERS = (
    *("solver", "setting", "outcome", "error", "lam", "mu", "position", "max |g|", "velocity", "acceleration", "energy"),
    *("time", "steps", "evaluations"),
)


def _run_cells(run: Point) -> list[str | Cell]:
    def bracketed(value: float | None) -> str:
        return f"({brief(value)})" if run.status == DOUBTED and value is not None else brief(value)

    return [
        run.entry,
        run.setting.text,
        Cell(run.status, "" if run.success else "bad"),
        *map(bracketed, (run.error if run.doubted is None else run.doubted, run.lam, run.mu)),
        *map(brief, (run.position, run.absolute, run.velocity, run.acceleration, run.energy)),
        timed(run),
        count(run.counts.get("steps_accepted")),
        count(run.counts.get("residual_evaluations")),
    ]


def _run_note(runs: Sequence[Point]) -> str:
    """What the columns of a table of runs mean, and what its marks say."""
    parts = [
        f"Error: the larger of q and v, scaled{compared(runs)}; lam, mu: scaled errors of the multipliers. Position to "
        "energy: largest drift over the whole interval, scaled by the problem's own sizes; max |g| is not scaled. A dash: "
        "not reported or not part of the problem."
    ]
    notes: dict[str, list[str]] = {}
    for run in runs:
        if run.note:
            notes.setdefault(run.note, []).append(run.entry)
    parts += [f"No acceleration level for {listed(list(solver_order(own)))} ({note})." for note, own in notes.items()]
    if any(run.doubted is not None for run in runs):
        parts.append("In brackets: errors of a run whose result was rejected.")
    return " ".join([*parts, _marks(runs)]).strip()


def _marks(runs: Sequence[Point]) -> str:
    """The marks of times that occur."""
    beside = any(run.time and run.success and not run.alone for run in runs)
    found = {f"*: {STAR}": any(run.disturbed for run in runs), BESIDE: beside}
    return " ".join(f"{text}." for text, there in found.items() if there)


def typical_runs(rows: Sequence[RunRow]) -> list[Point]:
    """On one problem the one run of each solver that is set beside the others', in the order of the rows."""
    runs = analysis.points(rows)
    keys = {typical(own).key for own in by_entry(runs).values()}
    return [run for run in runs if run.key in keys]


def failures_by_reason(rows: Sequence[RunRow]) -> Table:
    """The runs on one problem that failed or were rejected; messages that differ by their numbers are one reason."""
    body: list[list[str | Cell]] = []
    found = analysis.failures(rows)
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
