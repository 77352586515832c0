"""From runs to curves and marks: every run is a point or a mark, and its words are the same on every chart."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any

from hhtbench.campaign.analysis.cells import DOUBTED, Point, by_entry
from hhtbench.report.frame import EdgeMark, Trace
from hhtbench.report.words import brief, doubt, seconds, shown

Value = Callable[[Point], float | None]


def curves_of(runs: Iterable[Point], x: Value, y: Value) -> dict[str, Any]:
    """``traces`` and ``marks`` of a chart: a trace for each solver; any other run is a mark, or one of several in one."""
    traces, marks = [], []
    for entry, group in by_entry(runs).items():
        inside = [(run, x(run), y(run)) for run in group]
        good = [(run, a, b) for run, a, b in inside if run.success and a and b]
        if good:
            texts = tuple(described(run) for run, _, _ in good)
            xs, ys = tuple(a for _, a, _ in good if a), tuple(b for _, _, b in good if b)
            traces.append(Trace(entry=entry, x=xs, y=ys, text=texts))
        never: dict[str, list[Point]] = {}
        for run, a, b in inside:
            if run.success and a and b:
                continue
            if b is None and (not a or (run.time is None and not run.success)):
                never.setdefault(run.status, []).append(run)
            else:
                marks.append(mark_of(run, a or None, b if run.success or run.status == DOUBTED else None))
        marks += [_together(entry, status, lost) for status, lost in never.items()]
    return {"traces": tuple(traces), "marks": tuple(marks)}


def _together(entry: str, status: str, lost: Sequence[Point]) -> EdgeMark:
    settings = ", ".join(run.setting.text for run in lost)
    return EdgeMark(entry=entry, status=status, text=f"{settings}<br>{_reason(lost[0])}")


def mark_of(run: Point, x: float | None, y: float | None) -> EdgeMark:
    """The mark of a run that is no point of a curve."""
    known = run.success or run.doubted is not None
    spent = f"<br>after {seconds(run.time)}" if run.time is not None and not known else ""
    head = described(run) if known else f"{run.setting.text}{spent}"
    return EdgeMark(entry=run.entry, status=run.status, text=f"{head}<br>{_reason(run, y)}", x=x, y=y)


def _reason(run: Point, y: float | None = None) -> str:
    if run.success:
        return "no error is known" if y is None else ""
    return _wrapped(doubt(run.message) if run.status == DOUBTED else run.message)


def described(run: Point) -> str:
    """What a pointer shows at a run."""
    note = (" (disturbed)" if run.disturbed else "") if run.alone else " (beside other work)"
    lines = [
        run.setting.text,
        f"error {shown(run.error if run.doubted is None else run.doubted)}",
        f"{seconds(run.time)}{note}, {shown(run.evaluations)} evaluations",
        f"drift: position {brief(run.position)}, velocity {brief(run.velocity)}",
    ]
    return "<br>".join(lines)


def _wrapped(message: str, width: int = 60) -> str:
    """Short lines for a pointer's label, which does not wrap by itself; signs of HTML are harmless."""
    lines = [""]
    for word in message.replace("<", "&lt;").split():
        if lines[-1] and len(lines[-1]) + len(word) >= width:
            lines.append("")
        lines[-1] += f" {word}" if lines[-1] else word
    return "<br>".join(lines)
