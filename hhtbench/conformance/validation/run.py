"""Validate problems: run them by every pair of solver and form, compare, judge."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path

from hhtbench.campaign.campaign import Progress, run_campaign
from hhtbench.campaign.execute import machine_limits
from hhtbench.campaign.reference.plan import registered_plans, validated_spec
from hhtbench.campaign.store import Store
from hhtbench.catalogue.registry import list_problems, load_problem
from hhtbench.catalogue.specs import canonical
from hhtbench.conformance.validation.agreement import Compared, agreement_rows, compare_rows, matrix_text
from hhtbench.conformance.validation.plan import MAKERS, MAX_SECONDS, validation_campaign
from hhtbench.conformance.validation.table import solvability
from hhtbench.conformance.validation.verdict import Verdict, evidence_rows, judge
from hhtbench.protocol.evidence import Evidence, Row

HARD = {  # tags that excuse fewer pairs: what the solvers meet there is stated in the problem's own page
    "singular": "it passes through positions where its constraints lose rank",
    "nonlinear reaction": "its reaction is nonlinear in lam, so solvers of the underlying ODE decline it",
}


@dataclass(frozen=True, kw_only=True)
class Validated:
    """Result of :func:`validate`."""

    text: str  #: the tables, as Markdown
    evidence: Evidence  #: a claim a row


def validate(
    problems: tuple[str, ...],
    file: Path | None = None,
    jobs: int | None = None,
    max_seconds: float = MAX_SECONDS,
    progress: Progress | None = None,
) -> Validated:
    """Solve ``problems`` (specs; none: the whole library, on the spans of their plans) with many solvers and compare.

    Parameters
    ----------
    file
        Store of the rows, which is resumed; None: they are not kept.
    jobs
        Worker processes; None: one per core.
    max_seconds
        Time limit of one solve [s].
    progress
        Called with the part that is running, the number done and the number in all.
    """
    plan = {} if problems else registered_plans()
    specs = problems or tuple(validated_spec(name, plan) for name in list_problems())
    loaded = {canonical(spec): load_problem(spec) for spec in specs}
    campaign = validation_campaign(specs, max_seconds)
    with tempfile.TemporaryDirectory() as folder, Store(file or Path(folder) / "validation.sqlite") as store:
        rows = run_campaign(campaign, store, limits=machine_limits(jobs), timing=False, progress=progress).rows
    compared = [compare_rows(spec, problem, rows) for spec, problem in loaded.items()]
    verdicts = judge(row for entry in compared for row in entry.rows)
    command = "hhtbench validate " + (" ".join(f'"{spec}"' for spec in problems) if problems else "--all")
    matrices = [matrix_text(entry) for entry in compared] if problems else []  # for the whole library they would be too many
    reasons = {spec: " and ".join(HARD[tag] for tag in HARD if tag in problem.tags) for spec, problem in loaded.items()}
    return Validated(
        text="\n".join([solvability(verdicts, command), *matrices]),
        evidence=Evidence(title="validation", rows=tuple(_claims(compared, verdicts, reasons))),
    )


def _claims(compared: list[Compared], verdicts: list[Verdict], reasons: dict[str, str]) -> list[Row]:
    """Return claims about problems with a known solution, and about those judged by agreement only."""
    alone = {entry.problem for entry in compared if not entry.known}
    known = [verdict for verdict in verdicts if verdict.problem not in alone]
    rows = evidence_rows(known, reasons, frozenset(map(canonical, MAKERS)))
    for entry in compared:
        if not entry.known:
            rows += agreement_rows(entry, verdicts)
    return rows
