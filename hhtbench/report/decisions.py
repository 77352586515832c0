"""The table to decide by: for each kind of problem and error the cheapest solver, the second, and HHT's place."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import SUBJECT, family
from hhtbench.campaign.analysis.decision import Choice, Place, Ratio
from hhtbench.campaign.analysis.fronts import BOUNDS, Campaign
from hhtbench.campaign.analysis.kinds import Kind
from hhtbench.campaign.analysis.missing import NOT_RUN, UNKNOWN
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.wording import anchor
from hhtbench.report.words import AT_MOST, KINDS, MEASURES, NOTHING, bound_of, multiple, plural, repeats, short, work

HEADERS = ("kind of problem", "error", "cheapest", "second", "HHT", "cheaper on some")
ACCURACIES = (1e-2, 1e-4, 1e-6)  # of the errors that were asked for: plain, usual and fine engineering accuracy


def reading(campaign: Campaign) -> str:
    """How the table is to be read."""
    return (
        "The table. Solvers in order: first by how many problems of the kind they reach at the error, then by the geometric "
        "mean of their costs there. Second, and HHT's place among all that reach any: how many times dearer than the "
        "cheapest on the problems that both reach; level, by time: by no more than repeats of one solve differ, "
        f"{repeats(campaign.level)}. Cheaper on some: who costs less where both get there. At most: a "
        "cost is that of a run more accurate than asked; at least: the cheapest's is; about: both are, and the ratio may be "
        "off either way. Tagged: by the problem's author."
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
    ranked = [place for place in choice.places if place.costs]
    if not ranked:
        return [*head, _nobody(choice), NOTHING, _subject(choice, ranked, level), NOTHING]
    first, *others = ranked
    cheapest = _named(first, bound_of(first.at_most, False) + work(first.mean, measure))
    second = _named(others[0], _dearer(others[0].over(first), len(first.costs), level)) if others else NOTHING
    return [*head, cheapest, second, _subject(choice, ranked, level), _cheaper(ranked, level)]


def _named(place: Place, figure: str) -> Cell:
    return Cell(short(place.entry), "", _joined(figure, _reach(place)))


def _joined(*parts: str) -> str:
    return ", ".join(filter(None, parts))


def _dearer(ratio: Ratio | None, total: int, level: float) -> str:
    """How many times dearer than the cheapest, which reaches ``total`` problems."""
    if ratio is None:
        return "on other problems"
    told = multiple(ratio.value, ratio.at_most, ratio.at_least) + f" on {ratio.goals}" * (ratio.goals < total)
    return told + ", level" * ratio.within(level)


def _reach(place: Place) -> str:
    """How many problems it reaches, where not all, and why not the others."""
    if not place.missing:
        return ""
    return f"reaches {len(place.costs)} of {len(place.costs) + len(place.missing)}, {_why(place)}"


def _why(place: Place) -> str:
    """Why it does not reach what it does not, and on how many problems where not on all."""
    reasons, total = Counter(place.missing.values()), len(place.costs) + len(place.missing)
    return ", ".join(KINDS[kind] + f" on {number}" * (number < total) for kind, number in reasons.most_common())


def _unreached(place: Place) -> int:
    """How many problems it is known not to reach."""
    return sum(kind not in UNKNOWN for kind in place.missing.values())


def _nobody(choice: Choice) -> str:
    open_ends = any(kind in UNKNOWN for place in choice.places for kind in place.missing.values())
    return "nobody gets there" + ", as far as is known" * open_ends


def _subject(choice: Choice, ranked: Sequence[Place], level: float) -> Cell:
    """The place of HHT's best among all who reach any; where it has none, why."""
    own = [place for place in choice.places if family(place.entry) == SUBJECT]
    if not own:
        return Cell(KINDS[NOT_RUN])
    best = min(own, key=lambda place: (-len(place.costs), _unreached(place)))
    if not best.costs:
        return Cell("does not get there", "bad", _why(best)) if _unreached(best) else Cell(_why(best))
    number = ranked.index(best) + 1
    if number > 1:
        figure = _dearer(best.over(ranked[0]), len(ranked[0].costs), level)
        return Cell(f"{number} of {len(ranked)}", "", _joined(figure, _reach(best), short(best.entry)))
    beside = [ratio for place in ranked[1:] if (ratio := place.over(best))]
    second = ranked[1].over(best) if len(ranked) > 1 else None
    unclear = second is not None and second.at_most
    near = any(ratio.value <= level for ratio in beside)
    tone = "" if best.missing or unclear or near else "good"
    shared = "level" * (second is not None and second.within(level))
    return Cell(f"{number} of {len(ranked)}", tone, _joined(shared, _reach(best), short(best.entry)))


def _cheaper(ranked: Sequence[Place], level: float) -> str | Cell:
    """Who is farthest below the cheapest, which reaches others, where both get there, by more than level."""
    first = ranked[0]
    beside = [(place, ratio) for place in ranked[1:] if (ratio := place.over(first)) and not ratio.at_least]
    cheaper = [(ratio.value, place, ratio) for place, ratio in beside if ratio.value * level < 1]
    if not cheaper:
        return NOTHING
    _, place, ratio = min(cheaper, key=lambda found: found[0])
    return _named(place, _dearer(ratio, len(first.costs), level))
