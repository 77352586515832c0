"""Newton iterations a step of HHT beside stiff springs and over mass ratios, the worst cell beside the figure."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from hhtbench.conformance.entry import Outcome
from hhtbench.conformance.stability.study import Stability
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.specs import parse_spec

SOLVER = "hht"
AXES = ("stiffness", "order", "masses")
CONTROL, LENGTH = "rtol", "h = 0.001 s"  # how the lines begin that the figures are of
FIGURES = {CONTROL: 8.0, LENGTH: 6.0}  # iterations a step at most
LIGHT_ABOVE = "masses"  # where a ratio above 1 has the light body above, whose vibrations tension carries: apart


@dataclass(frozen=True, kw_only=True)
class Effort:
    """Iterations a step of the cells of one solver that are asked for in one way."""

    solver: str
    asked: str
    light_above: bool
    steps: str  #: that are counted: "tried" or "accepted"
    mean: float  #: over all steps of all cells
    worst: float  #: of the cells
    where: str  #: the worst is met
    figure: float | None  #: None: there is none

    @property
    def verdict(self) -> str:
        """Whether the worst is within the figure."""
        return "no figure" if self.figure is None else "met" if self.worst <= self.figure else "missed"

    def __str__(self) -> str:
        most = "" if self.figure is None else f", at most {self.figure:g} asked for"
        return f"{self.head}: {self.mean:.2f} in the mean, worst {self.worst:.2f} ({self.where}){most}: {self.verdict}."

    @property
    def head(self) -> str:
        """Whose iterations, and of which steps."""
        above = ", light body above" if self.light_above else ""
        return f"{self.solver}, {'under control' if self.asked == CONTROL else self.asked}{above}, a step {self.steps}"


def efforts(found: Stability) -> list[Effort]:
    """By solver and request, of steps tried and of those accepted."""
    own = [x for x in found.measured if x.id in AXES and parse_spec(x.solver).target == SOLVER and x.attempts]
    return [
        _effort(cells, solver, asked, light, steps)
        for solver in dict.fromkeys(x.solver for x in own)
        for asked in FIGURES
        for light in (False, True)
        if (cells := [x for x in own if x.solver == solver and _asked(x, asked, light)])
        for steps in ("tried", "accepted")
    ]


def _asked(x: Outcome, asked: str, light: bool) -> bool:
    return x.line.startswith(asked) and light == (x.id == LIGHT_ABOVE and x.x > 1.0)


def _effort(cells: Iterable[Outcome], solver: str, asked: str, light: bool, steps: str) -> Effort:
    counted = [(x, x.newton_iterations or 0, _steps(x, steps)) for x in cells]
    worst, iterations, count = max(counted, key=lambda of: _per(of[1], of[2]))
    return Effort(
        solver=solver,
        asked=asked,
        light_above=light,
        steps=steps,
        mean=_per(sum(of[1] for of in counted), sum(of[2] for of in counted)),
        worst=_per(iterations, count),
        where=f"{worst.id} {worst.x:g}, {worst.line}",
        figure=None if light else FIGURES[asked],
    )


def _steps(x: Outcome, steps: str) -> int:
    return (x.attempts if steps == "tried" else x.steps) or 0


def _per(iterations: int, steps: int) -> float:
    return iterations / steps if steps else math.inf


def newton_table(found: Stability) -> Table:
    """The same as a table."""
    return make_table(["of", "in the mean", "worst", "where", "at most", ""], list(_rows(found)), NOTE)


NOTE = (
    f"Newton iterations a step on {', '.join(AXES)}: of steps tried, rejected ones with them, and over those accepted "
    "alone. Cells that have ended early count too."
)


def _rows(found: Stability) -> Iterator[list[str | Cell]]:
    tones = {"met": "good", "missed": "bad"}
    for x in efforts(found):
        most = "" if x.figure is None else f"{x.figure:g}"
        yield [
            x.head,
            f"{x.mean:.2f}",
            f"{x.worst:.2f}",
            x.where,
            most,
            Cell(x.verdict, tones.get(x.verdict, "")),
        ]
