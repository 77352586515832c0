"""What ``make bench-engine`` has measured, printed and as a page beside the comparison: tables, and times at equal error."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from string import Template
from typing import Any

from tabulate import tabulate

from hhtbench.campaign.analysis.fronts import STEADY
from hhtbench.report import colours
from hhtbench.report.chart import axis, layout_of
from hhtbench.report.drawings import Drawings
from hhtbench.report.elements import html_table
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.words import AT_MOST, NOTHING, brief, seconds, shown, times
from tests.performance.engine.clock import BROKEN, HOLDS, UNDECIDED, UNMEASURED
from tests.performance.engine.contest import FASTER, RIVALS, SLOWER, TARGETS

Line = Mapping[str, Any]
TITLE = "Machine speed: hand-written C, Exudyn and the reference solvers"
SECTIONS = {  # what is compared
    "steps": "Time per step beside the same step written by hand in C for this one system, with full Newton, exact "
    "derivatives and Gaussian elimination (tests/performance/*.c, -O3 -march=native): equations (H4) to (H8), implicit "
    "reaction, b = 0, alpha = -0.3. Under error control C makes a new matrix at every iteration: it takes nearly the same "
    "steps.",
    "compiling": "Time from a system to machine code: a first solve of one step less a second, in new processes.",
    "chains": "Whole solves of a planar chain beside Exudyn's, a step: equal steps and damping, modified Newton on both "
    "sides, the faster of Exudyn's linear solvers. A ratio counts only where HHT's error is not clearly larger.",
    "starts": "A solve of one step of the paper's pendulum, all of it; of an adapter what it adds to the library's own "
    "start and first step on the same functions; and one step by hand.",
    "middle": "Time of a step of middle mechanisms under error control: a whole run less its start and first step.",
    "evaluations": "Evaluations of the step's residual over accepted steps, the start's included: counted, not timed.",
    "memory": "Peak memory of a process of its own, after a first short run and after the long one.",
}
INTERVAL = (
    "Both sides in turn, round by round: the median of the rounds' ratios of processor time, and the interval that holds it "
    "at 95 % whatever its distribution. A limit holds, or is broken, where the whole interval says so."
)
CONTEST = (
    "At equal error, on the constrained problems of the library: HHT under error control and the fastest of IDA on every "
    "form, CVODE and SciPy on the underlying ODE, with and without a projection after each step, and minimal coordinates. "
    "Processor time of one solve, interpolated in the logarithms between two tolerances; below it the largest drift of "
    "position or velocity, scaled, of the run at the accurate end. Who is faster is decided by solves taken in turn; not "
    "decided where the interval holds 1."
)
HEADERS = ("fastest other that holds both levels", "fastest other at all", "explicit DOP853 on the underlying ODE")
SIDES = {  # who is drawn: label, colour, mark
    "subject": ("HHT", colours.FAMILIES["hht"], "circle"),
    "holder": (HEADERS[0], colours.FAMILIES["ida"], "square"),
    "other": (HEADERS[1], colours.FAMILIES["diffrax"], "diamond-open"),
    "explicit": (HEADERS[2], colours.FAMILIES["scipy"], "x"),
}
PAGE = """\
<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark"><title>$title</title><style>$style</style></head>
<body><h1>$title</h1>
<p class="note">$made <a href="speed.json">All numbers</a>$comparison.</p>
$sections
$scripts</body></html>
"""


def limits_table(lines: Sequence[Line]) -> Table:
    """Measured numbers with their limits."""
    return make_table(["what", "measured", "remark"], [[line["what"], _measured(line), line["note"]] for line in lines])


def _measured(line: Line) -> Cell:
    """The figure with its interval, the limit and the verdict."""
    shape = {"s": seconds, "MB": lambda value: f"{value:.3g} MB"}.get(line["unit"], shown)
    value, low, high, limit = line["value"], line["low"], line["high"], f"limit {shape(line['limit'])}"
    if value is None:
        return Cell(UNMEASURED, "", limit)
    tone = {HOLDS: "good", BROKEN: "bad"}.get(line["verdict"], "")
    finite = low != high and math.isfinite(high - low)
    within = f"{shape(low)} to {shape(high)}, {line['count']} rounds; " if finite else ""
    return Cell(shape(value), tone, f"{within}{limit}: {line['verdict']}")


def contest_table(lines: Sequence[Line]) -> Table:
    """Every problem at every error: HHT, the fastest that holds the constraints, the fastest at all, the explicit method."""
    body: list[list[str | Cell]] = []
    for line in lines:
        ours = _side(line["subject"]) if line["subject"] else Cell("not reached", "bad", line["why"])
        if line["subject"] and not line["steady"]:
            ours = ours._replace(tone="bad")
        body.append([line["problem"], f"{line['target']:.0e}", ours, *(_rival(line[kind]) for kind in RIVALS)])
    note = f"Holds both levels: drift {AT_MOST} {STEADY:.0e}."
    return make_table(["problem", "error", "HHT", *HEADERS], body, note)


def _side(side: Line) -> Cell:
    drift = "drift not measured" if side["drift"] is None else f"drift {brief(side['drift'])}"
    return Cell(f"{AT_MOST} " * side["bound"] + seconds(side["seconds"]), "", drift)


def _rival(side: Line | None) -> str | Cell:
    if side is None:
        return NOTHING
    cell = _side(side)
    said = ""
    if "verdict" in side:
        said = f"HHT {times(side['value'])} its time, {brief(side['low'])} to {brief(side['high'])}: {side['verdict']}; "
    tone = {FASTER: "good", SLOWER: "bad"}.get(side.get("verdict", ""), "")
    return cell._replace(text=f"{side['entry']} {cell.text}", detail=said + cell.detail, tone=tone)


def summary(lines: Sequence[Line]) -> list[str]:
    """What the contest says in a few sentences; a comparison that is not decided counts for nobody."""
    return [_said([line for line in lines if line["target"] == target], target) for target in TARGETS]


def _said(lines: Sequence[Line], target: float) -> str:
    there = [line for line in lines if line["subject"]]
    verdicts = Counter((line["holder"] or {"verdict": FASTER}).get("verdict") for line in there if line["steady"])
    explicit = [line["explicit"] for line in there if (line["explicit"] or {}).get("verdict") == SLOWER]
    typical = f", typically {times(statistics.median(side['value'] for side in explicit))}" if explicit else ""
    alone = sum(bool(line["explicit"]) for line in lines if not line["subject"])
    return (
        f"Error {target:.0e}: of {len(lines)} problems HHT reaches it on {len(there)} and is the fastest of those that "
        f"keep both levels below {STEADY:.0e} on {verdicts[FASTER]} (not decided on {verdicts[UNDECIDED]}); explicit DOP853 "
        f"on the underlying ODE is faster than HHT on {len(explicit)}{typical}, and gets there alone on {alone}."
    )


def printed(speed: Line) -> str:
    """All sections that ``speed`` holds, and the one line at the end."""
    parts = []
    for key, text in SECTIONS.items():
        if speed.get(key):
            parts += [f"\n{text}", _text(limits_table(speed[key]))]
    if speed.get("contest"):
        parts += [f"\n{CONTEST}", _text(contest_table(speed["contest"])), *summary(speed["contest"])]
    counts = Counter(line["verdict"] for key in SECTIONS for line in speed.get(key) or [])
    said = ", ".join(f"{counts[verdict]} {verdict}" for verdict in (HOLDS, BROKEN, UNDECIDED, UNMEASURED))
    return "\n".join([*parts, f"\n{counts.total()} limits: {said}; {speed['seconds']:.0f} s"])


def _text(table: Table) -> str:
    body = [[f"{cell.text} {cell.detail}".strip() for cell in row] for row in table.rows]
    text = tabulate(body, headers=table.headers, tablefmt="simple", disable_numparse=True)
    return f"{text}\n{table.note}" if table.note else text


def page(speed: Line, compared: bool = False) -> str:
    """The text of ``speed.html``; ``compared``: the comparison lies beside it."""
    drawings, report = Drawings(), files("hhtbench.report")
    style = Template(report.joinpath("comparison.css").read_text(encoding="utf-8"))
    parts = [f"<p>{escape(INTERVAL)}</p>"]
    for key, text in SECTIONS.items():
        if speed.get(key):
            parts.append(
                f'<h2 id="{key}">{key}</h2>\n<p class="lead">{escape(text)}</p>\n{html_table(limits_table(speed[key]))}'
            )
    if speed.get("contest"):
        said = "<br>".join(map(escape, summary(speed["contest"])))
        parts.append(f'<h2 id="contest">contest</h2>\n<p class="lead">{escape(CONTEST)}<br>{said}</p>')
        parts += [_figure(speed["contest"], target, drawings) for target in TARGETS]
        parts.append(html_table(contest_table(speed["contest"])))
    environment = ", ".join(f"{name} {value}" for name, value in speed["environment"].items())
    return Template(PAGE).substitute(
        title=escape(TITLE),
        style=style.substitute(font=colours.FONT, text=colours.TEXT, height=400),
        made=escape(f"Measured by make bench-engine on {speed['created'][:10]}, side by side in one run. {environment}."),
        comparison=', <a href="index.html">the comparison</a>' if compared else "",
        sections="\n".join(parts),
        scripts=drawings.scripts(report.joinpath("draw_all.js").read_text(encoding="utf-8")),
    )


def _figure(lines: Sequence[Line], target: float, drawings: Drawings) -> str:
    drawn = time_figure([line for line in lines if line["target"] == target])
    return (
        f"<h3>Time to reach an error of {target:.0e}: left is faster</h3>\n{drawings.box(drawn, drawn['layout']['height'])}"
    )


def time_figure(lines: Sequence[Line]) -> dict[str, Any]:
    """One line a problem, one mark a side."""
    names = [line["problem"] for line in lines]
    data = []
    for side, (label, colour, symbol) in SIDES.items():
        found = [(line["problem"], line[side]) for line in lines if line[side]]
        data.append(
            {
                "type": "scatter",
                "x": [cost["seconds"] for _, cost in found],
                "y": [name for name, _ in found],
                "text": [cost["entry"] for _, cost in found],
                "name": label,
                "mode": "markers",
                "marker": {"color": colour, "symbol": symbol, "size": 9},
                "hovertemplate": "%{y}: %{text}, %{x:.3g} s",
            }
        )
    exponents = [math.log10(cost["seconds"]) for line in lines for side in SIDES if (cost := line[side])] or [-3.0, 0.0]
    rows = {"title": "problem", "automargin": True, "categoryorder": "array", "categoryarray": names[::-1]}
    layout = layout_of(
        axis("processor time of one solve [s]", [min(exponents) - 0.2, max(exponents) + 0.2], logarithmic=True), rows
    )
    legend = {"orientation": "h", "y": 1.0, "yanchor": "bottom", "x": 0.0}
    return {"data": data, "layout": layout | {"height": 150 + 22 * len(names), "showlegend": True, "legend": legend}}
