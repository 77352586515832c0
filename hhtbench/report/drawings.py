"""The figures of one page: plotly and all data are embedded once, packed, and nothing is fetched.

plotly-basic.min.js.gz is the small bundle of plotly.js 4.1.1, the version that plotly.py writes for; it has all kinds of
curves that are drawn here.  From ``npm pack plotly.js-basic-dist-min@4.1.1``, licence within.
"""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Mapping
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
import plotly.graph_objects as go

LIBRARY = "plotly-basic.min.js.gz"


class Drawings:
    """Leaves a box in the place of each figure; their data comes with :meth:`scripts`, at the end of the page."""

    def __init__(self) -> None:
        self._figures: list[Any] = []

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
            f'<p class="caption" data-figure="{number}"{"" if number == numbers[0] else " hidden"}>{escape(caption)}</p>'
            for number, (_, caption) in zip(numbers, named.values(), strict=True)
        )
        group = f'<div class="views" role="group" aria-label="Views">{buttons}</div>\n' if len(numbers) > 1 else ""
        return f'{group}<div class="plot" data-figure="{numbers[0]}"></div>\n{captions}'

    def add(self, figure: go.Figure | Mapping[str, Any]) -> int:
        """The number by which the page's script finds the figure."""
        self._figures.append(json.loads(figure.to_json()) if isinstance(figure, go.Figure) else figure)
        return len(self._figures) - 1

    def scripts(self, script: str) -> str:
        """Data, library, and ``script``, a module that finds the figures in ``figures``; no name in the data is markup."""
        data = json.dumps(_finite(self._figures), separators=(",", ":"), default=_typed, allow_nan=False).encode()
        packed = {"figures": gzip.compress(data, mtime=0), "plotly": files("hhtbench.report").joinpath(LIBRARY).read_bytes()}
        elements = [
            f'<script type="application/gzip" id="{name}">{base64.b64encode(content).decode()}</script>'
            for name, content in packed.items()
        ]
        shared = "\n".join(map(_text, ("tables.js", "drawings.js")))  # tables need not wait for the library
        return "\n".join([*elements, f'<script type="module">\n{shared}\n{script}</script>'])


def _text(name: str) -> str:
    return files("hhtbench.report").joinpath(name).read_text(encoding="utf-8")


def _finite(value: Any) -> Any:
    """The same with null for numbers that JSON has not; arrays as they are, plotly leaves gaps in them."""
    if isinstance(value, Mapping):
        return {name: _finite(part) for name, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _typed(array: np.ndarray) -> dict[str, str]:
    """An array of floating-point numbers as plotly packs it."""
    if array.dtype not in (np.float32, np.float64):
        raise TypeError(f"arrays of figures must be float32 or float64; got {array.dtype}.")
    return {"dtype": f"f{array.itemsize}", "bdata": base64.b64encode(array.tobytes()).decode()}
