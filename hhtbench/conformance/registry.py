"""Every entry, in the order in which they are listed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from hhtbench.conformance.cell import Cell
from hhtbench.conformance.claims import conduct, control, events, failures, frames, motion
from hhtbench.conformance.entry import Entry, entries_of
from hhtbench.conformance.families.forces import contact, friction, jump, wrong_a0
from hhtbench.conformance.families.long import long_run
from hhtbench.conformance.families.modes import multiplier_modes
from hhtbench.conformance.families.quaternions import quaternions
from hhtbench.conformance.families.ranks import dead_points, rank, redundant
from hhtbench.conformance.families.recurrence import amplification
from hhtbench.conformance.families.rods import masses, origin, perturbations, ratios, span, tension, units
from hhtbench.conformance.families.springs import dampers, order, servo, spin, steps, stiffness
from hhtbench.conformance.rows import (
    callbacks,
    convergence,
    derivatives_events,
    elsewhere,
    inputs,
    method,
    options,
    physics,
    random_faults,
    reproducibility,
)
from hhtbench.errors import NotFoundError

CLAIMS = tuple(entry for module in (motion, control, events, frames, conduct, failures) for entry in entries_of(module))
FAMILIES = (
    amplification,
    perturbations,
    multiplier_modes,
    wrong_a0,
    stiffness,
    order,
    dampers,
    servo,
    spin,
    quaternions,
    masses,
    tension,
    steps,
    ratios,
    rank,
    redundant,
    dead_points,
    jump,
    friction,
    contact,
    origin,
    span,
    units,
    long_run,
)
SECTIONS = "MICOSPJERAK"  # letters of the acceptance matrix, in its order
_MEASURED = (
    *(method, convergence, inputs, callbacks, options),
    *(physics, derivatives_events, reproducibility, random_faults, elsewhere),
)
ROWS = tuple(
    sorted(
        (*(entry for module in _MEASURED for entry in entries_of(module)), *elsewhere.BY_TESTS),
        key=lambda entry: (SECTIONS.index(entry.id[0]), int(entry.id[1:])),
    )
)


def chosen(entries: Sequence[Entry], names: Sequence[str], what: str) -> tuple[Entry, ...]:
    """Those of ``entries`` with these names, or a row whose id begins with one letter; none given: all.

    Raises
    ------
    NotFoundError
        A name is none of an entry; the text calls it ``what``.
    """
    known = {entry.id: entry for entry in entries}
    for name in names:
        if name not in known and not any(_section(entry) == name for entry in entries):
            raise NotFoundError(f"there is no {what} {name}; known: {', '.join(known)}.")
    return tuple(entry for entry in entries if not names or entry.id in names or _section(entry) in names)


def _section(entry: Entry) -> str:
    """The letter of a row."""
    return entry.id[0] if entry.goes_in else ""


def checks_of(entries: Sequence[Entry]) -> Iterator[tuple[Entry, tuple[str | Cell, ...]]]:
    """Entry and case of every check that they make, of families the small cells."""
    for entry in entries:
        for case in entry.cases():
            if not case or getattr(case[0], "small", True):
                yield entry, case
