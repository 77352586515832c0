"""The lines that ``make bench-engine`` prints."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from tabulate import tabulate

from hhtbench.report.speed import SECTIONS, contest_rows, contest_table, shares_table
from hhtbench.report.tables import Table


def printed(speed: Mapping[str, Any]) -> str:
    """All sections that ``speed`` holds, and the one line at the end."""
    parts = [f"engine: {speed['engine']}"]
    for key, section in SECTIONS.items():
        if speed.get(key):
            parts += [f"\n{section.title}", _text(section.table(speed[key]))]
    rows = contest_rows(speed)
    if rows:
        parts += ["\nAt equal error, beside the reference solvers (processor time)", _text(contest_table(rows))]
        parts += ["\nTime in the equations, of the most accurate run of each solver (medians over the problems)"]
        parts += [_text(shares_table(rows))]
    lines = [line for key in SECTIONS for line in speed.get(key) or []]
    broken = sum(line["holds"] is False for line in lines)
    unknown = sum(line["holds"] is None for line in lines)
    said = f"{len(lines) - broken - unknown} of {len(lines)} limits hold, {broken} broken, {unknown} not measured"
    return "\n".join([*parts, f"\n{said}; {speed['seconds']:.0f} s"])


def _text(table: Table) -> str:
    body = [[f"{cell.text} {cell.detail}".strip() for cell in row] for row in table.rows]
    text = tabulate(body, headers=table.headers, tablefmt="simple", disable_numparse=True)
    return f"{text}\n{table.note}" if table.note else text
