"""The table to decide by: for each kind of problem and error the cheapest solver, the second, and HHT's place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hhtbench import analysis
from hhtbench.analysis import BOUNDS, SUBJECT, Campaign, Choice, Kind, Place, family
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.wording import anchor
from hhtbench.report.words import AT_MOST, MEASURES, NOTHING, plural, short, times, work
from hhtbench.store.rows import RunRow

ACCURACIES = (1e-2, 1e-4, 1e-6)  # of the errors that were asked for: plain, usual and fine engineering accuracy
READING = (
    "The table. Cheapest: of those who reach the error on the most problems of the kind, the smallest geometric mean of "
    "their costs; behind it on how many problems, where not on all. Second and HHT: how many times dearer, over the "
    "problems where both get there. "
    "Stiff: at an error of 1e-02 explicit methods take more steps than implicit ones."
)


def decisions(
    rows: Sequence[RunRow], kinds: Mapping[Kind, Sequence[str]], campaign: Campaign
) -> dict[tuple[str, float | None], Table]:
    """(measure, bound of the drift) -> the table."""
    asked = tuple(target for target in ACCURACIES if target in campaign.targets) or campaign.targets
    tables = {}
    for measure in MEASURES:
        for bound in BOUNDS:
            choices = analysis.decide(rows, kinds, measure, asked, bound)
            body = [_line(choice, measure) for choice in choices]
            tables[measure, bound] = make_table(["kind of problem", "error", "cheapest", "second", "HHT"], body)
    return tables


def evidence_anchor(kind: Kind) -> str:
    """Where the page compares solvers on the kind's problems one by one."""
    return anchor(f"kind-{kind.text}")


def told(bound: float | None) -> str:
    """A bound of the drift on a button."""
    return "any" if bound is None else f"{AT_MOST} {bound:.0e}"


def _line(choice: Choice, measure: str) -> list[str | Cell]:
    kind = Cell(choice.kind.text, "", plural(len(choice.problems), "problem"), f"#{evidence_anchor(choice.kind)}")
    head: list[str | Cell] = [kind, f"{choice.target:.0e}"]
    if not choice.places:
        return [*head, "nobody gets there", NOTHING, NOTHING]
    first, *others = choice.places
    second = _beside(others[0], first, choice) if others else Cell(NOTHING)
    return [*head, Cell(short(first.entry), "", _mean(first, choice, measure)), second, _subject(choice, first)]


def _mean(place: Place, choice: Choice, measure: str) -> str:
    return f"{work(place.mean, measure)}{_some(place, choice)}"


def _some(place: Place, choice: Choice) -> str:
    count, all_of_them = len(place.costs), len(choice.problems)
    return "" if count == all_of_them else f", {count} of {all_of_them}"


def _beside(place: Place, first: Place, choice: Choice) -> Cell:
    return Cell(short(place.entry), "", f"{_ratio(place, first)}{_some(place, choice)}")


def _ratio(place: Place, first: Place) -> str:
    ratio = place.ratio(first)
    return "on other problems" if ratio is None else times(ratio)


def _subject(choice: Choice, first: Place) -> Cell:
    """HHT's place among the solvers, each counted by its best."""
    own = choice.subject
    if own is None:
        return Cell("does not get there", "bad")
    place = choice.places.index(own) + 1
    text = f"{place} of {len(choice.places)}"
    if family(first.entry) == SUBJECT:
        return Cell(text, "good", short(own.entry))
    return Cell(text, "", f"{_ratio(own, first)}{_some(own, choice)}, {short(own.entry)}")
