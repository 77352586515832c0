"""Tables and pictures as HTML."""

from __future__ import annotations

import base64
from html import escape

from hhtbench.registry import thumbnail_of
from hhtbench.report.tables import Cell, Table

LONG = 44  # characters; a longer cell may wrap


def html_table(table: Table, caption: str = "") -> str:
    """The table in a box that scrolls sideways, its headers for sorting; "None." where it has no rows."""
    if not table.rows:
        return "<p>None.</p>" if not caption else f"<p><b>{escape(caption)}</b>: none.</p>"
    head = "".join(f'<th scope="col"><button type="button">{escape(header)}</button></th>' for header in table.headers)
    body = "\n".join(f"<tr>{''.join(_html_cell(cell) for cell in row)}</tr>" for row in table.rows)
    note = f'<p class="note">{escape(table.note)}</p>' if table.note else ""
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f'<div class="scroll"><table>{title}<thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>{note}'


def _html_cell(cell: Cell) -> str:
    classes = " ".join(part for part in (cell.tone, "long" if len(cell.text) > LONG else "") if part)
    named = f' class="{classes}"' if classes else ""
    detail = f"<small>{escape(cell.detail)}</small>" if cell.detail else ""
    text = f'<a href="{escape(cell.link)}">{escape(cell.text)}</a>' if cell.link else escape(cell.text)
    return f"<td{named}>{text}{detail}</td>"


def sketch(problem: str) -> str:
    """The drawing of the registered problem that ``problem`` is, or is made of, as an element; empty where there is none."""
    name, _, parameters = problem.partition("(")
    file = thumbnail_of(name)
    if file is None:
        return ""
    title = escape(f"{name} with its default parameters" if parameters else name)
    data = base64.b64encode(file.read_bytes()).decode()
    image = f'<img src="data:image/png;base64,{data}" width="200" height="150" alt="{title}">'
    return f'<div class="sketch">{image}<p class="caption">{title}</p></div>'
