"""The command ``hhtbench check``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, conclude, json_option, require_folder
from hhtbench.progress import progress


@click.command("check")
@click.argument("problem", required=False)
@click.option("--all", "every", is_flag=True, help="Check every registered problem.")
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes with --all.  [default: one a core]")
@json_option
def check_command(problem: str | None, every: bool, jobs: int | None, json_file: Path | None) -> None:
    """Check that PROBLEM keeps its promises: shapes, derivatives, consistent start, rank, energy.

    For example: hhtbench check my.py:crane
    """
    with ends_at_once():
        from hhtbench.campaign.machine import usable_cores
        from hhtbench.checks.problem import check
        from hhtbench.library import check_all
        from hhtbench.registry import load_problem

    if every == (problem is not None):
        raise click.UsageError("name one PROBLEM, or give --all.")
    if problem is not None:
        conclude(check(load_problem(problem)), json_file)
    require_folder(json_file)
    with progress() as told:
        evidence = check_all(jobs or usable_cores(), told.show, told.advance)
    if json_file is not None:
        evidence.write_json(json_file)
    wrong = [row for row in evidence.rows if row.passed is False]
    click.echo("".join(f"\n{row.id}: {row.measured} (bound: {row.bound})" for row in wrong))
    click.echo(f"{evidence.summary}; {evidence.seconds:.0f} s")
    sys.exit(0 if evidence.passed else FAILED)
