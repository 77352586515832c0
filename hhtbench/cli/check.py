"""The command ``hhtbench check``."""

from __future__ import annotations

import click

from hhtbench.cli.output import Command, Found, jobs_option, judged
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress


@click.command("check", cls=Command)
@click.argument("problem", required=False)
@click.option("--all", "every", is_flag=True, help="Check every registered problem.")
@jobs_option
def check_command(problem: str | None, every: bool, jobs: int | None) -> Found:
    """Check PROBLEM: shapes, derivatives, consistent start, rank of the constraints, energy.

    For example: hhtbench check my.py:crane
    """
    with ends_at_once():
        from hhtbench.campaign.machine import usable_cores
        from hhtbench.catalogue.registry import load_problem
        from hhtbench.checks.problem import check
        from hhtbench.cli.library import check_all

    if every == (problem is not None):
        raise click.UsageError("name one PROBLEM, or give --all.")
    if problem is not None:
        return judged(check(load_problem(problem)))
    with progress() as bar:
        evidence = check_all(jobs or usable_cores(), bar.show, bar.advance)
    wrong = [row for row in evidence.rows if row.passed is False]
    lines = [f"\n{row.id}: {row.measured} (bound: {row.bound})" for row in wrong]
    text = f"{''.join(lines)}\n{evidence.summary}; {evidence.seconds:.0f} s"
    return Found(text, evidence.as_dict(), not evidence.passed)
