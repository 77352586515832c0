"""The comparison of a campaign: ``index.html`` and ``report.md``."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from hhtbench import analysis
from hhtbench.errors import ProblemError
from hhtbench.evidence import Evidence
from hhtbench.report import colours, runs, tables
from hhtbench.report.atlas import TOLERANCES
from hhtbench.report.chart import HEIGHT, draw
from hhtbench.report.charts import problem_charts
from hhtbench.report.colours import SolverStyle
from hhtbench.report.content import FAILED, Content, Part, content_of
from hhtbench.report.drawings import Drawings
from hhtbench.report.elements import html_table, sketch
from hhtbench.report.first_screen import decision_section, evidence_section, figure_of, overview
from hhtbench.report.legend import legend
from hhtbench.report.markdown import claims, environment_table, escape_text, markdown_table
from hhtbench.report.rules import campaign_told
from hhtbench.report.speed_section import speed_section
from hhtbench.report.wording import anchor, verdict
from hhtbench.report.words import MEASURES, bounded, plural
from hhtbench.store.rows import RunRow

COMPARISON = "index.html"
ATLAS = "Failure atlas: runs that failed or are not believed"
COUNTED = (
    "How many runs, by solver and form (lines) and by cause (columns); declined ones stand with their problem. "
    f"Silently wrong: a success under error control that is off by more than {TOLERANCES:g} times its tolerance."
)
TITLE = "Accuracy, work and drift: extended HHT-alpha and other solvers"
CURVES = "convergence.html"  # written by `verify`, linked where it is there
WEIGHT = "b/convergence.html"  # by `verify b`, the same
STABILITY = "stability.html"  # by `study stability`, the same
BESIDE = {WEIGHT: "the weight b", STABILITY: "stability at the extremes"}


def write_comparison(
    rows: Sequence[RunRow], folder: Path, command: str, evidence: Evidence | None = None, losses: str = ""
) -> Content:
    """Write ``index.html`` and ``report.md`` into ``folder``, which is made when it is missing.

    Where ``make bench-engine`` has left its ``speed.json`` there, ``index.html`` shows it too.

    Parameters
    ----------
    rows
        The campaign's rows, failed ones included.
    folder
        Where the files go; files of an earlier report are replaced.
    command
        The command that made the report, printed so that a reader can repeat it.
    evidence
        A verification that ``report.md`` ends with and whose verdict ``index.html`` shows.
    losses
        What of the rows could not be read, in words; both begin with it.

    Returns
    -------
    Content
        What was written.

    Raises
    ------
    ProblemError
        The folder cannot be made or written, or ``speed.json`` cannot be read.
    """
    content = content_of(rows, losses)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        curves = (folder / CURVES).is_file()
        drawings = Drawings()
        speed = speed_section(folder, drawings)
        others = {"#speed": "machine speed"} if speed else {}
        others |= {page: name for page, name in BESIDE.items() if (folder / page).is_file()}
        text = _page(content, command, evidence, curves, others, speed, drawings)
        (folder / COMPARISON).write_text(text, encoding="utf-8")
        (folder / "report.md").write_text(_markdown(content, command, evidence), encoding="utf-8")
    except OSError as error:
        raise ProblemError(f"the report cannot be written to {folder}: {error.strerror}.") from error
    return content


def _page(
    content: Content,
    command: str,
    evidence: Evidence | None,
    curves: bool,
    others: Mapping[str, str],
    speed: str,
    drawings: Drawings,
) -> str:
    """The text of ``index.html``; ``others`` names sections and pages beside it, ``speed`` is a section in ``drawings``."""
    styles = colours.solver_styles(analysis.entries(content.rows))
    texts = {name: files("hhtbench.report").joinpath(f"comparison.{name}").read_text(encoding="utf-8") for name in PARTS}
    return Template(texts["html"]).substitute(
        title=escape(TITLE),
        style=Template(texts["css"]).substitute(font=colours.FONT, text=colours.TEXT, height=HEIGHT),
        scope=_scope(content, others),
        losses=f'<p class="verdict bad">{escape(content.losses)}</p>' if content.losses else "",
        decision=decision_section(content.decisions),
        reading=_prose(content.reading),
        overview=overview(content, styles, drawings),
        contents="\n".join(f'<a href="#{anchor(part.name)}">{escape(part.name)}</a>' for part in content.parts),
        summary="\n".join(f"<p>{_prose(part)}</p>" for part in content.sentences),
        claims=_verdict_box(evidence, curves),
        balance=html_table(content.balance),
        rules="\n".join(f"<li>{_prose(rule)}</li>" for rule in content.rules),
        evidence="\n".join(evidence_section(kind, content) for kind in content.kinds),
        drift=html_table(content.drift),
        legend=legend(styles),
        sections="\n".join(_problem_section(content.rows, part, styles, drawings) for part in content.parts),
        failures=ATLAS,
        counted=COUNTED,
        causes=html_table(content.atlas.causes()),
        atlas=html_table(content.atlas.table()),
        campaign=escape(campaign_told(content.rows)),
        speed=speed,
        machine=_machine(content.rows),
        command=escape(command),
        created=escape(_created(content.rows)),
        scripts=drawings.scripts(texts["js"]),
    )


def _scope(content: Content, others: Mapping[str, str]) -> str:
    """What is compared, and the pages beside this one."""
    found = [plural(len(content.parts), "problem"), plural(len(analysis.entries(content.rows)), "solver")]
    found += [plural(len(content.rows), "run")]
    links = {
        "#problems": "problems",
        "#words": "in words",
        "#atlas": "failures",
        "#rules": "rules",
        "#machine": "machine",
        **others,
    }
    return f"{', '.join(found)}. " + " · ".join(f'<a href="{link}">{escape(name)}</a>' for link, name in links.items())


PARTS = ("html", "css", "js")


def _markdown(content: Content, command: str, evidence: Evidence | None) -> str:
    """The text of ``report.md``."""
    parts = [f"# {TITLE}", *map(escape_text, content.sentences), "The same with charts: [index.html](index.html)."]
    parts.append(content.reading)
    for (measure, bound), table in content.decisions.items():
        parts += [f"## By {MEASURES[measure]}, {bounded(bound)}", *markdown_table(table)]
    parts += ["## Wins and losses", *markdown_table(content.balance)]
    parts += ["## The rules", "\n".join(f"- {escape_text(rule)}" for rule in content.rules)]
    for kind, table in content.against.items():
        parts += [f"## HHT against the cheapest other solver: {kind.text}", *markdown_table(table)]
    parts += ["## Drift at equal accuracy", *markdown_table(content.drift)]
    for part in content.parts:
        parts += [f"## {escape_text(part.name)}", *map(escape_text, part.sentences)]
        for caption, table in part.tables.items():
            parts += [f"### {caption}", *markdown_table(table)]
    parts += [f"## {ATLAS}", COUNTED, *markdown_table(content.atlas.causes())]
    parts += ["<details><summary>Each</summary>", *markdown_table(content.atlas.table()), "</details>"]
    parts += [
        "## How it was made",
        f"```\n{command}\n```",
        f"Rows of {_created(content.rows)}. {campaign_told(content.rows)}",
    ]
    parts += [environment_table(environment) for environment in tables.environments(content.rows)]
    if evidence is not None:
        parts += claims(evidence)
    return "\n\n".join(parts) + "\n"


def _prose(text: str) -> str:
    """Escaped, with numbers that no line break tears apart."""
    return re.sub(r"\d+e-\d+", r'<span class="number">\g<0></span>', escape(text))


def _problem_section(rows: Sequence[RunRow], part: Part, styles: dict[str, SolverStyle], drawings: Drawings) -> str:
    groups: dict[str, dict[str, tuple[Any, str]]] = {}
    for chart in problem_charts(rows, part.name):
        groups.setdefault(chart.group, {})[chart.view] = (draw(chart, styles), chart.caption)
    drawn = "\n".join(figure_of(f"{part.name}-{title}", title, views, drawings) for title, views in groups.items())
    everything = runs.all_runs(rows, part.name)
    built = "\n".join(html_table(table, caption) for caption, table in part.tables.items() if caption != FAILED)
    return f"""\
<section>
<h2 id="{anchor(part.name)}">{escape(part.name)}</h2>
{sketch(part.name)}
<p class="lead">{"<br>".join(_prose(text) for text in part.sentences)}</p>
<div class="charts">
{drawn or "<p>No run left anything to draw.</p>"}
</div>
{html_table(part.tables[FAILED], FAILED)}
<details><summary>Costs, errors and counters on {escape(part.name)}</summary>
{built}
</details>
<details><summary>All {len(everything.rows)} runs on {escape(part.name)}</summary>
{html_table(everything)}
</details>
</section>"""


def _verdict_box(evidence: Evidence | None, curves: bool) -> str:
    if evidence is None:
        return ""
    link = f' <a href="{CURVES}">The curves</a>,' if curves else ""
    state = "good" if evidence.passed else "bad"
    text = f"<b>{escape(evidence.title)}.</b> {escape(verdict(evidence))}"
    return f'<p class="verdict {state}">{text}{link} <a href="report.md">the table of claims</a>.</p>'


def _machine(rows: Sequence[RunRow]) -> str:
    lines = [", ".join(f"{name} {value}" for name, value in found.items()) for found in tables.environments(rows)]
    return "\n".join(f"<p>{escape(line)}</p>" for line in lines) or "<p>Not recorded.</p>"


def _created(rows: Sequence[RunRow]) -> str:
    dates = sorted(row.created[:10] for row in rows if row.created)
    if not dates:
        return "an unknown date"
    return dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}"
