"""The lines that ``make bench-engine`` prints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from tabulate import tabulate

from hhtbench.report.speed import SECTIONS, VERDICTS
from hhtbench.report.speed_contest import contest_rows, contest_table, shares_table, summary
from hhtbench.report.tables import Table


def printed(speed: Mapping[str, Any]) -> str:
    """All sections that ``speed`` holds, and the one line at the end."""
    parts = [f"engine: {speed['engine']}"]
    for key, section in SECTIONS.items():
        if speed.get(key):
            parts += [f"\n{section.title}", _text(section.table(speed[key]))]
    rows = contest_rows(speed)
    if rows:
        parts += ["\nAt equal error, beside the reference solvers (processor time)"]
        parts += [_text(contest_table(rows, speed.get("duels") or [])), *summary(rows, speed.get("duels") or [])]
        parts += ["\nTime in the equations, of the most accurate run of each solver (medians over the problems)"]
        parts += [_text(shares_table(rows))]
    lines = [line for key in SECTIONS for line in speed.get(key) or []]
    counts = Counter(line["verdict"] for line in lines)
    said = ", ".join(f"{counts[verdict]} {verdict}" for verdict in VERDICTS)
    return "\n".join([*parts, f"\n{len(lines)} limits: {said}; {speed['seconds']:.0f} s"])


def _text(table: Table) -> str:
    body = [[f"{cell.text} {cell.detail}".strip() for cell in row] for row in table.rows]
    text = tabulate(body, headers=table.headers, tablefmt="simple", disable_numparse=True)
    return f"{text}\n{table.note}" if table.note else text
