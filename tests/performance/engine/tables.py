"""Tables of machine speed, from the numbers that ``make bench-engine`` measures; the same on the page and in print."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from hhtbench.analysis import number
from hhtbench.report.tables import Cell, Table, make_table
from hhtbench.report.words import brief, seconds, shown

Line = Mapping[str, Any]
VERDICTS = ("holds", "BROKEN", "not decided", "not measured")  # of a limit


class Section(NamedTuple):
    """One table of measured lines: its heading, what is compared, and how it is laid out."""

    title: str
    text: str
    table: Callable[[Sequence[Line]], Table]


def steps_table(lines: Sequence[Line]) -> Table:
    """Time per step beside C."""
    body = [
        [
            line["scene"],
            f"{line['h']:.3g} s" if line["h"] else "by error",
            str(line["steps"]),
            seconds(line["ours_s"]),
            seconds(line["c_s"]),
            _measured(line),
            shown(line["clock"]),
            f"{brief(line['iterations'])} and {brief(line['c_iterations'])}",
            brief(line["difference"]),
            seconds(line["start_s"]),
            line["note"],
        ]
        for line in lines
    ]
    headers = ["scene", "h", "steps", "HHT, a step", "C, a step", "ratio", "on the clock", "Newton iterations a step"]
    return make_table([*headers, "ends differ by", "HHT, before the first step", "remark"], body, STEPS_NOTE)


INTERVAL = (
    "Both sides in turn, round by round: the median of the rounds' ratios of processor time, and the interval that holds it "
    "at 95 % whatever its distribution. A limit holds, or is broken, where the whole interval says so."
)
STEPS_NOTE = (
    f"{INTERVAL} The clock's ratio beside it. Iterations: HHT's and C's. The ends of both runs with constant steps differ "
    "by roundoff, relative to the largest q and v: they take the same steps. Under error control C makes a new matrix at "
    "every iteration, which filters the error too: it takes nearly the same steps."
)


def compiling_table(lines: Sequence[Line]) -> Table:
    """Compile times."""
    body = [
        [
            line["scene"],
            CACHES[line["cache"]],
            _measured(line, seconds),
            seconds(line["solve_s"]),
            seconds(line["imports_s"]),
            line["note"],
        ]
        for line in lines
    ]
    headers = ["system", "cache", "time", "the solve itself", "imports", "remark"]
    return make_table(headers, body, COMPILING_NOTE)


CACHES = {"empty": "empty", "own": "its own"}
COMPILING_NOTE = (
    "Processor time of a first solve of one step less that of a second, in new processes; their median and range. Empty "
    "cache: the first on a machine, in which a system is traced, lowered and generated. Its own cache: it is traced again."
)


def limits_table(lines: Sequence[Line]) -> Table:
    """Measured numbers with their limits."""
    body: list[list[str | Cell]] = []
    for line in lines:
        shape = {"s": seconds, "MB": lambda value: f"{value:.3g} MB"}.get(line["unit"], shown)
        body.append([line["what"], _measured(line, shape), line["note"]])
    return make_table(["what", "measured", "remark"], body)


def chains_table(lines: Sequence[Line]) -> Table:
    """Time per step beside Exudyn."""
    body = [
        [
            str(line["links"]),
            f"{line['h']:.3g} s",
            seconds(line["ours_s"]),
            Cell(seconds(line["theirs_s"]), "", line.get("solver") or ""),
            _measured(line),
            shown(line["clock"]),
            brief(line["error"]),
            brief(line["their_error"]),
            line["note"],
        ]
        for line in lines
    ]
    headers = ["links", "h", "HHT, a step", "Exudyn, a step", "ratio", "on the clock", "error of HHT", "of Exudyn", "remark"]
    note = (
        "Equal steps and damping, modified Newton on both sides, the fastest of Exudyn's linear solvers, no output files. "
    )
    note += INTERVAL
    return make_table(headers, body, f"{note} A ratio counts only where HHT's error is not clearly larger.")


def _measured(line: Line, shape: Callable[[float], str] = shown) -> Cell:
    """The figure with its interval, the limit and the verdict."""
    limit = f"limit {shape(line['limit'])}"
    value, low, high = (number(line, name) for name in ("value", "low", "high"))
    if value is None:
        return Cell("not measured", "", limit)
    tone = {"holds": "good", "BROKEN": "bad"}.get(line["verdict"], "")
    within = "" if low is None or high is None or low == high else f"{shape(low)} to {shape(high)}, {line['count']} rounds; "
    return Cell(shape(value), tone, f"{within}{limit}: {line['verdict']}")


SECTIONS = {
    "steps": Section(
        "Time per step beside hand-written C",
        "The same step, equations (H4) to (H8) with an implicit reaction, b = 0 and alpha = -0.3, once by HHT from the "
        "system in Python and once in C written by hand for this one system, with full Newton, exact derivatives and "
        "Gaussian elimination (tests/performance/pendulum_step.c, andrews_step.c), compiled with -O3 -march=native. One run "
        "is under error control, with estimate and step control by hand (pendulum_control.c).",
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
    "starts": Section(
        "What a solve costs beside its steps",
        "A solve of one step of the paper's pendulum, all of it; of an adapter what it adds to the library's own start and "
        "first step on the same functions; and one step by hand.",
        limits_table,
    ),
    "middle": Section(
        "Time of a step of middle mechanisms",
        "Under error control at rtol 1e-4: a whole run less its start and first step, over the accepted steps.",
        limits_table,
    ),
    "evaluations": Section(
        "Work of a step under error control",
        "Evaluations of the step's residual over accepted steps, the start's evaluations included: counted, not timed.",
        limits_table,
    ),
    "memory": Section(
        "Memory of a long run",
        "Peak memory of a process of its own, after a first short run and after the long one.",
        limits_table,
    ),
}
