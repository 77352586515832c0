"""Page of a trade: error against time, evaluations and drift, with the report's charts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from hhtbench.campaign import analysis
from hhtbench.campaign.store import RunRow
from hhtbench.report import colours
from hhtbench.report.chart import draw
from hhtbench.report.charts import PRECISION, problem_charts
from hhtbench.report.drawings import Drawings
from hhtbench.report.figures import show_legend
from hhtbench.report.frame import Chart

PAGE = """\
<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>body {{ font: 16px/1.5 {font}; color: {text}; max-width: 60rem; margin: 1rem auto; padding: 0 1rem }}
pre {{ overflow-x: auto; font-size: 13px }}</style></head>
<body><h1>{title}</h1><p><b>{sentence}</b></p>
{figures}
<pre>{table}</pre>
{scripts}</body></html>
"""


def trade_charts(rows: Sequence[RunRow]) -> list[Chart]:
    """Return the charts of error against time, evaluations and (with constraints) drift; ``rows`` are of one problem."""
    return [chart for chart in problem_charts(rows) if chart.group == PRECISION] if rows else []


def write_page(rows: Sequence[RunRow], title: str, sentence: str, table: str, file: Path) -> None:
    """Write the trade as one self-contained HTML file."""
    styles, drawings = colours.solver_styles(analysis.entries(rows)), Drawings()
    boxes = [_box(chart, styles, drawings) for chart in trade_charts(rows)]
    text = PAGE.format(
        title=escape(title),
        font=colours.FONT,
        text=colours.TEXT,
        sentence=escape(sentence),
        figures="\n".join(boxes) or "<p>No run left anything to draw.</p>",
        table=escape(table),
        scripts=drawings.scripts(files("hhtbench.report").joinpath("draw_all.js").read_text(encoding="utf-8")),
    )
    file.write_text(text, encoding="utf-8")


def _box(chart: Chart, styles: Mapping[str, colours.SolverStyle], drawings: Drawings) -> str:
    """Return the HTML of a chart with its title and a legend that names each solver once."""
    figure = show_legend(draw(chart, styles), chart)
    figure["layout"] |= {"title": {"text": escape(chart.title)}}
    figure["layout"]["margin"] |= {"t": 60}
    return drawings.box(figure, figure["layout"]["height"])
