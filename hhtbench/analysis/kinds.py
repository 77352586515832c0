"""Kinds of problems, by what the problem is, as its rows hold it: its constraints, and whether it is tagged as stiff."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hhtbench.store.rows import RunRow

CONSTRAINTS = {  # by whether there are any of positions, and of velocities; in the order of the table
    (True, False): "position constraints",
    (True, True): "position and velocity constraints",
    (False, True): "velocity constraints",
    (False, False): "no constraints",
}
UNTOLD = (
    "constraints not recorded"  # in no row: no solver has called the problem's functions, or an older hhtbench made them
)
STIFFNESS = {False: "not tagged stiff", True: "tagged stiff", None: "stiffness not recorded"}


@dataclass(frozen=True, kw_only=True)
class Kind:
    """What problems that are compared together have in common."""

    constraints: str  #: one of ``CONSTRAINTS``, or ``UNTOLD``
    stiff: bool | None  #: whether the problem has this tag; None where no row holds its tags

    @property
    def text(self) -> str:
        """As a reader would say it."""
        return f"{self.constraints}, {STIFFNESS[self.stiff]}"


def kinds(rows: Sequence[RunRow]) -> dict[Kind, tuple[str, ...]]:
    """Kind -> its problems; position constraints first, what is not tagged first."""
    told: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        told.setdefault(row.problem, []).append(row.metrics.get("system") or {})
    found: dict[Kind, list[str]] = {}
    for problem, systems in told.items():
        found.setdefault(_kind(systems), []).append(problem)
    order = [*CONSTRAINTS.values(), UNTOLD]
    ordered = sorted(found, key=lambda kind: (order.index(kind.constraints), list(STIFFNESS).index(kind.stiff)))
    return {kind: tuple(found[kind]) for kind in ordered}


def _kind(systems: Sequence[Mapping[str, Any]]) -> Kind:
    """Of one problem: from any row that holds its sizes, and from any that holds its tags."""
    sizes = next(((one["m"], one["p"]) for one in systems if None not in (one.get("m"), one.get("p"))), None)
    tags = next((one["tags"] for one in systems if one.get("tags") is not None), None)
    constraints = UNTOLD if sizes is None else CONSTRAINTS[sizes[0] > 0, sizes[1] > 0]
    return Kind(constraints=constraints, stiff=None if tags is None else "stiff" in tags)
