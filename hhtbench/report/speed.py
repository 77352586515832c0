"""Tables of machine speed, from the numbers that ``make bench-engine`` measures; the same on the page and in print."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from hhtbench.analysis import RACE_TARGETS, STEADY, SUBJECT, Cost, Missing, Race, family, fronts, number, race
from hhtbench.report.tables import Cell, Table, make_table, ordered
from hhtbench.report.words import AT_MOST, NOTHING, brief, seconds, shown, times
from hhtbench.store.rows import RunRow

Line = Mapping[str, Any]
FIELDS = ("key", "problem", "solver", "request", "status", "message")
MESSAGE = 160  # characters of a failure's message that a cell shows
OPTIONAL = ("metrics", "counters", "timing")


class Section(NamedTuple):
    """One table of measured lines: its heading, what is compared, and how it is laid out."""

    title: str
    text: str
    table: Callable[[Sequence[Line]], Table]


def contest_rows(speed: Mapping[str, Any]) -> tuple[RunRow, ...]:
    """The runs of the contest."""
    runs = speed.get("runs") or []
    return tuple(_row(run) for run in runs)


def _row(run: Line) -> RunRow:
    values: dict[str, Any] = {k: run[k] for k in FIELDS} | {k: run.get(k) or {} for k in OPTIONAL}
    return RunRow(**values)


def steps_table(lines: Sequence[Line]) -> Table:
    """Time per step beside C."""
    body = [
        [
            line["scene"],
            f"{line['h']:.3g} s",
            str(line["steps"]),
            seconds(line["ours_s"]),
            seconds(line["c_s"]),
            _ratio(line, "ratio", "limit"),
            shown(line["clock_ratio"]),
            f"{brief(line['iterations'])} and {brief(line['c_iterations'])}",
            brief(line["difference"]),
            seconds(line["start_s"]),
            line["note"],
        ]
        for line in lines
    ]
    headers = ["scene", "h", "steps", "HHT, a step", "C, a step", "ratio", "on the clock", "Newton iterations a step"]
    return make_table([*headers, "ends differ by", "HHT, before the first step", "remark"], body, STEPS_NOTE)


STEPS_NOTE = (
    "Medians of processor time; the clock's ratio beside it. Iterations: HHT's and C's. The ends of both runs differ by "
    "roundoff, relative to the largest q and v: they take the same steps."
)


def compiling_table(lines: Sequence[Line]) -> Table:
    """Compile times."""
    body = [
        [
            line["scene"],
            _limited(line["empty_s"], line["limit"]),
            _limited(line["cached_s"], line["cached_limit"]),
            seconds(line["solve_s"]),
            seconds(line["imports_s"]),
            line["note"],
        ]
        for line in lines
    ]
    headers = ["system", "empty cache", "its own cache", "the solve itself", "imports", "remark"]
    return make_table(headers, body, COMPILING_NOTE)


COMPILING_NOTE = (
    "Time on the clock of a first solve of one step less that of a second, in new processes. Empty cache: the first on a "
    "machine, in which a system is traced, lowered and generated. Its own cache: it is traced again."
)


def chains_table(lines: Sequence[Line]) -> Table:
    """Time per step beside Exudyn."""
    body = [
        [
            str(line["links"]),
            f"{line['h']:.3g} s",
            seconds(line["ours_s"]),
            Cell(seconds(line["theirs_s"]), "", line.get("solver") or ""),
            _ratio(line, "ratio", "limit"),
            shown(line["clock_ratio"]),
            brief(line["error"]),
            brief(line["their_error"]),
            line["note"],
        ]
        for line in lines
    ]
    headers = ["links", "h", "HHT, a step", "Exudyn, a step", "ratio", "on the clock", "error of HHT", "of Exudyn", "remark"]
    note = "Equal steps and damping, modified Newton on both sides, the fastest of Exudyn's linear solvers, no output files."
    return make_table(headers, body, f"{note} A ratio counts only where HHT's error is not clearly larger.")


def contest_table(rows: Sequence[RunRow]) -> Table:
    """Every problem at every error: HHT, the fastest that holds the constraints, the fastest at all, the explicit method."""
    body: list[list[str | Cell]] = []
    for line in race(rows):
        rivals = [_rival(line, rival) for rival in (line.holder, line.other, line.explicit)]
        body.append([line.problem, f"{line.target:.0e}", _own(line, rows), _verdict(line), *rivals])
    headers = ["problem", "error", "HHT", f"among those with drift {AT_MOST}{STEADY:.0e}"]
    headers += ["fastest other that holds both levels", "fastest other at all", "explicit DOP853 on the underlying ODE"]
    return make_table(headers, body, CONTEST_NOTE)


CONTEST_NOTE = (
    "Processor time of one solve, best of up to five, interpolated in the logarithms between two tolerances. Below it the "
    "largest drift of position or velocity, scaled, over all steps of the run at the accurate end. The time holds the "
    "start of a solve, milliseconds for every solver, which the table below tells: short solves are mostly that."
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
            cells.append(_cost(cost) if cost else Cell(line.missing[entry].text, "bad", _failure(own, entry)))
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


def summary(rows: Sequence[RunRow]) -> list[str]:
    """What the contest says in a few sentences."""
    lines = race(rows)
    sentences = []
    for target in RACE_TARGETS:
        own = [line for line in lines if line.target == target]
        first = sum(line.best_holder is True for line in own)
        there = sum(line.subject is not None for line in own)
        explicit = sum(line.explicit_is_faster for line in own)
        factors = [1.0 / f for line in own if line.explicit_is_faster and (f := line.factor(line.explicit))]
        typical = f", typically {times(statistics.median(factors))}" if factors else ""
        sentences.append(
            f"Error {target:.0e}: of {len(own)} problems HHT reaches it on {there} and is the fastest of those that keep "
            f"both levels below {STEADY:.0e} on {first}; explicit DOP853 on the underlying ODE is faster than HHT on "
            f"{explicit}{typical}."
        )
    return sentences


def _own(line: Race, rows: Sequence[RunRow]) -> Cell:
    if line.subject is None:
        own = [(entry, reason.text) for entry, reason in line.missing.items() if family(entry) == SUBJECT]
        entry, text = own[0] if own else ("", "not run")
        return Cell(text, "bad", _failure([row for row in rows if row.problem == line.problem], entry))
    cell = _cost(line.subject)
    return cell if line.steady else cell._replace(tone="bad")


def _verdict(line: Race) -> Cell:
    if line.best_holder is None:
        return Cell("HHT drifts more" if line.subject is not None else NOTHING)
    if line.holder is None:
        return Cell(f"only HHT{_why(line.drifting)}", "good")
    factor = line.factor(line.holder) if line.steady else None
    if factor is None:
        return Cell("HHT is not there", "bad")
    return (
        Cell(f"HHT faster by {times(factor)}", "good") if factor >= 1 else Cell(f"HHT slower by {times(1 / factor)}", "bad")
    )


def _why(missing: Mapping[str, Missing]) -> str:
    kinds = [reason.kind for entry, reason in missing.items() if family(entry) != SUBJECT]
    return f" ({kinds.count('drifts')} others drift more)" if "drifts" in kinds else ""


def _rival(line: Race, rival: Cost | None) -> str | Cell:
    if rival is None:
        return NOTHING
    cell, factor = _cost(rival), line.factor(rival)
    said = "" if factor is None else f"HHT {times(1 / factor)} its time; " if factor < 1 else f"{times(factor)} HHT's time; "
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


def _ratio(line: Line, name: str, limit: str) -> Cell:
    value = number(line, name)
    if value is None:
        return Cell("not measured", "", f"limit {line[limit]:g}")
    return Cell(shown(value), "good" if line["holds"] else "bad", f"limit {line[limit]:g}")


def _limited(value: float | None, limit: float) -> Cell:
    if value is None:
        return Cell("not measured", "", f"limit {limit:g} s")
    return Cell(seconds(value), "good" if value <= limit else "bad", f"limit {limit:g} s")


SECTIONS = {
    "steps": Section(
        "Time per step beside hand-written C",
        "The same step, equations (H4) to (H8) with an implicit reaction, b = 0 and alpha = -0.3, once by HHT from the "
        "system in Python and once in C written by hand for this one system, with full Newton, exact derivatives and "
        "Gaussian elimination (tests/performance/pendulum_step.c, andrews_step.c), compiled with -O3 -march=native.",
        steps_table,
    ),
    "compiling": Section(
        "Time from a system to machine code",
        "Tracing, lowering and generating code, in a new process after the imports.",
        compiling_table,
    ),
    "chains": Section(
        "Time per step beside Exudyn",
        "A planar chain of rigid rods, let go level, with the same constant step in both codes; errors against HHT with a "
        "step sixteen times smaller.",
        chains_table,
    ),
}
