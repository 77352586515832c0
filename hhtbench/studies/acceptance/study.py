"""``hhtbench study acceptance``: the matrix, row by row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from hhtbench.errors import NotFoundError
from hhtbench.studies.acceptance import (
    callbacks,
    convergence,
    inputs,
    linear_algebra_events,
    masses,
    method,
    options_time,
    physics,
    random_faults,
    references,
    reproducibility,
    side_effects,
    store,
)
from hhtbench.studies.acceptance.asked import ASKED, Asked
from hhtbench.studies.acceptance.rows import CORE, Outcome, Row, Verdict, rows_of

SECTIONS = (
    method,
    convergence,
    inputs,
    callbacks,
    side_effects,
    options_time,
    masses,
    physics,
    linear_algebra_events,
    reproducibility,
    random_faults,
    references,
    store,
)


@dataclass(frozen=True, kw_only=True)
class Acceptance:
    """What :func:`study_acceptance` found."""

    rows: tuple[Row, ...]
    outcomes: tuple[Outcome, ...]

    @property
    def passed(self) -> bool:
        """Whether no row fails with HHT; one that holds in part is no failure, and is told."""
        return not any(x.verdict is Verdict.fails and x.solver.startswith("hht") for x in self.outcomes)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "schema": "hhtbench.acceptance/1",
            "rows": [{"id": x.id, "goes_in": x.goes_in, "expected": x.expected, "core": x.id in CORE} for x in self.rows],
            "outcomes": [{**asdict(x), "verdict": x.verdict.name} for x in self.outcomes],
        }

    @property
    def summary(self) -> str:
        """A line a solver: how many rows hold, which in part, which fail; and which only this study measures."""
        lines = [self._line(solver) for solver in dict.fromkeys(x.solver for x in self.outcomes)]
        long = [x.id for x in self.rows if x.long]
        only = f"measured by this study only, since tests may not take so long: {', '.join(long)}"
        return "\n".join(lines + [only] * bool(long))

    def _line(self, solver: str) -> str:
        found = [x for x in self.outcomes if x.solver == solver]
        ids = {verdict: [x.id for x in found if x.verdict is verdict] for verdict in Verdict}
        some, unmeasured = ids[Verdict.in_part], ids[Verdict.elsewhere]
        line = f"{solver}: {len(ids[Verdict.holds])} rows hold"
        line += f", {len(unmeasured)} have tests of their own, not run ({', '.join(unmeasured)})" if unmeasured else ""
        line += f", {len(some)} hold in part" + (f" ({', '.join(some)})" if some else "")
        line += f", {len(ids[Verdict.fails])} fail" + (f" ({', '.join(ids[Verdict.fails])})" if ids[Verdict.fails] else "")
        return f"{line}, {len(ids[Verdict.undecided])} cannot be asked"


def all_rows() -> dict[str, Row]:
    """Every row by its id, in the matrix' order."""
    return {found.id: found for section in SECTIONS for found in rows_of(section)}


def chosen_rows(ids: Sequence[str], *, long: bool = True) -> tuple[Row, ...]:
    """Those with an id, or whose id begins with one of the letters; none given: all."""
    known = all_rows()
    for name in ids:
        if name not in known and not any(key[0] == name for key in known):
            raise NotFoundError(f"there is no row {name}; known: {', '.join(known)}.")
    picked = [x for x in known.values() if not ids or x.id in ids or x.id[0] in ids]
    return tuple(x for x in picked if long or not x.long)


def chosen_solvers(names: Sequence[str]) -> tuple[Asked, ...]:
    """The columns of these names; another name is the spec of a solver of the caller's own; none given: all."""
    known = {x.name: x for x in ASKED}
    return tuple(known.get(name) or Asked(name=name, spec=name) for name in names) if names else ASKED


def study_acceptance(
    ids: Sequence[str] = (),
    solvers: Sequence[str] = (),
    *,
    long: bool = True,
    tell: Callable[[Row, Sequence[Outcome]], None] = lambda row, outcomes: None,
) -> Acceptance:
    """Measure the rows ``ids`` with ``solvers``, one row after the other; ``tell`` hears of each.

    ``long``: with those that take minutes, among them rows that are held by tests, which are run where they are at hand.
    """
    rows, columns = chosen_rows(ids, long=long), chosen_solvers(solvers)
    outcomes: list[Outcome] = []
    for measured in rows:
        asked = columns if measured.measure else columns[:1]
        found = [measured.outcome(column, run_tests=long) for column in asked]
        tell(measured, found)
        outcomes += found
    return Acceptance(rows=rows, outcomes=tuple(outcomes))


def shown(measured: Row, outcomes: Sequence[Outcome]) -> str:
    """A row as text: its two sentences and a line a solver."""
    core = " (core)" if measured.id in CORE else ""
    lines = [f"{measured.id}{core}: {measured.goes_in}", f"    expected: {measured.expected}"]
    return "\n".join(lines + [f"    {x.verdict.value:<7} {x.solver:<13} {x.measured} [{x.seconds:.2g} s]" for x in outcomes])
