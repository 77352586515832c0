"""The curves as one self-contained HTML page: plotly is embedded once, nothing is fetched."""

from __future__ import annotations

import json
from html import escape
from importlib.resources import files
from string import Template

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from hhtbench.evidence import Evidence, Plot
from hhtbench.report import colours
from hhtbench.report.figures import figure
from hhtbench.report.wording import anchor, duration, verdict


def page(evidence: Evidence, command: str) -> str:
    """The page's text."""
    template = Template(files("hhtbench.report").joinpath("page.html").read_text(encoding="utf-8"))
    styles = colours.style_numbers(evidence.plots)
    return template.substitute(
        title=escape(evidence.title),
        verdict=escape(verdict(evidence)),
        state="good" if evidence.passed else "bad",
        contents="\n".join(f'<li><a href="#{anchor(plot.id)}">{escape(plot.title)}</a></li>' for plot in evidence.plots),
        sections="\n".join(_section(*pair) for pair in zip(evidence.plots, styles, strict=True))
        or "<p>No curves were recorded.</p>",
        command=escape(command),
        seconds=escape(duration(evidence.seconds)),
        environment=escape(", ".join(f"{name} {value}" for name, value in evidence.environment.items())),
        font=colours.FONT,
        text=colours.TEXT,
        plotly=get_plotlyjs(),
    )


def _section(plot: Plot, styles: dict[str, int]) -> str:
    drawn = figure(plot, styles)
    return f"""\
<section id="{anchor(plot.id)}">
<h2>{escape(plot.title)}</h2>
<div class="plot" style="height:{drawn.layout.height}px"><script type="application/json">{embedded(drawn)}</script></div>
<p class="caption">{escape(plot.caption)}</p>
</section>"""


def embedded(drawn: go.Figure) -> str:
    """The figure as JSON within a script element: "</script>" would end it, and "<!--<script>" hide its end."""
    return json.dumps(json.loads(drawn.to_json()), separators=(",", ":")).replace("<", "\\u003c")
