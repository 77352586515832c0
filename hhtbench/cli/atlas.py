"""The command ``hhtbench study atlas``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.cli.output import FAILED, json_option, require_folder, write_json
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime.interruption import ends_at_once


@click.command("atlas")
@click.option("--store", required=True, type=click.Path(dir_okay=False, path_type=Path), help="The campaign's rows.")
@json_option
def atlas_command(store: Path, json_file: Path | None) -> None:
    """Tabulate how the runs of a campaign failed: solver, form, problem and accuracy with the typed cause, as Markdown.

    A success counts as silently wrong where its error is more than a thousand times the tolerance.

    For example: hhtbench study atlas --store runs.sqlite --json atlas.json
    """
    with ends_at_once():
        from hhtbench.campaign.store import sound_rows
        from hhtbench.report.atlas import failure_atlas
        from hhtbench.report.markdown import markdown_table

    require_folder(json_file)
    rows, losses = sound_rows(store)
    if losses and not rows:
        raise ProblemError(losses)
    found = failure_atlas(rows)
    for table in (found.causes(), found.table()):
        click.echo("\n\n".join(markdown_table(table)) + "\n")
    write_json(found.as_dict(), json_file)
    if losses:
        click.echo(f"Error: {losses}", err=True)
        sys.exit(FAILED)
