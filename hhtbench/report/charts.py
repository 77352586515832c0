"""From the tables of the analysis to the charts of one problem."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from hhtbench import analysis
from hhtbench.analysis import Point
from hhtbench.report.chart import Chart, EdgeMark, Trace
from hhtbench.report.tables import typical_runs
from hhtbench.report.words import listed, plural, seconds, shown
from hhtbench.store.rows import RunRow

LEAST_DRIFT = 1e-18  # zero has no place on a logarithmic axis and is drawn here
MOST_POINTS = 120  # of a series over time
AXES = {"rtol": "relative tolerance", "step": "step [s]", "steps": "step / length of the interval"}
WORK = {"time": "wall time [s]", "evaluations": "residual evaluations"}
STATE_ERROR = "scaled error of q, v"
Value = Callable[[Point], float | None]


def problem_charts(rows: Sequence[RunRow], problem: str) -> list[Chart]:
    """All charts of one problem that have something to show."""
    own = [row for row in rows if row.problem == problem]
    curves = [
        *(_against_work(own, measure) for measure in WORK),
        *(_convergence(own, kind) for kind in AXES),
        *(_drift(own, level) for level in ("position", "velocity", "energy")),
        *(_multipliers(own, name) for name in ("lam", "mu")),
    ]
    return [chart for chart in curves if chart is not None and any(y for trace in chart.traces for y in trace.y)]


def _against_work(rows: Sequence[RunRow], measure: str) -> Chart | None:
    runs = analysis.points(rows)
    traces, marks = _curves(runs, lambda run: run.work(measure), lambda run: run.error)
    beside = sum(run.success and run.time is not None and not run.alone for run in runs)
    remark = f" {plural(beside, 'time')} taken beside other work." if measure == "time" and beside else ""
    return Chart(
        id=f"work-{measure}",
        title=f"Error against {WORK[measure].partition(' [')[0]}",
        caption="Left and low is better: small error for little work." + remark + _edge(marks),
        x_label=WORK[measure],
        y_label=STATE_ERROR,
        traces=traces,
        marks=marks,
        limit=max((run.limit for run in runs), default=0.0),
    )


def _convergence(rows: Sequence[RunRow], kind: str) -> Chart | None:
    curves = [curve for curve in analysis.convergence(rows) if curve.kind == kind]
    if not curves:
        return None
    runs = [run for curve in curves for run in curve.points]
    traces, marks = _curves(runs, lambda run: run.setting.value, lambda run: run.error)
    slopes = [(curve.entry, curve.slope) for curve in curves]
    known = sorted((slope.value, entry) for entry, slope in slopes if slope is not None)
    ends = [f"{value:.2f} ({entry})" for value, entry in dict.fromkeys((known[0], known[-1]))] if known else []
    text = f"Fitted slopes: {' to '.join(ends)}." if ends else ""
    missing = [curve.entry for curve in curves if curve.slope is None and any(run.success for run in curve.points)]
    text += f" Too few runs for a slope: {listed(missing)}." if missing else ""
    what = "tolerance" if kind == "rtol" else "step"
    return Chart(
        id=f"convergence-{kind}",
        title=f"Error against {what}",
        caption=f"What a {what} buys. {text}{_edge(marks)}",
        x_label=AXES[kind],
        y_label=STATE_ERROR,
        traces=traces,
        marks=marks,
        limit=max((run.limit for run in runs), default=0.0),
    )


def _multipliers(rows: Sequence[RunRow], name: str) -> Chart | None:
    found = {item.point.key: getattr(item, name) for item in analysis.multipliers(rows)}
    if not any(found.values()):
        return None
    runs = analysis.points(rows)
    traces, marks = _curves(runs, lambda run: run.time, lambda run: found[run.key])
    symbol = {"lam": "λ (position constraints)", "mu": "μ (velocity constraints)"}[name]
    return Chart(
        id=f"multipliers-{name}",
        title=f"Error of the multipliers {symbol}",
        caption="Multipliers recovered from the acceleration level, against wall time." + _edge(marks),
        x_label=WORK["time"],
        y_label=f"scaled error of {symbol.partition(' ')[0]}",
        traces=traces,
        marks=marks,
    )


def _drift(rows: Sequence[RunRow], level: str) -> Chart | None:
    chosen = typical_runs(rows)
    traces, marks = [], []
    for series in analysis.drift_series(rows, level):
        run = series.point
        if run.key in chosen:
            t, value = _thinned(series.t, series.value)
            traces.append(Trace(entry=run.entry, x=t, y=value, note=_described(run)))
            if not run.success:
                marks.append(_mark(run, series.t[-1], None))
    named = {trace.entry for trace in traces}
    absent = [run for run in chosen.values() if run.entry not in named]
    last = max((trace.x[-1] for trace in traces), default=None)
    without = "" if not absent else f" No series: {listed([f'{run.entry} ({run.status})' for run in absent])}."
    zero = any(value <= LEAST_DRIFT for trace in traces for value in trace.y if value is not None)
    floor = f" Zero is drawn at {LEAST_DRIFT:.0e}." if zero else ""
    title = "Change of energy over time" if level == "energy" else f"Drift of the {level} constraints over time"
    return (
        None
        if last is None
        else Chart(
            id=f"drift-{level}",
            title=title,
            caption=f"Each solver's run with an error nearest to 1e-04{_spread(chosen)}.{without}{floor}",
            x_label="time [s]",
            y_label="scaled change of energy" if level == "energy" else f"scaled {level} drift",
            traces=tuple(traces),
            marks=tuple(marks),
            logarithmic_x=False,
        )
    )


def _spread(chosen: Mapping[str, Point]) -> str:
    """How far from equal accuracy the runs are that stand side by side."""
    errors = [run.error for run in chosen.values() if run.error is not None]
    return f" (they are from {min(errors):.1e} to {max(errors):.1e})" if errors else ", or a middle setting as none is known"


def _curves(runs: Iterable[Point], x: Value, y: Value) -> tuple[tuple[Trace, ...], tuple[EdgeMark, ...]]:
    """A trace for each solver; a run without a place inside becomes a mark, runs that left no result one together."""
    traces, marks = [], []
    for entry, group in analysis.by_entry(runs).items():
        inside = [(run, x(run), y(run)) for run in group]
        good = [(run, a, b) for run, a, b in inside if run.success and a and b]
        if good:
            texts = tuple(_described(run) for run, _, _ in good)
            xs, ys = tuple(a for _, a, _ in good if a), tuple(b for _, _, b in good if b)
            traces.append(Trace(entry=entry, x=xs, y=ys, text=texts))
        never: dict[str, list[Point]] = {}
        for run, a, b in inside:
            if run.success and a and b:
                continue
            if b is None and (not a or (run.time is None and not run.success)):
                never.setdefault(run.status, []).append(run)
            else:
                marks.append(_mark(run, a or None, b if run.success else None))
        marks += [_together(entry, status, lost) for status, lost in never.items()]
    return tuple(traces), tuple(marks)


def _together(entry: str, status: str, lost: Sequence[Point]) -> EdgeMark:
    settings = ", ".join(run.setting.text for run in lost)
    return EdgeMark(entry=entry, status=status, text=f"{settings}<br>{_wrapped(lost[0].message)}")


def _mark(run: Point, x: float | None, y: float | None) -> EdgeMark:
    reason = "no error is known" if run.success and y is None else _wrapped(run.message)
    spent = f"<br>after {seconds(run.time)}" if run.time is not None and not run.success else ""
    return EdgeMark(entry=run.entry, status=run.status, text=f"{run.setting.text}{spent}<br>{reason}", x=x, y=y)


def _described(run: Point) -> str:
    lines = [
        run.setting.text,
        f"error {shown(run.error)}",
        f"{seconds(run.time)}{'' if run.alone else ' (beside other work)'}, {shown(run.evaluations)} evaluations",
        f"drift: position {shown(run.position)}, velocity {shown(run.velocity)}",
    ]
    return "<br>".join(lines)


def _edge(marks: Sequence[EdgeMark]) -> str:
    """The marks in words: a page on paper has no pointer."""
    if not marks:
        return ""
    statuses: dict[str, list[str]] = {}
    for mark in marks:
        own = statuses.setdefault("not measured" if mark.status in ("success", "event") else mark.status, [])
        if mark.entry not in own:
            own.append(mark.entry)
    return " At the edge: " + "; ".join(f"{status}: {', '.join(entries)}" for status, entries in statuses.items()) + "."


def _wrapped(message: str, width: int = 60) -> str:
    """Short lines for a pointer's label, which does not wrap by itself; signs of HTML are harmless."""
    lines = [""]
    for word in message.replace("<", "&lt;").split():
        if lines[-1] and len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] += f" {word}" if lines[-1] else word
    return "<br>".join(lines)


def _thinned(t: Sequence[float], value: Sequence[float | None]) -> tuple[tuple[float, ...], tuple[float | None, ...]]:
    """At most ``MOST_POINTS``, the largest of each stretch; zero at the least drift that is drawn."""
    stretch = -(-len(t) // MOST_POINTS)
    kept = []
    for start in range(0, len(t), stretch):
        part = range(start, min(start + stretch, len(t)))
        kept.append(max(part, key=lambda index: value[index] if value[index] is not None else -1.0))  # type: ignore[arg-type,return-value]
    values = (value[index] for index in kept)
    return tuple(t[i] for i in kept), tuple(None if v is None else max(v, LEAST_DRIFT) for v in values)
