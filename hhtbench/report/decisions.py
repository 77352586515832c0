"""The table to decide by: for each kind of problem and error the cheapest solver, the second, and HHT's place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hhtbench import analysis
from hhtbench.analysis import BOUNDS, SUBJECT, Campaign, Choice, Kind, Place, family
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.wording import anchor
from hhtbench.report.words import AT_MOST, MEASURES, NOTHING, multiple, plural, short, times, work
from hhtbench.store.rows import RunRow

HEADERS = ("kind of problem", "error", "cheapest", "second", "HHT", "cheaper on some")
ACCURACIES = (1e-2, 1e-4, 1e-6)  # of the errors that were asked for: plain, usual and fine engineering accuracy


def reading(campaign: Campaign) -> str:
    """How the table is to be read."""
    seconds, evaluations = (campaign.allowed(measure) for measure in MEASURES)
    return (
        "The table. Ranked are solvers that were run on all problems of the kind, by the geometric mean of their costs; a "
        f"problem on which one does not get there counts {seconds:g} s, or {evaluations:.0e} evaluations, and how many it "
        "reaches is told. Second, and HHT's place among all who get there: how many times dearer than the cheapest; level, "
        f"by time: by no more than repeats of one solve differ, {times(campaign.level)}. Cheaper on some: who was run on a "
        f"part of the problems only, and is cheaper there. {AT_MOST}, at most, at least: by runs more accurate than asked. "
        "Stiff: as the problem is tagged."
    )


def decisions(
    rows: Sequence[RunRow], kinds: Mapping[Kind, Sequence[str]], campaign: Campaign
) -> dict[tuple[str, float | None], Table]:
    """(measure, bound of the drift) -> the table."""
    asked = tuple(target for target in ACCURACIES if target in campaign.targets) or campaign.targets
    tables = {}
    for measure in MEASURES:
        for bound in BOUNDS:
            choices = analysis.decide(rows, kinds, measure, asked, bound, campaign)
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
        return [*head, _nobody(choice), NOTHING, _subject(choice, level), NOTHING]
    first, *others = choice.places
    cost = f"{f'{AT_MOST} ' * first.bound}{work(first.mean, measure)}{_reaches(first, choice)}"
    second = Cell(short(others[0].entry), "", _beside(others[0], choice, level)) if others else Cell(NOTHING)
    return [*head, Cell(short(first.entry), "", cost), second, _subject(choice, level), _cheaper(choice, level)]


def _nobody(choice: Choice) -> str:
    """Why there is no cheapest."""
    if choice.partial:
        return (
            "nobody who was run on all gets there" if any(_on_all(p, choice) for p in choice.others) else "nobody run on all"
        )
    return "nobody gets there" if any(place.missed for place in choice.others) else "unknown"


def _on_all(place: Place, choice: Choice) -> bool:
    return len(place.counted) == len(choice.problems)


def _beside(place: Place, choice: Choice, level: float) -> str:
    """How many times dearer than the cheapest, and on how many problems it gets there."""
    first = choice.places[0]
    ratio = place.ratio(first)
    if ratio is None:
        return ""
    close = ", level" if 1 / level <= ratio <= level else ""
    return f"{multiple(ratio, place.bound, first.bound)}{close}{_reaches(place, choice)}"


def _reaches(place: Place, choice: Choice) -> str:
    """On how many problems it gets there, and was run, where not on all."""
    reached, run, total = len(place.costs), len(place.counted), len(choice.problems)
    return f"{f', reaches {reached} of {run}' * (reached < run)}{f', run on {run} of {total}' * (run < total)}"


def _subject(choice: Choice, level: float) -> Cell:
    """The place of HHT's best among all solvers; where it has none, why."""
    for number, place in enumerate(choice.places, 1):
        if family(place.entry) == SUBJECT:
            beside = f"{_beside(place, choice, level)}, " if number > 1 else ""
            text = f"{number} of {len(choice.places)}"
            return Cell(text, "good" if number == 1 else "", f"{beside}{short(place.entry)}")
    own = [place for place in choice.others if family(place.entry) == SUBJECT]
    if any(place.costs for place in own):
        run = max(len(place.counted) for place in own if place.costs)
        return Cell(f"run on {run} of {len(choice.problems)}")
    if any(place.missed for place in own):
        return Cell("does not get there", "bad")
    return Cell("unknown" if own else "not run")


def _cheaper(choice: Choice, level: float) -> str | Cell:
    """Of those who were not run on all problems the one that is farthest below the cheapest where both were."""
    compared = [(ratio, place) for place in choice.partial if (ratio := place.ratio(choice.places[0])) is not None]
    ratio, best = min(compared, key=lambda pair: pair[0], default=(1.0, None))
    return NOTHING if best is None or ratio >= 1 else Cell(short(best.entry), "", _beside(best, choice, level))
