"""Writes the report of one verification: ``report.md``, ``convergence.html``, ``evidence.json``."""

from __future__ import annotations

from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.evidence import Evidence, Plot
from hhtbench.report import colours
from hhtbench.report.drawings import Drawings
from hhtbench.report.figures import figure
from hhtbench.report.markdown import markdown
from hhtbench.report.wording import anchor, duration, verdict


def write_report(evidence: Evidence, folder: Path, command: str) -> None:
    """Write the three files into ``folder``, which is made when it is missing; ``command`` is what a reader can repeat.

    Raises
    ------
    ProblemError
        The folder cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "report.md").write_text(markdown(evidence, command), encoding="utf-8")
        (folder / "convergence.html").write_text(page(evidence, command), encoding="utf-8")
        evidence.write_json(folder / "evidence.json")
    except OSError as error:
        raise ProblemError(f"the report cannot be written to {folder}: {error.strerror}.") from error


def page(evidence: Evidence, command: str) -> str:
    """The curves as one self-contained HTML page: plotly is embedded once, nothing is fetched."""
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
