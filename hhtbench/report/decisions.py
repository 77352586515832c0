"""The table to decide by: for each kind of problem and error the cheapest solver, the second, and HHT's place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from hhtbench import analysis
from hhtbench.analysis import BOUNDS, NOT_RUN, PACE, SUBJECT, Campaign, Choice, Kind, Place, family
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.wording import anchor
from hhtbench.report.words import AT_MOST, KINDS, MEASURES, NOTHING, bound_of, multiple, plural, repeats, short, work
from hhtbench.store.rows import RunRow

HEADERS = ("kind of problem", "error", "cheapest", "second", "HHT", "cheaper on some")
ACCURACIES = (1e-2, 1e-4, 1e-6)  # of the errors that were asked for: plain, usual and fine engineering accuracy


def reading(campaign: Campaign) -> str:
    """How the table is to be read."""
    return (
        "The table. Ranked are solvers of which it is known on all problems of the kind whether they get there: first by "
        "how many they reach, then by the geometric mean of their costs; one that is not reached counts at least the time "
        f"that was allowed there, or {PACE:.0e} evaluations for each second of it. Second, and HHT's place among all who "
        "get there: how many times dearer than the cheapest; level, by time: by no more than repeats of one solve differ, "
        f"{repeats(campaign.level)}. Cheaper on some: who is cheaper in the mean of those that both reach. At most: a cost "
        "is that of a run more accurate than asked; at least: one is not reached, or the cheapest's cost is at most that; "
        "about: both. Tagged stiff: by the problem's author."
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
            some = None if any(line[-1] != NOTHING for line in body) else -1  # most campaigns run everybody on all of a kind
            tables[measure, bound] = make_table(HEADERS[:some], [line[:some] for line in body])
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
        return [*head, _nobody(choice), NOTHING, _subject(choice, level, NOTHING), NOTHING]
    first, *others = choice.places
    cost = bound_of(first.at_most, first.at_least) + work(first.mean, measure)
    second = _named(others[0], _dearer(others[0], first, level)) if others else NOTHING
    cheaper = _cheaper(choice, level)
    return [*head, _named(first, cost), second, _subject(choice, level, cheaper), cheaper]


def _named(place: Place, figure: str) -> Cell:
    return Cell(short(place.entry), "", _joined(figure, _reach(place)))


def _joined(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def _dearer(place: Place, other: Place, level: float) -> str:
    """How many times dearer in the mean."""
    ratio = place.mean / other.mean
    at_most, at_least = place.at_most or other.at_least, place.at_least or other.at_most
    close = not at_most and not at_least and 1 / level <= ratio <= level
    return multiple(ratio, at_most, at_least) + ", level" * close


def _reach(place: Place) -> str:
    """On how many problems it gets there, where not on all, and why that is not known of others."""
    known = len(place.costs) + len(place.missed)
    total = known + len(place.unknown)
    reasons = Counter(place.unknown.values())
    return _joined(
        f"reaches {len(place.costs)} of {total}" if known and len(place.costs) < total else "",
        *(KINDS[kind] + f" on {number}" * (number < total) for kind, number in reasons.items()),
    )


def _nobody(choice: Choice) -> str:
    """Why there is no cheapest: of whom it is known on all problems, nobody gets there on any."""
    known = [place for place in choice.others if not place.unknown]
    return f"nobody{' known on all' * (len(known) < len(choice.others))}{' gets there' * bool(known)}"


def _subject(choice: Choice, level: float, cheaper: str | Cell) -> Cell:
    """The place of HHT's best among all solvers; where it has none, how far it gets and what is not known.

    It is praised where it is the cheapest, reaches all, and nobody is ``cheaper`` on some.
    """
    for number, place in enumerate(choice.places, 1):
        if family(place.entry) == SUBJECT:
            first = choice.places[0]
            figure = _joined(_dearer(place, first, level), _reach(place)) if number > 1 else ""
            tone = "good" if number == 1 and not place.missed and cheaper == NOTHING else ""
            return Cell(f"{number} of {len(choice.places)}", tone, _joined(figure, short(place.entry)))
    own = [place for place in choice.others if family(place.entry) == SUBJECT]
    if not own:
        return Cell(KINDS[NOT_RUN])
    best = min(own, key=lambda place: (-len(place.costs), len(place.missed)))
    return Cell(_reach(best)) if best.costs or best.unknown else Cell("does not get there", "bad")


def _cheaper(choice: Choice, level: float) -> str | Cell:
    """Of the others the one that is farthest below the cheapest on those problems that both reach, by more than level."""
    first = choice.places[0]
    pairs = [(place, *place.beside(first)) for place in (*choice.places[1:], *choice.others)]
    cheaper = [(own.mean / its.mean, place, own, its) for place, own, its in pairs if own.mean * level < its.mean]
    if not cheaper:
        return NOTHING
    _, place, own, its = min(cheaper, key=lambda found: found[0])
    return _named(place, _dearer(own, its, level))
