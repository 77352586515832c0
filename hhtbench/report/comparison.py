"""The comparison of a campaign: ``index.html`` and ``report.md``."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from plotly.offline import get_plotlyjs
from tabulate import tabulate

from hhtbench import analysis
from hhtbench.analysis import BOUNDS, Campaign
from hhtbench.errors import ProblemError
from hhtbench.evidence import Evidence
from hhtbench.report import colours, contest, runs, tables
from hhtbench.report.chart import HEIGHT, draw
from hhtbench.report.charts import problem_charts
from hhtbench.report.colours import SolverStyle
from hhtbench.report.elements import html_table
from hhtbench.report.frame import Chart
from hhtbench.report.legend import legend
from hhtbench.report.markdown import claims, environment_table, escape_text
from hhtbench.report.page import embedded
from hhtbench.report.rules import rules
from hhtbench.report.speed_page import PAGE as SPEED
from hhtbench.report.speed_page import write_speed
from hhtbench.report.summary import older, problem_summary, summary
from hhtbench.report.tables import Table
from hhtbench.report.wording import anchor, verdict
from hhtbench.report.words import bounded
from hhtbench.store.rows import RunRow

TITLE = "Accuracy, work and drift: extended HHT-alpha and other solvers"
CURVES = "convergence.html"  # written by `verify`, linked where it is there
WEIGHT = "b/convergence.html"  # by `verify b`, the same


def write_comparison(rows: Sequence[RunRow], folder: Path, command: str, evidence: Evidence | None = None) -> None:
    """Write ``index.html`` and ``report.md`` into ``folder``, which is made when it is missing.

    Where ``make bench-engine`` has left its ``speed.json`` there, ``speed.html`` is made from it and linked.

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

    Raises
    ------
    ProblemError
        The folder cannot be made or written, or ``speed.json`` cannot be read.
    """
    found = analysis.newest(rows)
    paragraphs = [*summary(found.rows), *older(found)]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        curves = (folder / CURVES).is_file()
        others = {SPEED: "machine speed"} if write_speed(folder, command) else {}
        others |= {WEIGHT: "the weight b"} if (folder / WEIGHT).is_file() else {}
        page = comparison_page(found.rows, paragraphs, command, evidence, curves, others)
        (folder / "index.html").write_text(page, encoding="utf-8")
        (folder / "report.md").write_text(comparison_markdown(found.rows, paragraphs, command, evidence), encoding="utf-8")
    except OSError as error:
        raise ProblemError(f"the report cannot be written to {folder}: {error.strerror}.") from error


def comparison_page(
    rows: Sequence[RunRow],
    paragraphs: Sequence[str],
    command: str,
    evidence: Evidence | None,
    curves: bool,
    others: Mapping[str, str] | None = None,
) -> str:
    """The text of ``index.html``; ``others`` names the pages beside it."""
    styles, whole = colours.solver_styles(analysis.entries(rows)), analysis.campaign_of(rows)
    names = analysis.problems(rows)
    links = [f'<a href="#{anchor(name)}">{escape(name)}</a>' for name in names]
    links += ['<a href="#failures">failures</a>', '<a href="#machine">machine</a>']
    links += [f'<a href="{page}">{escape(name)}</a>' for page, name in (others or {}).items()]
    texts = {name: files("hhtbench.report").joinpath(f"comparison.{name}").read_text(encoding="utf-8") for name in PARTS}
    return Template(texts["html"]).substitute(
        title=escape(TITLE),
        style=Template(texts["css"]).substitute(font=colours.FONT, text=colours.TEXT, height=HEIGHT),
        contents="\n".join(links),
        summary="\n".join(f"<p>{_prose(part)}</p>" for part in paragraphs),
        claims=_verdict_box(evidence, curves),
        balance=html_table(contest.balance(rows)),
        rules="\n".join(f"<li>{_prose(rule)}</li>" for rule in rules(rows)),
        against=html_table(contest.against(rows)),
        drift=html_table(runs.equal_drift(rows)),
        legend=legend(styles),
        sections="\n".join(_problem_section(rows, name, styles, whole) for name in names),
        failures=html_table(runs.failure_table(rows)),
        machine=_machine(rows),
        command=escape(command),
        created=escape(_created(rows)),
        plotly=get_plotlyjs(),
        script=texts["js"],
    )


PARTS = ("html", "css", "js")
RANKED: dict[str, Callable[[Sequence[RunRow], str, Campaign], Table]] = {
    **{f"Both sides of the comparison, {bounded(bound)}": partial(contest.both_sides, held=bound) for bound in BOUNDS},
    "Cheapest solvers at a given error": contest.cheapest,
}
TABLES: dict[str, Callable[[Sequence[RunRow], str], Table]] = {
    "One run of every solver, side by side": runs.side_by_side,
    "Counters of these runs": runs.counter_table,
}


def comparison_markdown(rows: Sequence[RunRow], paragraphs: Sequence[str], command: str, evidence: Evidence | None) -> str:
    """The text of ``report.md``."""
    parts = [f"# {TITLE}", *map(escape_text, paragraphs), "The same with charts: [index.html](index.html)."]
    parts += ["## Wins and losses", *_markdown_table(contest.balance(rows))]
    parts += ["## The rules", "\n".join(f"- {escape_text(rule)}" for rule in rules(rows))]
    parts += ["## HHT against the cheapest other solver", *_markdown_table(contest.against(rows))]
    parts += ["## Drift at equal accuracy", *_markdown_table(runs.equal_drift(rows))]
    whole = analysis.campaign_of(rows)
    for name in analysis.problems(rows):
        parts += [f"## {escape_text(name)}", *map(escape_text, problem_summary(rows, name, whole))]
        for caption, table in _tables(rows, name, whole):
            parts += [f"### {caption}", *_markdown_table(table)]
    parts += ["## Runs that failed or are not believed", *_markdown_table(runs.failure_table(rows))]
    parts += ["## How it was made", f"```\n{command}\n```", f"Rows of {_created(rows)}."]
    parts += [environment_table(environment) for environment in tables.environments(rows)]
    if evidence is not None:
        parts += claims(evidence)
    return "\n\n".join(parts) + "\n"


def _prose(text: str) -> str:
    """Escaped, with numbers that no line break tears apart."""
    return re.sub(r"\d+e-\d+", r'<span class="number">\g<0></span>', escape(text))


def _tables(rows: Sequence[RunRow], problem: str, whole: Campaign) -> list[tuple[str, Table]]:
    """Caption and table, of all that a problem has."""
    found = [(caption, rank(rows, problem, whole)) for caption, rank in RANKED.items()]
    return found + [(caption, build(rows, problem)) for caption, build in TABLES.items()]


def _problem_section(rows: Sequence[RunRow], problem: str, styles: dict[str, SolverStyle], whole: Campaign) -> str:
    charts = problem_charts(rows, problem)
    drawn = "\n".join(_figure(problem, chart, styles) for chart in charts) or "<p>No run left anything to draw.</p>"
    everything = runs.all_runs(rows, problem)
    built = "\n".join(html_table(table, caption) for caption, table in _tables(rows, problem, whole))
    return f"""\
<section>
<h2 id="{anchor(problem)}">{escape(problem)}</h2>
<p class="lead">{"<br>".join(_prose(text) for text in problem_summary(rows, problem, whole))}</p>
<div class="charts">
{drawn}
</div>
{built}
<details><summary>All {len(everything.rows)} runs on {escape(problem)}</summary>
{html_table(everything)}
</details>
</section>"""


def _figure(problem: str, chart: Chart, styles: dict[str, SolverStyle]) -> str:
    return f"""\
<figure id="{anchor(f"{problem}-{chart.id}")}">
<h3>{escape(chart.title)}</h3>
<div class="plot"><script type="application/json">{embedded(draw(chart, styles))}</script></div>
<figcaption class="caption">{escape(chart.caption)}</figcaption>
</figure>"""


def _markdown_table(table: Table) -> list[str]:
    headers = [escape_text(header) for header in table.headers]
    body = [[escape_text(f"{cell.text} {cell.detail}") for cell in row] for row in table.rows]
    text = tabulate(body, headers=headers, tablefmt="github", disable_numparse=True) if body else "None."
    return [text, escape_text(table.note)] if table.note else [text]


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
