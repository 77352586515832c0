"""Colours, marks and fonts of every figure: one place, so that a curve looks the same on every page."""

from __future__ import annotations

from collections.abc import Iterable

from hhtbench.evidence import Plot

# Okabe and Ito's palette without yellow (too pale on white): told apart with colour-blind eyes.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x", "star")
DASHES = ("solid", "dash", "dot", "dashdot")  # changes when the palette is used up

GUIDE = "#767676"
GRID = "#e4e4e4"
FINE_GRID = "#f2f2f2"
TEXT = "#222222"
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"


def style_numbers(plots: Iterable[Plot]) -> list[dict[str, int]]:
    """For each plot the style number of its curves: a label keeps its number on all plots where it is free."""
    page: dict[str, int] = {}
    numbers = []
    for plot in plots:
        own: dict[str, int] = {}
        labels = list(dict.fromkeys(curve.label for curve in plot.curves))
        for label in sorted(labels, key=lambda label: label not in page):  # stable: known labels choose first
            wanted = page.get(label)
            own[label] = wanted if wanted is not None and wanted not in own.values() else _lowest_free(own)
            page.setdefault(label, own[label])
        numbers.append(own)
    return numbers


def _lowest_free(taken: dict[str, int]) -> int:
    return next(number for number in range(len(taken) + 1) if number not in taken.values())


def marked_line(index: int) -> dict[str, dict[str, object]]:
    """Line and mark of style ``index``; the first 28 look different."""
    colour = PALETTE[index % len(PALETTE)]
    line = {"color": colour, "width": 2, "dash": DASHES[index // len(PALETTE) % len(DASHES)]}
    return {"line": line, "marker": {"color": colour, "size": 8, "symbol": SYMBOLS[index % len(SYMBOLS)]}}
