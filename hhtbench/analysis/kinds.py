"""Kinds of problems, as far as rows tell: which constraints there are, and whether explicit methods lag behind."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from hhtbench.analysis.cells import entry_of, number, points, problems, state_error
from hhtbench.analysis.fronts import constrained_levels
from hhtbench.store.rows import RunRow

STIFF_AT = 1e-2  # achieved scaled error at which steps are compared: there accuracy does not yet dictate them
EXPLICIT = re.compile(r"method=(DOP853|Dopri8|Tsit5|RK45|RK23)\b")
IMPLICIT = re.compile(r"^(ida|hht)\b|method=(Radau|BDF|bdf|Kvaerno5)\b")
LEVELS = {
    (): "no constraints",
    ("velocity",): "velocity constraints",
    ("position", "velocity"): "position constraints",
    ("position",): "position constraints",
}


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What problems that are compared together have in common."""

    constraints: str  #: one of ``LEVELS``
    stiff: bool | None  #: None where no explicit, or no implicit, method has reached the error ``STIFF_AT``

    @property
    def text(self) -> str:
        """As a reader would say it."""
        return f"{self.constraints}, {STIFFNESS[self.stiff]}"


STIFFNESS = {True: "stiff", False: "not stiff", None: "stiffness unknown"}


def kinds(rows: Sequence[RunRow]) -> dict[Kind, tuple[str, ...]]:
    """Kind -> its problems; position constraints first, what is not stiff first."""
    found: dict[Kind, list[str]] = {}
    for problem in problems(rows):
        own = [row for row in rows if row.problem == problem]
        levels = constrained_levels(points(own))
        found.setdefault(Kind(constraints=LEVELS[levels], stiff=_stiff(own)), []).append(problem)
    order = ["position constraints", "velocity constraints", "no constraints"]
    ordered = sorted(found, key=lambda kind: (order.index(kind.constraints), STIFFNESS[kind.stiff]))
    return {kind: tuple(found[kind]) for kind in ordered}


def _stiff(rows: Sequence[RunRow]) -> bool | None:
    """Curtiss and Hirschfelder's definition: where implicit methods do clearly better than explicit ones, in steps."""
    controlled = [row for row in rows if row.request.get("rtol") is not None]
    explicit = _fewest_steps(row for row in controlled if EXPLICIT.search(entry_of(row)))
    implicit = _fewest_steps(row for row in controlled if IMPLICIT.search(entry_of(row)))
    return None if explicit is None or implicit is None else explicit > implicit


def _fewest_steps(rows: Iterable[RunRow]) -> float | None:
    """Of the runs that reach ``STIFF_AT``."""
    reached = [row for row in rows if row.success and (error := state_error(row)) is not None and error <= STIFF_AT]
    return min((steps for row in reached if (steps := number(row.counters, "steps_accepted"))), default=None)
