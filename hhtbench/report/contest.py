"""Tables that rank solvers: HHT against the others, the price of drift, the cheapest at each error."""

from __future__ import annotations

from collections.abc import Sequence

from hhtbench import analysis
from hhtbench.analysis import HELD, HELD_TARGETS, Comparison, Cost
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.words import AT_MOST, MEASURES, NOTHING, STAR, outcome, plural, shown, uncounted, work
from hhtbench.store.rows import RunRow

CHEAPEST = 3  # solvers named for each error
TONES = {"wins": "good", "alone": "good", "unheld": "good", "loses": "bad", "absent": "bad"}
SHORT = {"time": "wall time", "evaluations": "evaluations"}
INTERPOLATED = (
    f"Costs are interpolated in the logarithms between two runs; {AT_MOST}: the loosest run is already more accurate."
)


def against(rows: Sequence[RunRow]) -> Table:
    """HHT against the cheapest other solver: one line for each problem and measure, one column for each error."""
    groups: dict[tuple[str, str], list[Comparison]] = {}
    for line in analysis.compare(rows):
        groups.setdefault((line.problem, line.measure), []).append(line)
    body: list[list[str | Cell]] = [
        [problem, SHORT[measure], *(_verdict(line, rival=True) for line in group)]
        for (problem, measure), group in groups.items()
    ]
    headers = ["problem", "by", *(f"error {target:.0e}" for target in analysis.TARGETS)]
    note = (
        "The best HHT entry against the cheapest of all other solvers at the same achieved error. Not tried: no finer run "
        f"was asked for, and errors still fell. {uncounted(analysis.silent(rows))}"
    )
    return make_table(headers, body, note)


def _verdict(line: Comparison, rival: bool = False) -> Cell:
    detail = ""
    if rival and line.rival is not None and line.factor is not None:
        detail = f"against {line.rival.entry}"
    return Cell(outcome(line), TONES.get(line.outcome, ""), detail)


def price_of_drift(rows: Sequence[RunRow], problem: str) -> Table:
    """Both sides of every comparison on one problem, with their costs and drifts."""
    lines = [line for line in analysis.compare(rows) if line.problem == problem and (line.subject or line.rival)]
    body = [_both_sides(line) for line in lines]
    headers = ["error", "by", "HHT", "best HHT", "its cost", "position drift", "velocity drift"]
    headers += ["cheapest other", "its cost", "position drift", "velocity drift"]
    note = f"{INTERPOLATED} Drifts are those of the run at the accurate end.{_stars(rows, problem)}"
    return make_table(headers, body, note)


def steady(rows: Sequence[RunRow], problem: str) -> Table:
    """The same among runs that also hold the constraints: what a small drift costs at equal accuracy."""
    lines = [line for line in analysis.compare(rows, targets=HELD_TARGETS, held=HELD) if line.problem == problem]
    body = []
    for line in lines:
        drifting = sum(reason.kind == "drifts" for reason in line.missing.values())
        body.append([*_both_sides(line, settings=True), plural(drifting, "solver") if drifting else NOTHING])
    headers = ["error", "by", "HHT", "best HHT", "its cost", "position drift", "velocity drift", "cheapest steady other"]
    headers += ["its cost", "position drift", "velocity drift", "accurate, but drift more"]
    note = (
        f"Only runs whose position and velocity drift both stay within {HELD:.0e} over the whole interval count, on both "
        f"sides, so that no solver looks steady because it was run far more accurately. {INTERPOLATED}"
        f"{_stars(rows, problem)}"
    )
    return make_table(headers, body, note)


def _both_sides(line: Comparison, settings: bool = False) -> list[str | Cell]:
    sides = [cell for side in (line.subject, line.rival) for cell in _side(side, line.measure, settings)]
    return [f"{line.target:.0e}", SHORT[line.measure], _verdict(line), *sides]


def _side(side: Cost | None, measure: str, settings: bool) -> list[str | Cell]:
    if side is None:
        return [NOTHING] * 4
    detail = f"{side.run.setting.text}: error {shown(side.run.error)}" if settings else ""
    return [Cell(side.entry, "", detail), _cost(side, measure), shown(side.run.position), shown(side.run.velocity)]


def _cost(cost: Cost, measure: str) -> str:
    """With a sign where it is an upper bound, and a star where the time was disturbed."""
    star = "*" if measure == "time" and cost.run.disturbed else ""
    return f"{AT_MOST} " * cost.bound + work(cost.value, measure) + star


def cheapest(rows: Sequence[RunRow], problem: str) -> Table:
    """Who reaches each error most cheaply."""
    own = [row for row in rows if row.problem == problem]
    body = []
    for measure in MEASURES:
        for front in analysis.fronts(own, measure):
            best = [f"{cost.entry} {_cost(cost, measure)}" for cost in front.costs[:CHEAPEST]]
            missing = _grouped(list(front.missing.values()))
            body.append([f"{front.target:.0e}", SHORT[measure], *best, *[NOTHING] * (CHEAPEST - len(best)), missing])
    headers = ["error", "by", "cheapest", "second", "third", "without a cost"]
    note = (
        "Not tried: finer settings were not asked for. Failed: refused, failed, or no better at finer settings. "
        f"{INTERPOLATED}{_stars(own, problem)} {uncounted(analysis.silent(own))}"
    )
    return make_table(headers, body, note)


def _stars(rows: Sequence[RunRow], problem: str) -> str:
    disturbed = any(run.disturbed for run in analysis.points(rows) if run.problem == problem)
    return f" *: {STAR}." if disturbed else ""


KINDS = {"untried": "not tried", "fails": "failed", "uncounted": "not reported", "unjudged": "cannot be judged"}


def _grouped(reasons: list[analysis.Missing]) -> str:
    """``3 not tried, 1 failed``; the reason itself where all share one."""
    texts = {reason.text for reason in reasons}
    if len(texts) == 1:
        return f"{len(reasons)}: {texts.pop()}"
    counts = {kind: sum(reason.kind == kind for reason in reasons) for kind in KINDS}
    return ", ".join(f"{number} {KINDS[kind]}" for kind, number in counts.items() if number) or NOTHING
