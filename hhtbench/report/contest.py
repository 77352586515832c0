"""Tables that rank solvers: HHT against the others at every bound of the drift, the cheapest at each error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from hhtbench.campaign import analysis
from hhtbench.campaign.analysis.fronts import BOUNDS, Campaign, Comparison, Cost, campaign_of
from hhtbench.campaign.analysis.missing import Missing
from hhtbench.campaign.store.rows import RunRow
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.words import (
    AT_MOST,
    KINDS,
    MEASURES,
    NOTHING,
    SHORT,
    STAR,
    behind,
    bound_label,
    outcome,
    repeats,
    short,
    uncounted,
    work,
)

CHEAPEST = 3  # solvers named for each error
TONES = {"wins": "good", "alone": "good", "unheld": "good", "loses": "bad", "absent": "bad"}
INTERPOLATED = f"Log costs are interpolated between two runs; {AT_MOST}: the loosest run is more accurate than asked."
COMPARED = ("wins", "loses", "level")
MARKS = {
    "wins": "won",
    "loses": "lost",
    "level": "equal",
    "alone": "only HHT",
    "unheld": "others drift",
    "absent": "only others",
}


def balance(rows: Sequence[RunRow]) -> Table:
    """On how many problems HHT wins and loses: lines for each measure and bound of the drift; a column an error.

    Bounds that change nothing share a line.
    """
    whole = campaign_of(rows)
    targets = whole.targets
    bounds: dict[tuple[str | Cell, ...], list[str]] = {}
    for bound in BOUNDS:
        lines = analysis.compare(rows, held=bound, campaign=whole)
        for measure in MEASURES:
            own = [line for line in lines if line.measure == measure]
            cells = [_counted([line for line in own if line.target == target]) for target in targets]
            bounds.setdefault((SHORT[measure], _counted(own), *cells), []).append(bound_label(bound))
    body = [[", ".join(found), *cells] for cells, found in bounds.items()]
    note = (
        "Number of problems on which HHT's best entry is cheaper (won) or dearer (lost) than the cheapest other solver at "
        "one achieved error. A bound of the drift of position and velocity holds for both sides. Equal: times differ by no "
        f"more than repeats of one solve, {repeats(whole.level)}. Only HHT, only others: the other side does not reach the "
        "error; others drift: they reach it with more drift."
    )
    return make_table(["drift", "by", "all", *(f"error {target:.0e}" for target in targets)], body, note)


def _counted(lines: Sequence[Comparison]) -> Cell:
    """Comparisons in large print, below them who alone reaches the error."""
    counts = Counter(line.outcome for line in lines)
    parts = {name: f"{counts[name]} {mark}" for name, mark in MARKS.items() if counts[name]}
    both = [text for name, text in parts.items() if name in COMPARED]
    return Cell(", ".join(both) or NOTHING, "", ", ".join(text for name, text in parts.items() if name not in COMPARED))


def against(rows: Sequence[RunRow], campaign: Campaign | None = None) -> Table:
    """HHT against the cheapest other solver: lines for each problem, bound of the drift and measure; a column an error.

    Bounds that change nothing share a line.
    """
    body: list[list[str | Cell]] = []
    whole = campaign or campaign_of(rows)
    compared = {bound: analysis.compare(rows, held=bound, campaign=whole) for bound in BOUNDS}
    for problem in analysis.problems(rows):
        for measure in MEASURES:
            lines: dict[tuple[Cell, ...], list[str]] = {}
            for bound in BOUNDS if measure == "time" else BOUNDS[:1]:
                own = [line for line in compared[bound] if (line.problem, line.measure) == (problem, measure)]
                if own:
                    cells = tuple(Cell(outcome(line), TONES.get(line.outcome, ""), behind(line)) for line in own)
                    lines.setdefault(cells, []).append(bound_label(bound))
            body += [[problem, SHORT[measure], ", ".join(bounds), *cells] for cells, bounds in lines.items()]
    headers = ["problem", "by", "drift", *(f"error {target:.0e}" for target in whole.targets)]
    note = (
        "HHT's best entry and the cheapest other solver at the same achieved error, by time at three bounds of the drift, "
        f"by evaluations whatever the drift. {uncounted(analysis.silent(rows))}"
    )
    return make_table(headers, body, note)


def _cost(cost: Cost, measure: str) -> str:
    """With a sign where it is an upper bound, and a star where the time was disturbed."""
    star = "*" if measure == "time" and cost.run.disturbed else ""
    return f"{AT_MOST} " * cost.bound + work(cost.value, measure) + star


def cheapest(rows: Sequence[RunRow], campaign: Campaign | None = None) -> Table:
    """The cheapest solvers, and HHT's best, at each error on one problem."""
    targets = (campaign or campaign_of(rows)).targets
    body = []
    for measure in MEASURES:
        for front in analysis.fronts(rows, measure, targets):
            best = [f"{cost.entry} {_cost(cost, measure)}" for cost in front.costs[:CHEAPEST]]
            best += [NOTHING] * (CHEAPEST - len(best))
            subject = f"{front.subject.entry} {_cost(front.subject, measure)}" if front.subject else NOTHING
            body.append([f"{front.target:.0e}", SHORT[measure], *best, subject, _grouped(front.missing)])
    headers = ["error", "by", "cheapest", "second", "third", "best HHT", "without a cost"]
    note = (
        "Without a cost: solvers that do not reach the error, and why. "
        f"{INTERPOLATED}{_stars(rows)} {uncounted(analysis.silent(rows))}"
    )
    return make_table(headers, body, note)


def _stars(rows: Sequence[RunRow]) -> str:
    disturbed = any(run.disturbed for run in analysis.points(rows))
    return f" *: {STAR}." if disturbed else ""


def _grouped(missing: Mapping[str, Missing]) -> str:
    """``3 limit of the campaign, 1 fails``; the reason itself where all share one, with the solver where it is one."""
    reasons = list(missing.values())
    texts = {reason.text for reason in reasons}
    if len(texts) == 1:
        return f"{len(reasons) if len(reasons) > 1 else short(*missing)}: {texts.pop()}"
    counts = {kind: sum(reason.kind == kind for reason in reasons) for kind in KINDS}
    return ", ".join(f"{number} {KINDS[kind]}" for kind, number in counts.items() if number) or NOTHING
