"""The comparison of a campaign: ``index.html``, and ``summary.md`` for a terminal."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.kinds import Kind
from hhtbench.campaign.store.rows import RunRow
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.evidence import Evidence
from hhtbench.report import colours, runs
from hhtbench.report.atlas import COUNTED
from hhtbench.report.chart import HEIGHT, draw
from hhtbench.report.charts import problem_charts
from hhtbench.report.colours import SolverStyle
from hhtbench.report.content import AGAINST, ATLAS, FAILED, TITLE, Content, Part, content_of, environments, period
from hhtbench.report.drawings import Drawings
from hhtbench.report.elements import folded, html_table, legend, prose, sketch
from hhtbench.report.first_screen import decision_section, evidence_section, figure_of, overview
from hhtbench.report.markdown import summary_page
from hhtbench.report.rules import campaign_line
from hhtbench.report.wording import anchor, verdict
from hhtbench.report.words import plural

COMPARISON, SUMMARY = "index.html", "summary.md"
CURVES, CLAIMS = "convergence.html", "report.md"  # written by `verify`, linked where they are there
WEIGHT = "b/convergence.html"  # by `verify b`, the same
STABILITY = "stability.html"  # by `study stability`, the same
SPEED = "speed.html"  # by `make bench-engine`, the same
BESIDE = {SPEED: "machine speed", WEIGHT: "the weight b", STABILITY: "stability at the extremes"}


def write_comparison(
    rows: Sequence[RunRow], folder: Path, command: str, evidence: Evidence | None = None, losses: str = ""
) -> Content:
    """Write ``index.html`` and ``summary.md`` into ``folder``, which is made when it is missing, and return what they say.

    Both show the verdict of ``evidence``, a verification, the ``command`` that a reader can repeat, and begin with
    ``losses``, what of the rows could not be read.

    Raises
    ------
    ProblemError
        The folder cannot be made or written.
    """
    content = content_of(rows, losses)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        beside = [name for name in (*BESIDE, CURVES, CLAIMS) if (folder / name).is_file()]
        (folder / COMPARISON).write_text(_page(content, command, evidence, beside), encoding="utf-8")
        (folder / SUMMARY).write_text(summary_page(content, command, evidence), encoding="utf-8")
    except OSError as error:
        raise ProblemError(f"the report cannot be written to {folder}: {error.strerror}.") from error
    return content


def _page(content: Content, command: str, evidence: Evidence | None, beside: Collection[str]) -> str:
    """The text of ``index.html``; ``beside``: the pages in the same folder."""
    drawings = Drawings()
    kinds = {name: kind for kind, names in content.kinds.items() for name in names}
    styles = colours.solver_styles(analysis.entries(content.rows))
    texts = {name: files("hhtbench.report").joinpath(f"comparison.{name}").read_text(encoding="utf-8") for name in PARTS}
    return Template(texts["html"]).substitute(
        title=escape(TITLE),
        style=Template(texts["css"]).substitute(font=colours.FONT, text=colours.TEXT, height=HEIGHT),
        scope=_scope(content, beside),
        losses=f'<p class="verdict bad">{escape(content.losses)}</p>' if content.losses else "",
        decision=decision_section(content.decisions),
        reading=prose(content.reading),
        recommendations="\n".join(f"<li>{prose(text)}</li>" for text in content.recommendations),
        overview=overview(content, styles, drawings),
        contents="\n".join(f'<a href="#{anchor(part.name)}">{escape(part.name)}</a>' for part in content.parts),
        summary="\n".join(f"<p>{prose(part)}</p>" for part in content.sentences),
        claims=_verdict_box(evidence, beside),
        balance=html_table(content.balance),
        rules="\n".join(f"<li>{prose(rule)}</li>" for rule in content.rules),
        evidence="\n".join(evidence_section(kind, content, drawings) for kind in content.kinds),
        legend=legend(styles),
        sections="\n".join(_problem_section(part, kinds[part.name], styles, drawings) for part in content.parts),
        failures=ATLAS,
        counted=COUNTED,
        causes=html_table(content.atlas.causes()),
        atlas=folded(
            "failed-runs",
            "Each failure: solver, form, problem, accuracy, cause",
            drawings.part().packed(html=html_table(content.atlas.table())),
        ),
        campaign=escape(campaign_line(content.rows)),
        machine="\n".join(f"<p>{escape(line)}</p>" for line in environments(content.rows)),
        command=escape(command),
        created=escape(period(content.rows)),
        scripts=drawings.scripts(texts["js"]),
    )


def _scope(content: Content, beside: Collection[str]) -> str:
    """What is compared, and the pages beside this one."""
    found = [plural(len(content.parts), "problem"), plural(len(analysis.entries(content.rows)), "solver")]
    found += [plural(len(content.rows), "run")]
    links = {
        "#problems": "problems",
        "#findings": "findings",
        "#atlas": "failures",
        "#rules": "how it is compared",
        "#machine": "machine",
    }
    links |= {page: name for page, name in BESIDE.items() if page in beside}
    return f"{', '.join(found)}. " + " · ".join(f'<a href="{link}">{escape(name)}</a>' for link, name in links.items())


PARTS = ("html", "css", "js")


def _problem_section(part: Part, kind: Kind, styles: Mapping[str, SolverStyle], page: Drawings) -> str:
    """All about one problem, compressed until a reader opens it; above it what it is."""
    drawings = page.part()
    groups: dict[str, dict[str, tuple[Any, str]]] = {}
    for chart in problem_charts(part.rows):
        groups.setdefault(chart.group, {})[chart.view] = (draw(chart, styles), chart.caption)
    drawn = "\n".join(figure_of(f"{part.name}-{title}", title, views, drawings) for title, views in groups.items())
    everything = runs.all_runs(part.rows)
    built = "\n".join(
        html_table(table, caption) for caption, table in part.tables.items() if caption not in (AGAINST, FAILED)
    )
    details = f"""\
<div class="charts">
{drawn or "<p>No run left anything to draw.</p>"}
</div>
{html_table(part.tables[AGAINST], AGAINST)}
{html_table(part.tables[FAILED], FAILED)}
<details><summary>Costs, errors and counters on {escape(part.name)}</summary>
{built}
</details>
<details><summary>All {len(everything.rows)} runs on {escape(part.name)}</summary>
{html_table(everything)}
</details>"""
    failed = sum(not row.success for row in part.rows)
    said = f"{kind.text}, {plural(len(part.rows), 'run')}, {failed} failed"
    packed = f"{sketch(part.name)}\n{drawings.packed(html=details)}"
    return folded(anchor(part.name), f"<h3>{escape(part.name)}</h3> {escape(said)}", packed)


def _verdict_box(evidence: Evidence | None, beside: Collection[str]) -> str:
    if evidence is None:
        return ""
    links = {CURVES: "the curves", CLAIMS: "the table of claims"}
    named = ", ".join(f'<a href="{page}">{name}</a>' for page, name in links.items() if page in beside)
    text = f"<b>{escape(evidence.title)}.</b> {escape(verdict(evidence))}"
    return f'<p class="verdict {"good" if evidence.passed else "bad"}">{text} {named}</p>'
