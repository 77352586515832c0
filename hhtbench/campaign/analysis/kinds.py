"""Group problems by kind: by their constraints and their author's tags, as the rows store them.

A reaction that is nonlinear in the multipliers is a kind of its own: ODE forms decline it, which says nothing about them
on other problems.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from hhtbench.campaign.store.rows import RunRow

CONSTRAINTS = {  # by whether there are any of positions, and of velocities; in the order of the table
    (True, False): "position constraints",
    (True, True): "position and velocity constraints",
    (False, True): "velocity constraints",
    (False, False): "no constraints",
}
UNKNOWN = "constraints not recorded"  # no solver has called the problem's functions, or an older hhtbench made the rows
NONLINEAR = "nonlinear reaction"  # the tag
SMOOTH, VIBRATIONS, DAMPERS, CONTACT = "not stiff", "stiff vibrations", "stiff dampers", "contact"
UNTOLD = "stiffness not recorded"  # no row holds the problem's tags
FORCES = (SMOOTH, VIBRATIONS, DAMPERS, CONTACT, UNTOLD)  # what decides on a method, in the order of the table


@dataclass(frozen=True, kw_only=True)
class Kind:
    """Properties shared by problems that are compared together."""

    constraints: str  #: one of ``CONSTRAINTS``, or ``UNKNOWN``
    nonlinear: bool = False  #: whether the problem has the tag ``NONLINEAR``
    forces: str  #: one of ``FORCES``

    @property
    def text(self) -> str:
        """Name of the kind for a reader."""
        return ", ".join([self.constraints, *[NONLINEAR] * self.nonlinear, self.forces])


def kinds(rows: Sequence[RunRow]) -> dict[Kind, tuple[str, ...]]:
    """Map each kind to its problems; position constraints come first, forces in the order of ``FORCES``."""
    systems_of: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        systems_of.setdefault(row.problem, []).append(row.metrics.get("system") or {})
    found: dict[Kind, list[str]] = {}
    for problem, systems in systems_of.items():
        found.setdefault(_kind(systems), []).append(problem)
    order = [*CONSTRAINTS.values(), UNKNOWN]
    by = {kind: (order.index(kind.constraints), kind.nonlinear, FORCES.index(kind.forces)) for kind in found}
    return {kind: tuple(found[kind]) for kind in sorted(found, key=lambda kind: by[kind])}


def _kind(systems: Sequence[Mapping[str, Any]]) -> Kind:
    """Return the kind of one problem from any row that holds its sizes and any that holds its tags."""
    sizes = next(((one["m"], one["p"]) for one in systems if None not in (one.get("m"), one.get("p"))), None)
    tags = next((one["tags"] for one in systems if one.get("tags") is not None), None)
    constraints = UNKNOWN if sizes is None else CONSTRAINTS[sizes[0] > 0, sizes[1] > 0]
    return Kind(constraints=constraints, nonlinear=NONLINEAR in (tags or ()), forces=_forces(tags))


def _forces(tags: Collection[str] | None) -> str:
    """Return what is stiff in a problem with these tags: bodies that bend have fast vibrations too."""
    if tags is None:
        return UNTOLD
    if "contact" in tags:
        return CONTACT
    if not {"stiff", "flexible"} & {*tags}:
        return SMOOTH
    return DAMPERS if "damped" in tags else VIBRATIONS
