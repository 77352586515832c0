"""From the tables of the analysis to the charts of one problem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.accuracy import COARSE
from hhtbench.campaign.analysis.cells import SUBJECT, Point, entry_of, family, number
from hhtbench.campaign.analysis.fronts import pareto
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.frame import Chart
from hhtbench.report.marks import curves_of
from hhtbench.report.runs import slope_text
from hhtbench.report.series import LEAST_DRIFT, MULTIPLIERS, charts_over_time
from hhtbench.report.words import STAR, compared, listed, plural, short, uncounted, weighed

AXES = {"rtol": "relative tolerance", "step": "step [s]", "steps": "step / length of the interval"}
VIEWS = {"rtol": "tolerance", "step": "step", "steps": "number of steps"}
WORK = {"time": "processor time [s]", "evaluations": "residual evaluations"}
STATE_ERROR = "scaled error of q, v"
PRECISION, CONVERGENCE = "Work and precision", "Convergence"  # titles of figures


def problem_charts(own: Sequence[RunRow]) -> list[Chart]:
    """All charts of one problem that have something to show, those of a group one after the other."""
    curves = [
        *(_against_work(own, measure) for measure in WORK),
        _against_drift(own),
        *(_convergence(own, kind) for kind in AXES),
        *charts_over_time(own),
        *(_multipliers(own, name) for name in ("lam", "mu")),
    ]
    front = _front(analysis.points(own))
    return [replace(chart, front=front) for chart in curves if chart is not None and _shows_something(chart)]


def _front(runs: Sequence[Point]) -> frozenset[str]:
    """HHT, and who has a run that no other beats in both error and work."""
    best = {run.entry for measure in WORK for run in pareto(runs, measure)}
    return frozenset(best | {run.entry for run in runs if family(run.entry) == SUBJECT})


def _shows_something(chart: Chart) -> bool:
    return any(y for trace in chart.traces for y in trace.y) or any(mark.inside for mark in chart.marks)


def _against_work(rows: Sequence[RunRow], measure: str) -> Chart | None:
    runs = analysis.points(rows)
    note = _disturbances(runs) if measure == "time" else f" {weighed(runs)} {uncounted(analysis.silent(rows))}".rstrip()
    return Chart(
        id=f"work-{measure}",
        group=PRECISION,
        view=measure,
        title=f"Error against {WORK[measure].partition(' [')[0]}",
        caption=f"Left and low is better: small error{compared(runs)}, for little work.{note}",
        x_label=WORK[measure],
        y_label=STATE_ERROR,
        **curves_of(runs, lambda run: run.work(measure), _error),
        limit=_limit(runs),
    )


def _against_drift(rows: Sequence[RunRow]) -> Chart | None:
    """The larger of both levels' drift; zero has no place on a logarithmic axis and is drawn at the least."""
    runs = [run for run in analysis.points(rows) if run.success and _drift(run) is not None]
    if not runs:
        return None
    return Chart(
        id="drift",
        group=PRECISION,
        view="drift",
        title="Error against drift",
        caption="Left and low is better: small error with small violation of the constraints.",
        x_label="largest scaled drift of position and velocity constraints",
        y_label=STATE_ERROR,
        **curves_of(runs, _drift, _error),
        limit=_limit(runs),
    )


def _drift(run: Point) -> float | None:
    return None if run.drift is None else max(run.drift, LEAST_DRIFT)


def _error(run: Point) -> float | None:
    return run.error if run.doubted is None else run.doubted


def _limit(runs: Sequence[Point]) -> float:
    """Errors below it cannot be judged."""
    return max((run.limit for run in runs), default=0.0)


def _disturbances(runs: Sequence[Point]) -> str:
    """How many of the times are not clean."""
    timed = [run for run in runs if run.success and run.time is not None]
    beside, disturbed = (sum(test) for test in ((not run.alone for run in timed), (run.disturbed for run in timed)))
    text = f" {plural(beside, 'time')} taken beside other work." if beside else ""
    return text + (f" {disturbed} of {plural(len(timed), 'time')} disturbed ({STAR})." if disturbed else "")


def _convergence(rows: Sequence[RunRow], kind: str) -> Chart | None:
    curves = [curve for curve in analysis.convergence(rows) if curve.kind == kind]
    if not curves:
        return None
    runs = [run for curve in curves for run in curve.points]
    known = sorted((curve.slope.value, curve.entry, slope_text(curve.slope)) for curve in curves if curve.slope is not None)
    ends = [f"{text} ({entry})" for _, entry, text in dict.fromkeys((known[0], known[-1]))] if known else []
    text = f"Fitted slopes, errors up to {COARSE:g}, with the spread: {' to '.join(ends)}." if ends else ""
    missing = [curve.entry for curve in curves if curve.slope is None and any(run.success for run in curve.points)]
    text += f" Too few runs for a slope: {listed(missing)}." if missing else ""
    what = "tolerance" if kind == "rtol" else "step"
    return Chart(
        id=f"convergence-{kind}",
        group=CONVERGENCE,
        view=VIEWS[kind],
        title=f"Error against {what}",
        caption=f"The error that a {what} leads to. {text}",
        x_label=AXES[kind],
        y_label=STATE_ERROR,
        **curves_of(runs, lambda run: run.setting.value, _error),
        limit=_limit(runs),
    )


def _left_out(rows: Sequence[RunRow], name: str) -> str:
    """Whose rows are left out because their multipliers are nan, and how many at most."""
    most: dict[str, tuple[float, float]] = {}
    for row in rows:
        unknown, compared_at = (number(row.metrics, "errors", *path) for path in ((name, "unknown"), ("points",)))
        if unknown:
            entry = entry_of(row)
            most[entry] = max(most.get(entry, (0.0, 0.0)), (unknown, compared_at or 0.0))
    if not most:
        return ""
    named = listed([f"{short(entry)} ({count:.0f} of {of:.0f})" for entry, (count, of) in most.items()])
    return f" Rows where they do not exist, or are not known, are left out, at most: {named}."


def _multipliers(rows: Sequence[RunRow], name: str) -> Chart | None:
    runs = analysis.points(rows)
    if not any(getattr(run, name) for run in runs):
        return None
    symbol = {"lam": "λ (position constraints)", "mu": "μ (velocity constraints)"}[name]
    return Chart(
        id=f"multipliers-{name}",
        group=MULTIPLIERS,
        view=f"error of {symbol.partition(' ')[0]}",
        title=f"Error of the multipliers {symbol}",
        caption=f"Multipliers recovered from the acceleration level, against processor time.{_left_out(rows, name)}",
        x_label=WORK["time"],
        y_label=f"scaled error of {symbol.partition(' ')[0]}",
        **curves_of(runs, lambda run: run.time, lambda run: getattr(run, name)),
    )
