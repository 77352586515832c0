"""Tables that rank solvers: HHT against the others at every bound of the drift, the cheapest at each error."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

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
    bounded,
    outcome,
    plural,
    repeats,
    short,
    shown,
    uncounted,
    work,
)

CHEAPEST = 3  # solvers named for each error
TONES = {"wins": "good", "alone": "good", "unheld": "good", "loses": "bad", "absent": "bad"}
ANY = "any"
INTERPOLATED = (
    f"Costs are interpolated in the logarithms between two runs; {AT_MOST}: the loosest run is already more accurate."
)
COMPARED = ("wins", "loses", "level")
MARKS = {"wins": "won", "loses": "lost", "level": "level", "alone": "alone", "unheld": "others drift", "absent": "not there"}


def balance(rows: Sequence[RunRow]) -> Table:
    """On how many problems HHT wins and loses: one line for each bound of the drift and measure, one column an error."""
    body: list[list[str | Cell]] = []
    whole = campaign_of(rows)
    targets = whole.targets
    for bound in BOUNDS:
        lines = analysis.compare(rows, held=bound, campaign=whole)
        for measure in MEASURES:
            own = [line for line in lines if line.measure == measure]
            cells = [_counted([line for line in own if line.target == target]) for target in targets]
            body.append([_bound(bound), SHORT[measure], _counted(own), *cells])
    note = (
        f"Numbers of problems: {', '.join(MARKS.values())}. The best HHT entry against the cheapest of all other solvers at "
        "the same achieved error and with drift of position and velocity within the bound on both sides; with a bound, "
        "problems with constraints only. Level: within the factor by which repeats of one solve differ in "
        f"processor time, {repeats(whole.level)}. Alone: no other solver gets there, whatever "
        "it was given; not there: HHT does not, another does."
    )
    return make_table(["drift", "by", "all", *(f"error {target:.0e}" for target in targets)], body, note)


def _counted(lines: Sequence[Comparison]) -> Cell:
    """Comparisons in large print, below them who gets there alone."""
    counts = Counter(line.outcome for line in lines)
    parts = {name: f"{counts[name]} {mark}" for name, mark in MARKS.items() if counts[name]}
    both = [text for name, text in parts.items() if name in COMPARED]
    return Cell(", ".join(both) or NOTHING, "", ", ".join(text for name, text in parts.items() if name not in COMPARED))


def _bound(bound: float | None) -> str:
    return ANY if bound is None else f"{AT_MOST} {bound:.0e}"


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
                    cells = tuple(_verdict(line)._replace(detail=behind(line)) for line in own)
                    lines.setdefault(cells, []).append(_bound(bound))
            body += [[problem, SHORT[measure], ", ".join(bounds), *cells] for cells, bounds in lines.items()]
    headers = ["problem", "by", "drift", *(f"error {target:.0e}" for target in whole.targets)]
    note = (
        "The best HHT entry against the cheapest of all other solvers at the same achieved error, at three bounds of the "
        f"drift; evaluations whatever the drift. {uncounted(analysis.silent(rows))}"
    )
    return make_table(headers, body, note)


def _verdict(line: Comparison) -> Cell:
    detail = "" if line.factor is not None else behind(line)  # who the other is stands in columns of its own
    return Cell(outcome(line), TONES.get(line.outcome, ""), detail)


def both_sides(rows: Sequence[RunRow], campaign: Campaign | None = None, held: float | None = None) -> Table:
    """Both sides of every comparison on one problem at one bound of the drift, with their costs and drifts."""
    body: list[list[Any]] = []
    for line in analysis.compare(rows, held=held, campaign=campaign):
        if line.subject or line.rival:
            drifting = sum(reason.kind == "drifts" for reason in line.missing.values())
            more = [plural(drifting, "solver") if drifting else NOTHING] if held is not None else []
            body.append([*_both_sides(line), *more])
    headers = ["error", "by", "HHT", "best HHT", "its cost", "position drift", "velocity drift", "cheapest other"]
    headers += ["its cost", "position drift", "velocity drift", *(["accurate, but drift more"] if held is not None else [])]
    scope = f"Runs {bounded(held)} of position and velocity, over all steps. " if held is not None else ""
    note = f"{scope}{INTERPOLATED} Drifts are those of the run at the accurate end.{_stars(rows)}"
    return make_table(headers, body, note)


def _both_sides(line: Comparison) -> list[str | Cell]:
    sides = [cell for side in (line.subject, line.rival) for cell in _side(side, line.measure)]
    return [f"{line.target:.0e}", SHORT[line.measure], _verdict(line), *sides]


def _side(side: Cost | None, measure: str) -> list[str | Cell]:
    if side is None:
        return [NOTHING] * 4
    detail = f"{side.run.setting.text}: error {shown(side.run.error)}"
    return [Cell(side.entry, "", detail), _cost(side, measure), shown(side.run.position), shown(side.run.velocity)]


def _cost(cost: Cost, measure: str) -> str:
    """With a sign where it is an upper bound, and a star where the time was disturbed."""
    star = "*" if measure == "time" and cost.run.disturbed else ""
    return f"{AT_MOST} " * cost.bound + work(cost.value, measure) + star


def cheapest(rows: Sequence[RunRow], campaign: Campaign | None = None) -> Table:
    """Who reaches each error most cheaply on one problem."""
    targets = (campaign or campaign_of(rows)).targets
    body = []
    for measure in MEASURES:
        for front in analysis.fronts(rows, measure, targets):
            best = [f"{cost.entry} {_cost(cost, measure)}" for cost in front.costs[:CHEAPEST]]
            missing = _grouped(front.missing)
            body.append([f"{front.target:.0e}", SHORT[measure], *best, *[NOTHING] * (CHEAPEST - len(best)), missing])
    headers = ["error", "by", "cheapest", "second", "third", "without a cost"]
    note = (
        "Without a cost: every solver was refined until it got there, failed, was no better when finer, or met a stated "
        f"cap. {INTERPOLATED}{_stars(rows)} {uncounted(analysis.silent(rows))}"
    )
    return make_table(headers, body, note)


def _stars(rows: Sequence[RunRow]) -> str:
    disturbed = any(run.disturbed for run in analysis.points(rows))
    return f" *: {STAR}." if disturbed else ""


def _grouped(missing: Mapping[str, Missing]) -> str:
    """``3 a stated cap, 1 failed``; the reason itself where all share one, and of whom where it is one."""
    reasons = list(missing.values())
    texts = {reason.text for reason in reasons}
    if len(texts) == 1:
        return f"{len(reasons) if len(reasons) > 1 else short(*missing)}: {texts.pop()}"
    counts = {kind: sum(reason.kind == kind for reason in reasons) for kind in KINDS}
    return ", ".join(f"{number} {KINDS[kind]}" for kind, number in counts.items() if number) or NOTHING
