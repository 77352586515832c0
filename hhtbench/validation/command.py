"""The command ``hhtbench validate``."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import click

from hhtbench.campaign.campaign import run_campaign
from hhtbench.campaign.command import terminal_progress
from hhtbench.campaign.execute import machine_limits
from hhtbench.evidence import Evidence, Row
from hhtbench.output import FAILED, json_option, require_folder
from hhtbench.reference.plan import registered_plans, validated_spec
from hhtbench.registry import list_problems, load_problem
from hhtbench.specs import canonical
from hhtbench.store import RunRow, Store
from hhtbench.validation.agreement import Compared, agreement_rows, compare_rows, matrix_text
from hhtbench.validation.plan import MAKERS, MAX_SECONDS, validation_campaign
from hhtbench.validation.table import solvability
from hhtbench.validation.verdict import Verdict, evidence_rows, judge

HARD = {  # tags that excuse fewer pairs: what the solvers meet there is stated in the problem's own page
    "singular": "it passes through positions where its constraints lose rank",
    "nonlinear reaction": "its reaction is nonlinear in lam, so solvers of the underlying ODE decline it",
}


@click.command("validate")
@click.argument("problems", nargs=-1)
@click.option("--all", "every", is_flag=True, help="Validate every problem, on the span its plan names.")
@click.option(
    "--store", "file", type=click.Path(dir_okay=False, path_type=Path), help="SQLite file; resumed.  [default: none]"
)
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Write the tables to this Markdown file.")
@json_option
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes.  [default: one a core]")
@click.option("--max-seconds", type=float, default=MAX_SECONDS, show_default=True, help="Most time of one solve [s].")
def validate_command(
    problems: tuple[str, ...],
    every: bool,
    file: Path | None,
    out: Path | None,
    json_file: Path | None,
    jobs: int | None,
    max_seconds: float,
) -> None:
    """Solve PROBLEMS by 15 pairs of solver and form and at constant steps; exit 1 where one disagrees.

    With the reference, where there is one, and with the others where there is none.
    """
    if every == bool(problems):
        raise click.UsageError("name PROBLEMS, or give --all.")
    require_folder(out)
    require_folder(json_file)
    plan = registered_plans() if every else {}
    specs = tuple(validated_spec(name, plan) for name in list_problems()) if every else problems
    reasons = {canonical(spec): reason for spec in specs if (reason := _reason(spec))}
    with tempfile.TemporaryDirectory() as folder:
        rows = _run(specs, file or Path(folder) / "validation.sqlite", jobs, max_seconds)
    compared = [compare_rows(canonical(spec), load_problem(spec), rows) for spec in specs]
    verdicts = judge(row for entry in compared for row in entry.rows)
    command = "hhtbench validate " + ("--all" if every else " ".join(f'"{spec}"' for spec in problems))
    matrices = [] if every else [matrix_text(entry) for entry in compared]  # of the library they would fill a book
    text = "\n".join([solvability(verdicts, command), *matrices])
    click.echo(text)
    if out is not None:
        out.write_text(text, encoding="utf-8")
    evidence = Evidence(title="validation", rows=tuple(_claims(compared, verdicts, reasons)))
    if json_file is not None:
        evidence.write_json(json_file)
    for row in evidence.rows:
        if row.passed is False:
            click.echo(f"{row.claim}: {row.measured}")
    click.echo(evidence.summary)
    sys.exit(0 if evidence.passed else FAILED)


def _run(specs: tuple[str, ...], file: Path, jobs: int | None, max_seconds: float) -> tuple[RunRow, ...]:
    limits = machine_limits(jobs)
    with Store(file) as store:
        campaign = validation_campaign(specs, max_seconds)
        return run_campaign(campaign, store, limits=limits, timing=False, progress=terminal_progress()).rows


def _claims(compared: list[Compared], verdicts: list[Verdict], reasons: dict[str, str]) -> list[Row]:
    """About problems whose solution is known, and about those where solvers are all there is."""
    alone = {entry.problem for entry in compared if not entry.known}
    known = [verdict for verdict in verdicts if verdict.problem not in alone]
    rows = evidence_rows(known, reasons, frozenset(map(canonical, MAKERS)))
    for entry in compared:
        if not entry.known:
            rows += agreement_rows(entry, verdicts)
    return rows


def _reason(spec: str) -> str:
    tags = load_problem(spec).tags
    return " and ".join(reason for tag, reason in HARD.items() if tag in tags)
