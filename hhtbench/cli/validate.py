"""The command ``hhtbench validate``."""

from __future__ import annotations

from pathlib import Path

import click

from hhtbench.cli.output import FILE, NEW_FILE, Command, Found, jobs_option
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress


@click.command("validate", cls=Command)
@click.argument("problems", nargs=-1)
@click.option("--all", "every", is_flag=True, help="Validate every problem, on the span its plan names.")
@click.option("--store", "file", type=FILE, help="SQLite file; resumed.  [default: none]")
@click.option("--out", type=NEW_FILE, help="Write the tables to this Markdown file.")
@jobs_option
@click.option("--max-seconds", type=float, default=60.0, show_default=True, help="Most time of one solve [s].")
def validate_command(
    problems: tuple[str, ...], every: bool, file: Path | None, out: Path | None, jobs: int | None, max_seconds: float
) -> Found:
    """Solve PROBLEMS by 15 pairs of solver and form and at constant steps; exit 1 if one disagrees.

    Results are compared with the reference if there is one, else with one another.

    For example: hhtbench validate "four_bars(n_windows=2)" --jobs 2
    """
    with ends_at_once():
        from hhtbench.conformance.validation.run import validate

    if every == bool(problems):
        raise click.UsageError("name PROBLEMS, or give --all.")
    with progress() as bar:
        found = validate(problems, file, jobs, max_seconds, bar.advance)
    if out is not None:
        out.write_text(found.text, encoding="utf-8")
    wrong = [f"{row.claim}: {row.measured}" for row in found.evidence.rows if row.passed is False]
    text = "\n".join([found.text, *wrong, found.evidence.summary])
    return Found(text, found.evidence.as_dict(), not found.evidence.passed)
