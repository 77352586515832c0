"""The command ``hhtbench report``."""

from __future__ import annotations

from pathlib import Path

import click

from hhtbench.commands.common import shown
from hhtbench.evidence import read_evidence
from hhtbench.report import write_comparison
from hhtbench.store import load_rows


@click.command("report")
@click.option("--store", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The campaign's rows.")
@click.option(
    "--folder", required=True, type=click.Path(file_okay=False, path_type=Path), help="Write index.html and report.md here."
)
def report_command(store: Path, folder: Path) -> None:
    """Write the comparison of a campaign; a verification in the folder is shown with it."""
    claims = folder / "evidence.json"
    evidence = read_evidence(claims) if claims.is_file() else None
    command = f"hhtbench report --store {shown(store)} --folder {shown(folder)}"
    write_comparison(load_rows(store), folder, command, evidence)
    click.echo(f"written: {folder / 'index.html'}")
