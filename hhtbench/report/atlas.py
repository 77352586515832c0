"""The failure atlas: how the runs of a campaign failed, by solver, form, problem and accuracy, with typed causes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from hhtbench.campaign.analysis.cells import DOUBTED, points
from hhtbench.campaign.store.rows import RunRow
from hhtbench.catalogue.specs import parse_spec
from hhtbench.report.tables import Cell, Table, make_table

SILENT = "silently wrong"
TOLERANCES = 1000.0  # error over tolerance from which a success is silently wrong: motions magnify errors by up to 200
DECLINED = "declined"
COUNTED = (
    "The table counts runs by solver and form (rows) and by cause (columns). Runs that a solver declines are listed with "
    f"their problem. Silently wrong: a run that reports success but whose error exceeds {TOLERANCES:g} times its tolerance."
)


class Failure(NamedTuple):
    """Runs of one solver and form on one problem, of one decade of accuracy, that ended in the same way."""

    solver: str  #: with its options, but for the form
    form: str  #: "" where the spec names none
    problem: str
    accuracy: str  #: decade of what was asked: "rtol 1e-6", "1e3 steps"
    cause: str  #: label of the status; of a rejected result the check that fails; silently wrong
    runs: int
    reached: float | None  #: largest fraction of the interval
    message: str  #: message of the first of them


@dataclass(frozen=True, kw_only=True)
class Atlas:
    """What :func:`failure_atlas` found."""

    failures: tuple[Failure, ...]
    runs: int  #: all, declined ones left out

    def causes(self) -> Table:
        """A line a solver and form, a column a cause: how many runs."""
        counted, causes = Counter[tuple[str, str, str]](), Counter[str]()
        for x in self.failures:
            counted[x.solver, x.form, x.cause] += x.runs
            causes[x.cause] += x.runs
        named = [cause for cause, _ in causes.most_common()]
        lines = sorted({(solver, form) for solver, form, _ in counted})
        rows = [[*line, *(str(counted[*line, cause] or "") for cause in named)] for line in lines]
        note = f"{causes.total()} of {self.runs} runs failed or are silently wrong."
        return make_table(["solver", "form", *named], rows, note)

    def table(self) -> Table:
        """A line a failure, silently wrong ones first."""
        ordered = sorted(self.failures, key=lambda x: (x.cause != SILENT, x[:4]))
        rows: list[list[str | Cell]] = [
            [
                *x[:4],
                Cell(x.cause, "bad"),
                str(x.runs),
                "" if x.reached is None else f"{100 * x.reached:.3g} %",
                x.message[:120],
            ]
            for x in ordered
        ]
        return make_table(["solver", "form", "problem", "accuracy", "cause", "runs", "reached", "first message"], rows)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {"schema": "hhtbench.atlas/1", "runs": self.runs, "failures": [x._asdict() for x in self.failures]}


def failure_atlas(rows: Sequence[RunRow]) -> Atlas:
    """Every run that failed, was rejected by the check of its result, or is silently wrong."""
    groups: dict[tuple[str, str, str, str, str], list[RunRow]] = {}
    for row in rows:
        cause = cause_of(row)
        if cause not in ("", DECLINED):
            groups.setdefault((*_solver_and_form(row.solver), row.problem, _decade(row), cause), []).append(row)
    failures = []
    for kind, own in groups.items():
        reached = max((run.reached for run in points(own) if run.reached is not None), default=None)
        failures.append(Failure(*kind, runs=len(own), reached=reached, message=own[0].message))
    return Atlas(failures=tuple(failures), runs=sum(row.status != DECLINED for row in rows))


def cause_of(row: RunRow) -> str:
    """The type of a failure; "" where there is none."""
    if row.status == DOUBTED:
        return f"{DOUBTED}: {row.message.partition(':')[0]}"
    if not row.success:
        return row.status
    (run,) = points([row])
    if run.setting.kind == "rtol" and run.error is not None and run.error > TOLERANCES * run.setting.value + run.limit:
        return SILENT
    return ""


def _solver_and_form(spec: str) -> tuple[str, str]:
    found = parse_spec(spec)
    rest = ", ".join(f"{name}={value}" for name, value in found.arguments.items() if name != "form")
    return f"{found.target}({rest})" if rest else found.target, str(found.arguments.get("form", ""))


def _decade(row: RunRow) -> str:
    (run,) = points([row])
    if run.setting.kind == "rtol":
        return f"rtol 1e{math.floor(math.log10(run.setting.value) + 0.5)}"
    if run.setting.kind == "steps":
        return f"1e{math.floor(0.5 - math.log10(run.setting.value))} steps"
    return run.setting.text
