"""The command ``hhtbench validate``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder
from hhtbench.progress import progress


@click.command("validate")
@click.argument("problems", nargs=-1)
@click.option("--all", "every", is_flag=True, help="Validate every problem, on the span its plan names.")
@click.option(
    "--store", "file", type=click.Path(dir_okay=False, path_type=Path), help="SQLite file; resumed.  [default: none]"
)
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="Write the tables to this Markdown file.")
@json_option
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes.  [default: one a core]")
@click.option("--max-seconds", type=float, default=60.0, show_default=True, help="Most time of one solve [s].")
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
    For example: hhtbench validate "four_bars(n_windows=2)" --jobs 2
    """
    with ends_at_once():
        from hhtbench.validation.run import validate

    if every == bool(problems):
        raise click.UsageError("name PROBLEMS, or give --all.")
    require_folder(out)
    require_folder(json_file)
    with progress() as told:
        found = validate(problems, file, jobs, max_seconds, told.advance)
    click.echo(found.text)
    if out is not None:
        out.write_text(found.text, encoding="utf-8")
    if json_file is not None:
        found.evidence.write_json(json_file)
    for row in found.evidence.rows:
        if row.passed is False:
            click.echo(f"{row.claim}: {row.measured}")
    click.echo(found.evidence.summary)
    sys.exit(0 if found.evidence.passed else FAILED)
