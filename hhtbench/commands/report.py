"""The command ``hhtbench report``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.errors import ProblemError
from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder, shown, write_json


@click.command("report")
@click.option("--store", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The campaign's rows.")
@click.option(
    "--folder", required=True, type=click.Path(file_okay=False, path_type=Path), help="Write index.html and report.md here."
)
@json_option
def report_command(store: Path, folder: Path, json_file: Path | None) -> None:
    """Write the comparison of a campaign; a verification in the folder is shown with it.

    Rows of a damaged store that cannot be read are named, on the page too; the exit code is then 1.
    For example: hhtbench report --store runs.sqlite --folder reports/latest
    """
    with ends_at_once():
        from hhtbench.evidence import read_evidence
        from hhtbench.report import write_comparison
        from hhtbench.store import sound_rows

    require_folder(json_file)
    rows, losses = sound_rows(store)
    if losses and not rows:
        raise ProblemError(losses)
    claims = folder / "evidence.json"
    evidence = read_evidence(claims) if claims.is_file() else None
    command = f"hhtbench report --store {shown(store)} --folder {shown(folder)}"
    content = write_comparison(rows, folder, command, evidence, losses)
    write_json(content.as_dict(), json_file)
    click.echo(f"written: {folder / 'index.html'}")
    if losses:
        click.echo(f"Error: {losses}", err=True)
        sys.exit(FAILED)
