"""The curves as one self-contained HTML page: plotly is embedded once, nothing is fetched."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from string import Template

from hhtbench.evidence import Evidence, Plot
from hhtbench.report import colours
from hhtbench.report.drawings import Drawings
from hhtbench.report.figures import figure
from hhtbench.report.wording import anchor, duration, verdict


def page(evidence: Evidence, command: str) -> str:
    """The page's text."""
    template = Template(files("hhtbench.report").joinpath("page.html").read_text(encoding="utf-8"))
    styles, drawings = colours.style_numbers(evidence.plots), Drawings()
    return template.substitute(
        title=escape(evidence.title),
        verdict=escape(verdict(evidence)),
        state="good" if evidence.passed else "bad",
        contents="\n".join(f'<li><a href="#{anchor(plot.id)}">{escape(plot.title)}</a></li>' for plot in evidence.plots),
        sections="\n".join(_section(*pair, drawings) for pair in zip(evidence.plots, styles, strict=True))
        or "<p>No curves were recorded.</p>",
        command=escape(command),
        seconds=escape(duration(evidence.seconds)),
        environment=escape(", ".join(f"{name} {value}" for name, value in evidence.environment.items())),
        font=colours.FONT,
        text=colours.TEXT,
        scripts=drawings.scripts(files("hhtbench.report").joinpath("draw_all.js").read_text(encoding="utf-8")),
    )


def _section(plot: Plot, styles: dict[str, int], drawings: Drawings) -> str:
    drawn = figure(plot, styles)
    return f"""\
<section id="{anchor(plot.id)}">
<h2>{escape(plot.title)}</h2>
{drawings.box(drawn, drawn["layout"]["height"])}
<p class="caption">{escape(plot.caption)}</p>
</section>"""
