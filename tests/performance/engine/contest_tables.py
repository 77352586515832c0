"""The contest on the page of machine speed: every problem at every error, HHT beside the fastest others."""

from __future__ import annotations

import statistics
from collections.abc import Collection, Mapping, Sequence
from typing import Any

from hhtbench.analysis import NOT_RUN, RACE_TARGETS, STEADY, SUBJECT, Cost, Missing, Race, family, fronts, number, race
from hhtbench.report.tables import Cell, Table, make_table, ordered
from hhtbench.report.words import AT_MOST, NOTHING, brief, seconds, times
from hhtbench.store.rows import RunRow

Line = Mapping[str, Any]
FIELDS = ("problem", "solver", "request", "status", "message")
MESSAGE = 160  # characters of a failure's message that a cell shows
OPTIONAL = ("metrics", "counters", "timing")


def contest_rows(speed: Mapping[str, Any]) -> tuple[RunRow, ...]:
    """The runs of the contest."""
    runs = speed.get("runs") or []
    return tuple(_row(str(index), run) for index, run in enumerate(runs))


def _row(key: str, run: Line) -> RunRow:
    values: dict[str, Any] = {k: run[k] for k in FIELDS} | {k: run.get(k) or {} for k in OPTIONAL}
    return RunRow(key=key, **values)


def contest_table(rows: Sequence[RunRow], duels: Sequence[Line] = ()) -> Table:
    """Every problem at every error: HHT, the fastest that holds the constraints, the fastest at all, the explicit method."""
    compared = {(duel["problem"], duel["target"], duel["kind"]): duel for duel in duels}
    body: list[list[str | Cell]] = []
    for line in race(rows):
        own = {kind: compared.get((line.problem, line.target, kind)) for kind in RIVALS}
        rivals = [_rival(line, getattr(line, kind), own[kind]) for kind in RIVALS]
        body.append([line.problem, f"{line.target:.0e}", _own(line, rows), _verdict(line, own["holder"]), *rivals])
    headers = ["problem", "error", "HHT", f"among those with drift {AT_MOST}{STEADY:.0e}"]
    headers += ["fastest other that holds both levels", "fastest other at all", "explicit DOP853 on the underlying ODE"]
    return make_table(headers, body, CONTEST_NOTE)


RIVALS = ("holder", "other", "explicit")
CONTEST_NOTE = (
    "Processor time of one solve, the best of all, interpolated in the logarithms between two tolerances. Below it the "
    "largest drift of position or velocity, scaled, over all steps of the run at the accurate end. The time holds the "
    "start of a solve, milliseconds for every solver, which the table below tells: short solves are mostly that. Who is "
    "faster is decided by solves taken in turn: the median of the rounds' ratios, its interval at 95 %, and how many rounds "
    "there were; not decided where the interval holds 1. Not run: the time of the section did not suffice, "
    "or the solver was a hundred times behind HHT at the tolerance before."
)


def everyone_table(rows: Sequence[RunRow], problem: str) -> Table:
    """Every solver on one problem: its time at every error, or why there is none; drift; where the time goes."""
    own = [row for row in rows if row.problem == problem]
    lines = fronts(own, "time", RACE_TARGETS)
    entries = dict.fromkeys(entry for line in lines for entry in (*(c.entry for c in line.costs), *line.missing))
    body: list[list[str | Cell]] = []
    for entry in entries:
        cells: list[str | Cell] = [entry]
        for line in lines:
            cost = next((cost for cost in line.costs if cost.entry == entry), None)
            cells.append(_cost(cost) if cost else _absent(line.missing[entry], own, entry))
        body.append([*cells, _share(own, entry)])
    headers = ["solver", *(f"error {target:.0e}" for target in RACE_TARGETS), "of its time: equations, their wrapper"]
    return make_table(headers, ordered(body))


def shares_table(rows: Sequence[RunRow]) -> Table:
    """Where the time of every solver goes: medians over the problems."""
    starts: dict[str, list[float]] = {}
    found: dict[str, list[Line]] = {}
    for row in rows:
        if (start := number(row.timing, "start_s")) is not None:
            starts.setdefault(row.solver, []).append(start)
        if row.timing.get("callbacks"):
            found.setdefault(row.solver, []).append(row.timing["callbacks"])
    body: list[list[str | Cell]] = []
    for solver in dict.fromkeys([*starts, *found]):
        count = max(len(starts.get(solver, ())), len(found.get(solver, ())))
        start = statistics.median(starts[solver]) if solver in starts else None
        body.append([solver, str(count), seconds(start), *_parts(found.get(solver, []))])
    headers = [
        "solver",
        "problems",
        "start and one step",
        "in the equations",
        "counting and copying",
        "elsewhere",
        "one call",
    ]
    note = (
        "Shares of the time of one solve, its start included: checks of the problem, the consistent accelerations and the "
        "multipliers of the output. HHT calls no equations from outside: they are part of its own loop."
    )
    return make_table(headers, ordered(body), note)


def _parts(shares: Sequence[Line]) -> list[str]:
    """Shares in per cent and the time of one call."""
    if not shares:
        return [NOTHING] * 4
    inside, around, each = (statistics.median(s[k] for s in shares) for k in ("functions", "guards", "microseconds"))
    return [*(f"{part:.0%}" for part in (inside, around, 1.0 - inside - around)), f"{each:.3g} \N{MICRO SIGN}s"]


def summary(rows: Sequence[RunRow], duels: Sequence[Line] = ()) -> list[str]:
    """What the contest says in a few sentences; a comparison that is not decided counts for nobody."""
    open_ones = {(duel["problem"], duel["target"], duel["kind"]) for duel in duels if duel["verdict"] == UNDECIDED}
    return [_said([line for line in race(rows) if line.target == target], target, open_ones) for target in RACE_TARGETS]


def _said(lines: Sequence[Race], target: float, open_ones: Collection[tuple[str, float, str]]) -> str:
    """One error."""
    there = sum(line.subject is not None for line in lines)
    not_run = sum(_not_run(line) for line in lines)
    left = f", was not run that far on {not_run}," if not_run else ""
    compared = [line for line in lines if line.best_holder is True or line.holder is not None]
    among = [line for line in compared if (line.problem, target, "holder") not in open_ones]
    undecided = len(compared) - len(among)
    first = sum(line.best_holder is True for line in among)
    said = f" (not decided on {undecided})" if undecided else ""
    explicit = [line for line in lines if line.explicit_is_faster and (line.problem, target, "explicit") not in open_ones]
    factors = [1.0 / factor for line in explicit if (factor := line.factor(line.explicit))]
    typical = f", typically {times(statistics.median(factors))}" if factors else ""
    return (
        f"Error {target:.0e}: of {len(lines)} problems HHT reaches it on {there}{left} and is the fastest of those that "
        f"keep both levels below {STEADY:.0e} on {first}{said}; explicit DOP853 on the underlying ODE is faster than HHT on "
        f"{len(explicit)}{typical}."
    )


def _absent(reason: Missing, rows: Sequence[RunRow], entry: str) -> Cell:
    """Why ``entry`` has no cost; in red only where it was asked for it."""
    return Cell(reason.text) if reason.kind == NOT_RUN else Cell(reason.text, "bad", _failure(rows, entry))


def _own_missing(line: Race) -> tuple[str, Missing] | None:
    """HHT's entry that came nearest, and why it has no cost: one not run before one that failed."""
    own = [(entry, reason) for entry, reason in line.missing.items() if family(entry) == SUBJECT]
    return min(own, key=lambda one: one[1].kind != NOT_RUN, default=None)


def _not_run(line: Race) -> bool:
    missing = _own_missing(line)
    return line.subject is None and (missing is None or missing[1].kind == NOT_RUN)


def _own(line: Race, rows: Sequence[RunRow]) -> Cell:
    if line.subject is None:
        missing = _own_missing(line)
        own = [row for row in rows if row.problem == line.problem]
        return Cell("not run") if missing is None else _absent(missing[1], own, missing[0])
    cell = _cost(line.subject)
    return cell if line.steady else cell._replace(tone="bad")


def _verdict(line: Race, duel: Line | None) -> Cell:
    if _not_run(line):
        return Cell("HHT was not run")
    if line.best_holder is None:
        return Cell("HHT drifts more" if line.subject is not None else NOTHING)
    if line.holder is None:
        return Cell(f"only HHT{_why(line.drifting)}", "good")
    factor = line.factor(line.holder) if line.steady else None
    if factor is None:
        return Cell("HHT is not there", "bad")
    if duel is None or duel["verdict"] == UNDECIDED:
        return Cell(UNDECIDED, "", _interval(duel))
    if duel["verdict"] == "faster":
        return Cell(f"HHT faster by {times(duel['value'])}", "good", _interval(duel))
    return Cell(f"HHT slower by {times(1 / duel['value'])}", "bad", _interval(duel))


UNDECIDED = "not decided"


def _interval(duel: Line | None) -> str:
    """The rival's time over HHT's, by the rounds of both; "" where there were none."""
    if duel is None or duel["value"] is None:
        return ""
    held = "" if duel["low"] is None or duel["high"] is None else f", {brief(duel['low'])} to {brief(duel['high'])}"
    return f"{duel['rival']}: {brief(duel['value'])} times HHT's{held} in {duel['count']} rounds"


def _why(missing: Mapping[str, Missing]) -> str:
    kinds = [reason.kind for entry, reason in missing.items() if family(entry) != SUBJECT]
    return f" ({kinds.count('drifts')} others drift more)" if "drifts" in kinds else ""


def _rival(line: Race, rival: Cost | None, duel: Line | None) -> str | Cell:
    if rival is None:
        return NOTHING
    cell, factor = _cost(rival), line.factor(rival)
    if duel is not None and duel["rival"] == rival.entry and duel["value"]:
        factor = duel["value"]
    said = "" if factor is None else f"HHT {times(1 / factor)} its time; " if factor < 1 else f"{times(factor)} HHT's time; "
    said = f"{UNDECIDED}: {said}" if duel is not None and duel["verdict"] == UNDECIDED else said
    return cell._replace(text=f"{rival.entry} {cell.text}", detail=said + cell.detail)


def _cost(cost: Cost) -> Cell:
    drift = max(cost.run.position or 0.0, cost.run.velocity or 0.0)
    known = cost.run.position is not None or cost.run.velocity is not None
    bound = f"{AT_MOST} " if cost.bound else ""
    return Cell(f"{bound}{seconds(cost.value)}", "", f"drift {brief(drift)}" if known else "drift not measured")


def _failure(rows: Sequence[RunRow], entry: str) -> str:
    """The message of the last run of ``entry`` that failed, shortened; "" where none did."""
    messages = [row.message for row in rows if row.solver == entry and not row.success]
    return messages[-1][:MESSAGE] if messages else ""


def _share(rows: Sequence[RunRow], entry: str) -> str:
    found = [row.timing["callbacks"] for row in rows if row.solver == entry and row.timing.get("callbacks")]
    return f"{found[-1]['functions']:.0%}, {found[-1]['guards']:.0%}" if found else NOTHING
