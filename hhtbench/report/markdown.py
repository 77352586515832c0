"""A verification as one Markdown page, and a summary of a comparison that fits a terminal."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from tabulate import tabulate

from hhtbench.protocol.evidence import Evidence, Plot, Row
from hhtbench.report.content import ATLAS, TITLE, Content, environments, period
from hhtbench.report.rules import campaign_line
from hhtbench.report.tables import Table
from hhtbench.report.wording import anchor, duration, group_of, groups, verdict

MAX_SUMMARY_ROWS = 42  # of each of its tables, and sentences on kinds: with these it stays below the lines

CLAIMS = """\
Each row is one claim: a sentence that can be wrong, the number measured for it, the bound it must keep, and the
verdict: `ok`, `FAIL`, or nothing where the row is printed beside the claims and not judged.  The same rows are in
[evidence.json](evidence.json), the curves behind them in [convergence.html](convergence.html), which needs no
network.
"""


def markdown(evidence: Evidence, command: str) -> str:
    """The page's text."""
    parts = [f"# {escape_text(evidence.title)}", f"**{escape_text(verdict(evidence))}**"]
    parts += [escape_text(evidence.summary), CLAIMS.strip()]
    plots = list(evidence.plots)
    for name, rows in groups(evidence.rows).items():
        own = [plot for plot in plots if group_of(plot.id) == name]
        plots = [plot for plot in plots if plot not in own]
        parts += [f"## {escape_text(name)}", _table(evidence, rows), *_links(own)]
    if plots:
        parts += ["## Further curves", *_links(plots)]
    parts += ["## How it was made", f"```\n{command}\n```", f"Wall time: {duration(evidence.seconds)}."]
    environment = [(name, escape_text(str(value))) for name, value in evidence.environment.items()]
    parts.append(tabulate(environment, headers=["environment", ""], tablefmt="github", disable_numparse=True))
    return "\n\n".join(parts) + "\n"


def summary_page(content: Content, command: str, evidence: Evidence | None = None) -> str:
    """What a campaign came to, for the log of a build: at most 200 lines, however many rows."""
    losses = [escape_text(content.losses)] if content.losses else []
    advice = "\n".join(f"- {escape_text(text)}" for text in content.recommendations[-MAX_SUMMARY_ROWS:])
    parts = [f"# {TITLE}", *losses, "## What to take", *_shortened(content.decisions["time", None]), *filter(None, [advice])]
    parts += [escape_text(content.reading), "## Findings", *map(escape_text, content.sentences)]
    for title, table in {"Wins and losses": content.balance, ATLAS: content.atlas.causes()}.items():
        parts += [f"## {title}", *_shortened(table)]
    if evidence is not None:
        parts += [f"## {escape_text(evidence.title)}", escape_text(verdict(evidence))]
    made = [f"Made by `{command}` from rows of {period(content.rows)}.", campaign_line(content.rows)]
    machine, *others = environments(content.rows)
    made.append(machine + f"; {len(others)} more machines" * bool(others))
    return "\n\n".join([*parts, "## How it was made", *map(escape_text, made)]) + "\n"


def _shortened(table: Table) -> list[str]:
    rest = len(table.rows) - MAX_SUMMARY_ROWS
    more = [f"{rest} more lines are on the page."] if rest > 0 else []
    return [*markdown_table(replace(table, rows=table.rows[:MAX_SUMMARY_ROWS])), *more]


def markdown_table(table: Table) -> list[str]:
    """The table, "None." where it has no rows, and its note."""
    headers = [escape_text(header) for header in table.headers]
    body = [[escape_text(f"{cell.text} {cell.detail}") for cell in row] for row in table.rows]
    text = tabulate(body, headers=headers, tablefmt="github", disable_numparse=True) if body else "None."
    return [text, escape_text(table.note)] if table.note else [text]


def _table(evidence: Evidence, rows: Sequence[Row]) -> str:
    escaped = []
    for row in rows:
        texts: dict[str, Any] = {name: escape_text(text) for name, text in vars(row).items() if isinstance(text, str)}
        escaped.append(replace(row, **texts))
    return replace(evidence, rows=tuple(escaped)).table("github")


def _links(plots: Sequence[Plot]) -> list[str]:
    lines = [
        f"- [{escape_text(plot.title)}](convergence.html#{anchor(plot.id)}): {escape_text(plot.caption)}" for plot in plots
    ]
    return ["\n".join(lines)] if lines else []


def escape_text(text: str) -> str:
    """Keep signs of formulas from acting as Markdown: ``|g|`` would end a table's cell."""
    for sign in "\\|*<":
        text = text.replace(sign, f"\\{sign}")
    return " ".join(text.split())
