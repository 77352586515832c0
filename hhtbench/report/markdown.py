"""The report as one Markdown page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from tabulate import tabulate

from hhtbench.evidence import Evidence, Plot, Row
from hhtbench.report.wording import anchor, duration, group_of, groups, verdict

CLAIMS = """\
Each row is one claim: a sentence that can be wrong, the number measured for it, the bound it must keep, and the
verdict: `ok`, `FAIL`, or nothing where the row is printed beside the claims and not judged.  The same rows are in
[evidence.json](evidence.json), the curves behind them in [convergence.html](convergence.html), which needs no
network.
"""


def markdown(evidence: Evidence, command: str) -> str:
    """The page's text."""
    parts = [f"# {_escape(evidence.title)}", f"**{_escape(verdict(evidence))}**", _escape(evidence.summary), CLAIMS.strip()]
    plots = list(evidence.plots)
    for name, rows in groups(evidence.rows).items():
        own = [plot for plot in plots if group_of(plot.id) == name]
        plots = [plot for plot in plots if plot not in own]
        parts += [f"## {_escape(name)}", _table(evidence, rows), *_links(own)]
    if plots:
        parts += ["## Further curves", *_links(plots)]
    parts += ["## How it was made", f"```\n{command}\n```", f"Wall time: {duration(evidence.seconds)}."]
    environment = [(name, _escape(value)) for name, value in evidence.environment.items()]
    parts.append(tabulate(environment, headers=["environment", ""], tablefmt="github", disable_numparse=True))
    return "\n\n".join(parts) + "\n"


def _table(evidence: Evidence, rows: Sequence[Row]) -> str:
    escaped = tuple(replace(row, **_escaped(row)) for row in rows)
    return replace(evidence, rows=escaped).table("github")


def _escaped(row: Row) -> dict[str, Any]:
    texts = {name: getattr(row, name) for name in ("id", "claim", "measured", "bound")}
    return {name: _escape(text) for name, text in texts.items() if isinstance(text, str)}


def _links(plots: Sequence[Plot]) -> list[str]:
    lines = [f"- [{_escape(plot.title)}](convergence.html#{anchor(plot.id)}): {_escape(plot.caption)}" for plot in plots]
    return ["\n".join(lines)] if lines else []


def _escape(text: str) -> str:
    """Keep signs of formulas from acting as Markdown: ``|g|`` would end a table's cell."""
    for sign in "\\|*<":
        text = text.replace(sign, f"\\{sign}")
    return " ".join(text.split())
