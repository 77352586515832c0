"""The legend of the comparison's page: one button for each solver, which shows and hides it on all charts."""

from __future__ import annotations

from html import escape

from hhtbench.report.colours import SolverStyle
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


def legend(styles: dict[str, SolverStyle]) -> str:
    """The buttons in the order of solvers."""
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
