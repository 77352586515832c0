"""Registry of all entries: claims, families and rows, in the order in which they are listed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from types import ModuleType

from hhtbench.conformance.cell import Cell
from hhtbench.conformance.claims import conduct, control, events, failures, frames, motion
from hhtbench.conformance.entry import Entry, entries_of
from hhtbench.conformance.families import forces, long, quaternions, ranks, rods, springs
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
from hhtbench.protocol.errors import NotFoundError


def _entries(*modules: ModuleType) -> tuple[Entry, ...]:
    return tuple(entry for module in modules for entry in entries_of(module))


CLAIMS = _entries(motion, control, events, frames, conduct, failures)
FAMILIES = _entries(springs, rods, quaternions, ranks, forces, long)
SECTIONS = "MICOSPJERAK"  # letters of the acceptance matrix, in its order
ROWS = tuple(
    sorted(
        (
            *_entries(method, convergence, inputs, callbacks, options),
            *_entries(physics, derivatives_events, reproducibility, random_faults, elsewhere),
            *elsewhere.BY_TESTS,
        ),
        key=lambda entry: (SECTIONS.index(entry.id[0]), int(entry.id[1:])),
    )
)


def chosen(entries: Sequence[Entry], names: Sequence[str], what: str) -> tuple[Entry, ...]:
    """Return those of ``entries`` with these names, or rows whose id begins with one letter; all if none is given.

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
    """Return the letter of a row's section; "" for other entries."""
    return entry.id[0] if entry.goes_in else ""


def checks_of(entries: Sequence[Entry]) -> Iterator[tuple[Entry, tuple[str | Cell, ...]]]:
    """Yield entry and case of every check; of families only the small cells."""
    for entry in entries:
        for case in entry.cases():
            if not case or getattr(case[0], "small", True):
                yield entry, case
