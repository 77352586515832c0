"""The table to decide by: for each kind of problem and error the cheapest solver, the second, HHT's place, who is steady."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.cells import CONSTANT, SUBJECT, family
from hhtbench.campaign.analysis.decision import Choice, Ratio, SolverCosts
from hhtbench.campaign.analysis.fronts import BOUNDS, STEADY, Campaign
from hhtbench.campaign.analysis.kinds import Kind
from hhtbench.campaign.analysis.missing import NOT_RUN, UNKNOWN
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.wording import anchor
from hhtbench.report.words import EQUAL, KINDS, MEASURES, NOTHING, plural, repeats, short, sign_of, times, work

KEPT_BY = f"keeps drift below {STEADY:.0e}"
ACCURACIES = (1e-2, 1e-4, 1e-6)  # errors in the table, where they were asked for: plain, usual and fine engineering accuracy

SAME_COST = 1.005  # factor up to which costs of one solver with and without a bound of the drift are the same

Line = list[str | Cell]
Choices = Mapping[tuple[str, float | None], Sequence[Choice]]  # by measure and bound of the drift


def reading(campaign: Campaign) -> str:
    """How the table is to be read."""
    return (
        "How to read the table: solvers are ordered by the number of problems on which they reach the error, then by the "
        "geometric mean of their costs there. A factor is a cost over that of the cheapest solver, on problems that both "
        f"reach. {EQUAL.capitalize()}: two times differ by no more than repeats of one solve, {repeats(campaign.level)}. "
        f"The last columns name the cheapest solver that {KEPT_BY}, and its factor. \N{LESS-THAN OR EQUAL TO}: the run is "
        "more accurate than asked, so the cost at this error is at most this; \N{GREATER-THAN OR EQUAL TO}: this holds for "
        "the cheapest, so the factor is at least this; \N{ALMOST EQUAL TO}: for both. Vibrations, dampers and contact are "
        "stiff where a problem's author says so; held-out problems played no part in the choice of default settings."
    )


def choices_of(rows: Sequence[RunRow], kinds: Mapping[Kind, Sequence[str]], campaign: Campaign) -> Choices:
    """What every table rests on."""
    asked = tuple(target for target in ACCURACIES if target in campaign.targets) or campaign.targets
    keys = [(measure, bound) for measure in MEASURES for bound in BOUNDS]
    return {(measure, bound): analysis.decide(rows, kinds, measure, asked, bound) for measure, bound in keys}


def decisions(choices: Choices, campaign: Campaign, held_out: Collection[str]) -> dict[tuple[str, float | None], Table]:
    """The tables, by measure and bound of the drift; ``held_out`` are problems."""
    tables = {}
    for (measure, bound), found in choices.items():
        level = campaign.level if measure == "time" else 1.0
        steady = {(choice.kind, choice.target): choice for choice in choices[measure, STEADY]}
        headers = ["kind of problem", "problems", "error", "cheapest", measure, "second", "factor"]
        headers += ["HHT", "place", "factor", "reaches", "why not all", KEPT_BY, "factor"]
        body = [_line(choice, steady.get((choice.kind, choice.target)), measure, level, held_out) for choice in found]
        kept = None if bound is None else -2  # with a bound all keep the drift
        tables[measure, bound] = make_table(headers[:kept], [line[:kept] for line in body])
    return tables


def evidence_anchor(kind: Kind) -> str:
    """Where the page compares solvers on the kind's problems one by one."""
    return anchor(f"kind-{kind.text}")


def ranked(choice: Choice) -> list[SolverCosts]:
    """All who reach the error on some problem, the best first."""
    return [place for place in choice.places if place.costs]


def best_subject(choice: Choice) -> SolverCosts | None:
    """HHT's best place; None where it was not run."""
    own = [place for place in choice.places if family(place.entry) == SUBJECT]
    return min(own, key=lambda place: (-len(place.costs), _unreached(place)), default=None)


def why(place: SolverCosts) -> str:
    """Why it does not reach what it does not, and on how many problems where not on all."""
    reasons, total = Counter(place.missing.values()), len(place.costs) + len(place.missing)
    return ", ".join(KINDS[kind] + f" on {number}" * (number < total) for kind, number in reasons.most_common())


def basis(problems: Sequence[str], held_out: Collection[str]) -> list[str]:
    """How many problems, and how many of them are held out."""
    number = sum(name in held_out for name in problems)
    return [plural(len(problems), "problem"), *[f"{number} held out"] * (number > 0)]


def _line(choice: Choice, steady: Choice | None, measure: str, level: float, held_out: Collection[str]) -> Line:
    count, *more = basis(choice.problems, held_out)
    kind = Cell(choice.kind.text, link=f"#{evidence_anchor(choice.kind)}")
    head: Line = [kind, Cell(count.split()[0], "", *more), f"{choice.target:.0e}"]
    order = ranked(choice)
    if not order:
        return [*head, _nobody(choice), *[NOTHING] * 3, *_subject(choice, order, level), *[NOTHING] * 2]
    first, *others = order
    cost = sign_of(first.at_most, False) + work(first.mean, measure)
    second = [_named(others[0]), _factor(others[0].over(first), first, level)] if others else [NOTHING] * 2
    kept = _steady(steady, first, level)
    return [*head, _named(first), cost, *second, *_subject(choice, order, level), *kept]


def _named(place: SolverCosts, *more: str) -> Cell:
    """The solver; in small print that its steps are constant, and how many problems it reaches where not all."""
    spec, constant = place.entry.removesuffix(CONSTANT), place.entry.endswith(CONSTANT)
    parts = ["constant step"] * constant + [f"reaches {reach_of(place)}"] * bool(place.missing)
    return Cell(short(spec), "", ", ".join([*parts, *filter(None, more)]))


def reach_of(place: SolverCosts) -> str:
    """``3 of 4``: on how many problems it reaches the error."""
    return f"{len(place.costs)} of {len(place.costs) + len(place.missing)}"


def _factor(ratio: Ratio | None, first: SolverCosts, level: float) -> Cell:
    """How many times dearer than the cheapest; on how many of its problems, where not on all."""
    if ratio is None:
        return Cell(NOTHING, "", "no problem in common")
    parts = [f"on {ratio.goals}"] * (ratio.goals < len(first.costs)) + [EQUAL] * ratio.within(level)
    return Cell(sign_of(ratio.at_most, ratio.at_least) + times(ratio.value), "", ", ".join(parts))


def _unreached(place: SolverCosts) -> int:
    """How many problems it is known not to reach."""
    return sum(kind not in UNKNOWN for kind in place.missing.values())


def _nobody(choice: Choice) -> str:
    open_ends = any(kind in UNKNOWN for place in choice.places for kind in place.missing.values())
    return "nobody reaches it" + ", as far as is known" * open_ends


def _subject(choice: Choice, order: Sequence[SolverCosts], level: float) -> Line:
    """HHT's best entry, its place among all who reach any, its factor, what it reaches, and why not all."""
    best = best_subject(choice)
    if best is None:
        return [Cell(KINDS[NOT_RUN]), *[NOTHING] * 4]
    name = Cell(short(best.entry.removesuffix(CONSTANT)), "", "constant step" * best.entry.endswith(CONSTANT))
    rest = [Cell(reach_of(best), "bad" * (not best.costs and _unreached(best) > 0)), Cell("", "", why(best))]
    if not best.costs:
        return [name, NOTHING, NOTHING, *rest]
    number = order.index(best) + 1
    factor = _factor(best.over(order[0]), order[0], level) if number > 1 else NOTHING
    return [name, f"{number} of {len(order)}", factor, *rest]


def _steady(choice: Choice | None, first: SolverCosts, level: float) -> Line:
    """The cheapest who keeps the drift, how many others do wherever they are asked, and its factor."""
    if choice is None:
        return ["no drift", NOTHING]
    order = ranked(choice)
    if not order:
        return [_nobody(choice), NOTHING]
    others = sum(len(place.costs) == len(choice.problems) for place in order[1:])
    more = f"and {others} more" if others else ""
    factor = times(1.0) if same_cost(order[0], first) else _factor(order[0].over(first), first, level)
    return [_named(order[0], more), factor]


def same_cost(steady: SolverCosts, first: SolverCosts) -> bool:
    """Whether the cheapest keeps the drift as it is, without a tighter setting."""
    ratio = steady.over(first)
    return steady.entry == first.entry and ratio is not None and ratio.value < SAME_COST
