"""Kinds of problems, by what the problem is, as its rows hold it: its constraints, and whether it is declared stiff."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hhtbench.analysis.cells import problems
from hhtbench.store.rows import RunRow

CONSTRAINTS = {  # by whether there are any of positions, and of velocities; in the order of the table
    (True, False): "position constraints",
    (True, True): "position and velocity constraints",
    (False, True): "velocity constraints",
    (False, False): "no constraints",
}
UNTOLD = "constraints not recorded"  # no solver has called the problem's functions, or an older hhtbench made the rows
STIFFNESS = {False: "not stiff", True: "stiff", None: "stiffness not declared"}


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What problems that are compared together have in common."""

    constraints: str  #: one of ``CONSTRAINTS``, or ``UNTOLD``
    stiff: bool | None  #: whether the problem has this tag; None where it has no tags at all

    @property
    def text(self) -> str:
        """As a reader would say it."""
        return f"{self.constraints}, {STIFFNESS[self.stiff]}"


def kinds(rows: Sequence[RunRow]) -> dict[Kind, tuple[str, ...]]:
    """Kind -> its problems; position constraints first, what is not stiff first."""
    told = {row.problem: row.metrics["system"] for row in rows if row.metrics.get("system")}
    found: dict[Kind, list[str]] = {}
    for problem in problems(rows):
        found.setdefault(_kind(told.get(problem, {})), []).append(problem)
    order = [*CONSTRAINTS.values(), UNTOLD]
    ordered = sorted(found, key=lambda kind: (order.index(kind.constraints), list(STIFFNESS).index(kind.stiff)))
    return {kind: tuple(found[kind]) for kind in ordered}


def _kind(system: Mapping[str, Any]) -> Kind:
    m, p, tags = (system.get(name) for name in ("m", "p", "tags"))
    constraints = UNTOLD if m is None or p is None else CONSTRAINTS[m > 0, p > 0]
    return Kind(constraints=constraints, stiff="stiff" in tags if tags else None)
