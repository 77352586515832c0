"""The figures of one page: plotly and all data are embedded once, compressed, and nothing is fetched.

Parts of a page are compressed one by one and opened when a reader asks for them, so that the page appears at once.
plotly-basic.min.js.gz is the small bundle of plotly.js 4.1.1, the version that plotly.py writes for; it has all kinds of
curves that are drawn here.  From ``npm pack plotly.js-basic-dist-min@4.1.1``, licence within.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Iterator, Mapping
from html import escape
from importlib.resources import files
from itertools import count
from typing import Any

import plotly.graph_objects as go

from hhtbench.report.elements import prose

LIBRARY = "plotly-basic.min.js.gz"
MIN_SHARED = 12  # characters: a text at least so long is stored once in a part, whatever the number of its uses


class Drawings:
    """Leaves a box in the place of each figure; the data comes with :meth:`packed`, or with :meth:`scripts`."""

    def __init__(self, numbers: Iterator[int] | None = None) -> None:
        self._numbers = numbers or count()
        self._figures: dict[int, Any] = {}

    def part(self) -> Drawings:
        """Figures of a part of the same page, numbered on."""
        return Drawings(self._numbers)

    def box(self, figure: go.Figure | Mapping[str, Any], height: int | None = None) -> str:
        """The element that the figure is drawn into; ``height`` [px] where the page's style gives none."""
        style = "" if height is None else f' style="height:{height}px"'
        return f'<div class="plot" data-figure="{self.add(figure)}"{style}></div>'

    def views(self, named: Mapping[str, tuple[Any, str]]) -> str:
        """Buttons, the element that the first figure is drawn into, and captions; a button's name -> figure, its caption."""
        numbers = [self.add(figure) for figure, _ in named.values()]
        buttons = "".join(
            f'<button type="button" data-figure="{number}" aria-pressed="{str(number == numbers[0]).lower()}">'
            f"{escape(name)}</button>"
            for number, name in zip(numbers, named, strict=True)
        )
        captions = "\n".join(
            f'<p class="caption" data-figure="{number}"{"" if number == numbers[0] else " hidden"}>{prose(caption)}</p>'
            for number, (_, caption) in zip(numbers, named.values(), strict=True)
        )
        group = f'<div class="views" role="group" aria-label="Views">{buttons}</div>\n' if len(numbers) > 1 else ""
        return f'{group}<div class="plot" data-figure="{numbers[0]}"></div>\n{captions}'

    def add(self, figure: go.Figure | Mapping[str, Any]) -> int:
        """The number by which the page's script finds the figure."""
        number = next(self._numbers)
        self._figures[number] = json.loads(figure.to_json()) if isinstance(figure, go.Figure) else figure
        return number

    def packed(self, identifier: str = "", html: str = "") -> str:
        """An element with the figures and ``html``, which the page's script shows in its place; no text in it is markup."""
        texts: dict[str, int] = {}
        figures = _compact(self._figures, texts)
        data = json.dumps({"figures": figures, "html": html, "texts": list(texts)}, separators=(",", ":"), allow_nan=False)
        named = f' id="{identifier}"' if identifier else ""
        return f'<script type="application/gzip"{named}>{_encoded(gzip.compress(data.encode(), mtime=0))}</script>'

    def scripts(self, script: str) -> str:
        """The figures, the library, and ``script``, a module that finds figures by their numbers in ``figures``."""
        library = _encoded(files("hhtbench.report").joinpath(LIBRARY).read_bytes())
        return f"""\
{self.packed("figures")}
<script type="application/gzip" id="plotly">{library}</script>
<script type="module">
{_text("tables.js")}
{_text("drawings.js")}
{script}</script>"""


def _encoded(content: bytes) -> str:
    return base64.b64encode(content).decode()


def _text(name: str) -> str:
    return files("hhtbench.report").joinpath(name).read_text(encoding="utf-8")


def _compact(value: Any, texts: dict[str, int]) -> Any:
    """The same with null for numbers that JSON has not, and a long text by its place in ``texts``, which grows."""
    if isinstance(value, Mapping):
        return {name: _compact(part, texts) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_compact(part, texts) for part in value]
    if isinstance(value, str) and len(value) >= MIN_SHARED:
        return {"$": texts.setdefault(value, len(texts))}
    return None if isinstance(value, float) and not math.isfinite(value) else value
