"""Tables, pictures and the legend as HTML."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from html import escape

from hhtbench.catalogue.registry import thumbnail_of
from hhtbench.report.colours import SolverStyle
from hhtbench.report.tables import Cell, Table
from hhtbench.report.words import short

SVG_DASHES = {"solid": "", "dash": "7 4", "dot": "2 3", "dashdot": "7 3 2 3"}
SVG_SYMBOLS = {
    "circle": '<circle cx="17" cy="8" r="4"/>',
    "square": '<rect x="13" y="4" width="8" height="8"/>',
    "diamond": '<path d="M17 3l5 5-5 5-5-5z"/>',
    "triangle-up": '<path d="M17 3l5 9H12z"/>',
    "cross": '<path d="M15.5 3h3v3.5H22v3h-3.5V13h-3V9.5H12v-3h3.5z"/>',
    "x": '<path d="M13 5.5L14.5 4 17 6.5 19.5 4 21 5.5 18.5 8 21 10.5 19.5 12 17 9.5 14.5 12 13 10.5 15.5 8z"/>',
    "star": '<path d="M17 2.5l1.5 4H22l-2.9 2.4 1.1 4.1L17 10.5 13.8 13l1.1-4.1L12 6.5h3.5z"/>',
}
MAX_UNBROKEN = 44  # characters; a longer cell may wrap
NAME = re.compile(r"[\w.:]+\([^()]*\)|[\d.]+e-\d+")  # a solver or problem with its options, a number


def prose(text: str) -> str:
    """Escaped, with names and numbers that no line break tears apart."""
    return NAME.sub(r'<span class="whole">\g<0></span>', escape(text))


def html_table(table: Table, caption: str = "") -> str:
    """The table in a box that scrolls sideways, its headers for sorting; "None." where it has no rows."""
    if not table.rows:
        return "<p>None.</p>" if not caption else f"<p><b>{escape(caption)}</b>: none.</p>"
    head = "".join(f'<th scope="col"><button type="button">{escape(header)}</button></th>' for header in table.headers)
    body = "\n".join(f"<tr>{''.join(_html_cell(cell) for cell in row)}</tr>" for row in table.rows)
    note = f'<p class="note">{prose(table.note)}</p>' if table.note else ""
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f'<div class="scroll"><table>{title}<thead><tr>{head}</tr></thead>\n<tbody>{body}</tbody></table></div>{note}'


def _html_cell(cell: Cell) -> str:
    classes = " ".join(part for part in (cell.tone, "long" if len(cell.text) > MAX_UNBROKEN else "") if part)
    named = f' class="{classes}"' if classes else ""
    detail = f"<small>{prose(cell.detail)}</small>" if cell.detail else ""
    text = (
        f'<a href="{escape(cell.link)}">{escape(cell.text)}</a>'
        if cell.link
        else (prose if "long" in classes else escape)(cell.text)
    )
    return f"<td{named}>{text}{detail}</td>"


def folded(identifier: str, title: str, packed: str) -> str:
    """A part of the page that is decompressed when it is opened."""
    return f'<details class="part" id="{identifier}"><summary>{title}</summary>\n{packed}</details>'


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


def legend(styles: Mapping[str, SolverStyle]) -> str:
    """One button for each solver, which shows and hides it on all charts."""
    return "\n".join(
        f'<button type="button" class="solver" aria-pressed="true" data-entry="{escape(entry)}" title="{escape(entry)}">'
        f"{_sample(style)}<span>{escape(short(entry))}</span></button>"
        for entry, style in styles.items()
    )


def _sample(style: SolverStyle) -> str:
    line = (
        f'<line x1="0" y1="8" x2="34" y2="8" stroke="{style.colour}" stroke-width="{style.width}" '
        f'stroke-dasharray="{SVG_DASHES[style.dash]}"/>'
    )
    symbol = SVG_SYMBOLS[style.symbol].replace("/>", f' fill="{style.colour}"/>')
    return f'<svg width="34" height="16" viewBox="0 0 34 16" aria-hidden="true">{line}{symbol}</svg>'
