"""``hhtbench study acceptance``: measure the rows of the acceptance matrix with every requested solver."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from hhtbench.conformance.entry import Entry, Kind, Lane, Outcome, as_known
from hhtbench.conformance.registry import ROWS, chosen
from hhtbench.conformance.subject import COLUMNS, Subject


@dataclass(frozen=True, kw_only=True)
class Acceptance:
    """Result of :func:`study_acceptance`."""

    rows: tuple[Entry, ...]
    outcomes: tuple[Outcome, ...]

    @property
    def passed(self) -> bool:
        """True if no row fails with HHT; a row that holds in part, or is known to fail, is no failure."""
        return all(x.kind.good for x in self.outcomes if x.solver.startswith("hht"))

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, for JSON."""
        return {
            "schema": "hhtbench.acceptance/2",
            "rows": [{"id": x.id, "goes_in": x.goes_in, "expected": x.sentence, "lane": x.lane.name} for x in self.rows],
            "outcomes": [{**asdict(x), "kind": x.kind.name} for x in self.outcomes],
        }

    @property
    def summary(self) -> str:
        """One line per solver with the number of rows by outcome; then the rows that only this study measures."""
        lines = [self._line(solver) for solver in dict.fromkeys(x.solver for x in self.outcomes)]
        slow = [x.id for x in self.rows if x.lane is Lane.slow]
        only = f"in the slow lane: {', '.join(slow)}"
        return "\n".join(lines + [only] * bool(slow))

    def _line(self, solver: str) -> str:
        found = [x for x in self.outcomes if x.solver == solver]
        ids = {kind: [x.id for x in found if x.kind is kind] for kind in Kind}
        hold, declined = len(ids.pop(Kind.right)), len(ids.pop(Kind.declined))
        others = [f"{len(x)} {kind.label} ({', '.join(x)})" for kind, x in ids.items() if x]
        return ", ".join([f"{solver}: {hold} rows hold", *others, f"{declined} cannot be asked"])


def chosen_rows(ids: Sequence[str], *, slow: bool = True) -> tuple[Entry, ...]:
    """Return the rows with these ids, or whose id begins with one of these letters; all if none is given."""
    return tuple(x for x in chosen(ROWS, ids, "row") if slow or x.lane is not Lane.slow)


def measured(row: Entry, subject: Subject, *, timed: bool = True, run_tests: bool = False) -> Outcome:
    """Measure a row with a solver; a row that is known to fail must fail."""
    cases, reason = row.known_of(subject)
    return as_known(row.run(subject, timed=timed, run_tests=run_tests), reason, cases)


def study_acceptance(
    ids: Sequence[str] = (),
    solvers: Sequence[str] = (),
    *,
    slow: bool = True,
    tell: Callable[[Entry, Sequence[Outcome]], None] = lambda row, outcomes: None,
) -> Acceptance:
    """Measure the rows ``ids`` with ``solvers``, one row after the other; ``tell`` is called after each.

    ``slow``: include rows that take minutes, among them rows covered by tests, which are run if they are present.
    """
    rows, columns = chosen_rows(ids, slow=slow), [Subject.column(name) for name in solvers or COLUMNS]
    outcomes: list[Outcome] = []
    for row in rows:
        asked = columns if row.measure else columns[:1]
        found = [measured(row, subject, run_tests=slow) for subject in asked]
        tell(row, found)
        outcomes += found
    return Acceptance(rows=rows, outcomes=tuple(outcomes))


def shown(row: Entry, outcomes: Sequence[Outcome]) -> str:
    """Format a row: its input, the expectation, and one line per solver."""
    lines = [f"{row.id}: {row.goes_in}", f"    expected: {row.sentence}"]
    lines += [f"    {x.kind.label:<17} {x.solver:<13} {x.message} [{x.seconds:.2g} s]" for x in outcomes]
    return "\n".join(lines)
