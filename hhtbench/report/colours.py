"""Colours, marks and fonts of every figure: one place, so that a curve looks the same on every page."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from hhtbench.campaign.analysis.cells import SUBJECT, family
from hhtbench.protocol.evidence import Plot

# Okabe and Ito's palette without yellow (too pale on white): distinct also for colour-blind readers.
PALETTE = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
SYMBOLS = ("circle", "square", "diamond", "triangle-up", "cross", "x", "star")
DASHES = ("solid", "dash", "dot", "dashdot")  # changes when the palette is used up

# Solvers: a family has one colour, fixed for every report; its variants differ in shade, dash and mark.
FAMILIES = {
    "hht": "#0072B2",
    "generalised_alpha": "#56B4E9",
    "hht_i3": "#8C564B",
    "rattle": "#7F8C00",
    "ida": "#D55E00",
    "cvode": "#CC79A7",
    "scipy": "#009E73",
    "projected": "#E69F00",
    "collocation": "#7A5195",
    "diffrax": "#4D4D4D",
}
OTHER_FAMILIES = ("#17BECF", "#9E2A2B", "#5B8C5A", "#B8860B")
SHADES = (0.0, -0.4, 0.35)  # below 0 towards black, above 0 towards white

GUIDE = "#767676"
GRID = "rgba(128, 128, 128, 0.22)"  # as good on a dark page
FINE_GRID = "rgba(128, 128, 128, 0.1)"
TEXT = "#222222"
FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Helvetica Neue', Arial, sans-serif"


def style_numbers(plots: Iterable[Plot]) -> list[dict[str, int]]:
    """For each plot the style number of its curves: a label keeps its number on all plots where it is free."""
    page: dict[str, int] = {}
    numbers = []
    for plot in plots:
        own: dict[str, int] = {}
        labels = dict.fromkeys(curve.label for curve in plot.curves)
        for label in sorted(labels, key=lambda label: label not in page):  # stable: known labels choose first
            free = next(number for number in range(len(own) + 1) if number not in own.values())
            wanted = page.setdefault(label, free)
            own[label] = free if wanted in own.values() else wanted
        numbers.append(own)
    return numbers


@dataclass(frozen=True, kw_only=True)
class SolverStyle:
    """How one solver looks on every plot of a report."""

    colour: str
    dash: str
    symbol: str
    width: float

    @property
    def line(self) -> dict[str, Any]:
        """As plotly wants it."""
        return {"color": self.colour, "dash": self.dash, "width": self.width}


def plot_style(number: int) -> SolverStyle:
    """Style of that number on the page of a verification; the first 28 look different."""
    colour, dash = PALETTE[number % len(PALETTE)], DASHES[number // len(PALETTE) % len(DASHES)]
    return SolverStyle(colour=colour, dash=dash, symbol=SYMBOLS[number % len(SYMBOLS)], width=2.0)


def solver_order(entries: Iterable[str]) -> tuple[str, ...]:
    """The one order of solvers: the known families first, then others by name."""
    known = list(FAMILIES)

    def place(entry: str) -> tuple[int, str, str]:
        name = family(entry)
        return (known.index(name) if name in known else len(known), name, entry)

    return tuple(sorted(set(entries), key=place))


def solver_styles(entries: Iterable[str]) -> dict[str, SolverStyle]:
    """The look of every solver, in :func:`solver_order`; the first 12 variants of a family have different lines."""
    ordered = solver_order(entries)
    foreign = [name for name in dict.fromkeys(map(family, ordered)) if name not in FAMILIES]
    colours = FAMILIES | {name: OTHER_FAMILIES[i % len(OTHER_FAMILIES)] for i, name in enumerate(foreign)}
    styles: dict[str, SolverStyle] = {}
    for entry in ordered:
        index = sum(family(other) == family(entry) for other in styles)
        styles[entry] = SolverStyle(
            colour=_shaded(colours[family(entry)], SHADES[index % len(SHADES)]),
            dash=DASHES[index % len(DASHES)],
            symbol=SYMBOLS[index % len(SYMBOLS)],
            width=3.0 if family(entry) == SUBJECT else 1.8,
        )
    return styles


def _shaded(colour: str, shade: float) -> str:
    parts = [int(colour[i : i + 2], 16) for i in (1, 3, 5)]
    target = 255 if shade > 0 else 0
    return "#" + "".join(f"{round(part + abs(shade) * (target - part)):02x}" for part in parts)
