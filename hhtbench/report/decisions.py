"""The table to decide by: for each kind of problem and error the cheapest solver, the second, and HHT's place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hhtbench import analysis
from hhtbench.analysis import BOUNDS, Campaign, Choice, Kind, Place
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.wording import anchor
from hhtbench.report.words import AT_MOST, MEASURES, NOTHING, plural, short, times, work
from hhtbench.store.rows import RunRow

ACCURACIES = (1e-2, 1e-4, 1e-6)  # of the errors that were asked for: plain, usual and fine engineering accuracy


def reading(campaign: Campaign) -> str:
    """How the table is to be read."""
    return (
        "The table. Cheapest: of those who reach the error on the most problems of the kind, the smallest geometric mean of "
        "their costs; behind it on how many problems, where not on all. Second and HHT: how many times dearer, over the "
        f"problems where both get there; level: by no more than repeats of one solve differ, {times(campaign.level)}. "
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
            level = campaign.level if measure == "time" else 1.0
            body = [_line(choice, measure, level) for choice in choices]
            tables[measure, bound] = make_table(["kind of problem", "error", "cheapest", "second", "HHT"], body)
    return tables


def evidence_anchor(kind: Kind) -> str:
    """Where the page compares solvers on the kind's problems one by one."""
    return anchor(f"kind-{kind.text}")


def told(bound: float | None) -> str:
    """A bound of the drift on a button."""
    return "any" if bound is None else f"{AT_MOST} {bound:.0e}"


def _line(choice: Choice, measure: str, level: float) -> list[str | Cell]:
    kind = Cell(choice.kind.text, "", plural(len(choice.problems), "problem"), f"#{evidence_anchor(choice.kind)}")
    head: list[str | Cell] = [kind, f"{choice.target:.0e}"]
    if not choice.places:
        return [*head, "nobody gets there", NOTHING, NOTHING]
    first, *others = choice.places
    cheapest = Cell(short(first.entry), "", f"{work(first.mean, measure)}{_some(first, choice)}")
    second = Cell(short(others[0].entry), "", _beside(others[0], choice, level)) if others else Cell(NOTHING)
    return [*head, cheapest, second, _subject(choice, level)]


def _beside(place: Place, choice: Choice, level: float) -> str:
    """How many times dearer than the cheapest, and on how many problems."""
    ratio = place.ratio(choice.places[0])
    if ratio is None:
        return f"on other problems{_some(place, choice)}"
    return f"{times(ratio)}{', level' if 1 / level <= ratio <= level else ''}{_some(place, choice)}"


def _some(place: Place, choice: Choice) -> str:
    count, all_of_them = len(place.costs), len(choice.problems)
    return "" if count == all_of_them else f", {count} of {all_of_them}"


def _subject(choice: Choice, level: float) -> Cell:
    """The place of HHT's best among all solvers."""
    own = choice.subject
    if own is None:
        return Cell("does not get there", "bad")
    place = choice.places.index(own) + 1
    beside = f"{_beside(own, choice, level)}, " if place > 1 else ""
    return Cell(f"{place} of {len(choice.places)}", "good" if place == 1 else "", f"{beside}{short(own.entry)}")
