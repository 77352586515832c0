"""The command ``hhtbench report``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.cli.output import FAILED, json_option, require_folder, shown, write_json
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime.interruption import ends_at_once


@click.command("report")
@click.option("--store", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The campaign's rows.")
@click.option("--folder", type=click.Path(file_okay=False, path_type=Path), help="Write index.html and summary.md here.")
@json_option
def report_command(store: Path, folder: Path | None, json_file: Path | None) -> None:
    """Write the comparison of a campaign as a page; without --folder print its summary, at most 200 lines.

    A verification in the folder is shown with it.  Rows of a damaged store that cannot be read are named, on the page too;
    the exit code is then 1.  For example: hhtbench report --store runs.sqlite --folder reports/latest
    """
    with ends_at_once():
        from hhtbench.campaign.store import sound_rows
        from hhtbench.protocol.evidence import read_evidence
        from hhtbench.report import content_of, summary_page, write_comparison

    require_folder(json_file)
    rows, losses = sound_rows(store)
    if losses and not rows:
        raise ProblemError(losses)
    command = f"hhtbench report --store {shown(store)}"
    if folder is None:
        content = content_of(rows, losses)
        click.echo(summary_page(content, command), nl=False)
    else:
        claims = folder / "evidence.json"
        evidence = read_evidence(claims) if claims.is_file() else None
        content = write_comparison(rows, folder, f"{command} --folder {shown(folder)}", evidence, losses)
        click.echo(f"written: {folder / 'index.html'}, {folder / 'summary.md'}")
    write_json(content.as_dict(), json_file)
    if losses:
        click.echo(f"Error: {losses}", err=True)
        sys.exit(FAILED)
