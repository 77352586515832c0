"""The report as one Markdown page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from tabulate import tabulate

from hhtbench.evidence import Evidence, Plot, Row
from hhtbench.report.tables import Table
from hhtbench.report.wording import anchor, duration, group_of, groups, verdict

CLAIMS = """\
Each row is one claim: a sentence that can be wrong, the number measured for it, the bound it must keep, and the
verdict: `ok`, `FAIL`, or nothing where the row is printed beside the claims and not judged.  The same rows are in
[evidence.json](evidence.json), the curves behind them in [convergence.html](convergence.html), which needs no
network.
"""


def markdown(evidence: Evidence, command: str) -> str:
    """The page's text."""
    made = ["## How it was made", f"```\n{command}\n```", f"Wall time: {duration(evidence.seconds)}."]
    return "\n\n".join([*claims(evidence), *made, environment_table(evidence.environment)]) + "\n"


def claims(evidence: Evidence) -> list[str]:
    """Paragraphs with title, verdict and every row."""
    parts = [f"# {escape_text(evidence.title)}", f"**{escape_text(verdict(evidence))}**"]
    parts += [escape_text(evidence.summary), CLAIMS.strip()]
    plots = list(evidence.plots)
    for name, rows in groups(evidence.rows).items():
        own = [plot for plot in plots if group_of(plot.id) == name]
        plots = [plot for plot in plots if plot not in own]
        parts += [f"## {escape_text(name)}", _table(evidence, rows), *_links(own)]
    if plots:
        parts += ["## Further curves", *_links(plots)]
    return parts


def environment_table(environment: Mapping[str, Any]) -> str:
    """Machine and versions."""
    rows = [(name, escape_text(str(value))) for name, value in environment.items()]
    return tabulate(rows, headers=["environment", ""], tablefmt="github", disable_numparse=True)


def markdown_table(table: Table) -> list[str]:
    """The table, "None." where it has no rows, and its note."""
    headers = [escape_text(header) for header in table.headers]
    body = [[escape_text(f"{cell.text} {cell.detail}") for cell in row] for row in table.rows]
    text = tabulate(body, headers=headers, tablefmt="github", disable_numparse=True) if body else "None."
    return [text, escape_text(table.note)] if table.note else [text]


def _table(evidence: Evidence, rows: Sequence[Row]) -> str:
    escaped = tuple(replace(row, **_escaped(row)) for row in rows)
    return replace(evidence, rows=escaped).table("github")


def _escaped(row: Row) -> dict[str, Any]:
    texts = {name: getattr(row, name) for name in ("id", "claim", "measured", "bound")}
    return {name: escape_text(text) for name, text in texts.items() if isinstance(text, str)}


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
