"""The command ``hhtbench status``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from hhtbench.commands.chosen import campaign_options
from hhtbench.errors import ProblemError
from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder, write_json


@click.command("status")
@click.argument("store", type=click.Path(dir_okay=False, path_type=Path))
@campaign_options
@json_option
def status_command(store: Path, json_file: Path | None, **chosen: Any) -> None:
    """Say what the store of a campaign holds, and what is left to do.

    How many cells ended how, failures by reason, when and by which machines they were made, damaged rows; with the options
    that name a campaign to run, what of it is left.  Nothing is run or written, and the campaign may be running.
    Exit 1 where rows are damaged, 2 where none can be read.
    For example: hhtbench status runs.sqlite --campaign quick
    """
    with ends_at_once():
        from hhtbench.campaign.asked import asked_campaign
        from hhtbench.campaign.status import status_of

    require_folder(json_file)
    named = any(value not in (None, ()) for value in chosen.values())
    asked = asked_campaign(**chosen) if named else None
    found = status_of(store, chosen["name"] or "asked for", asked)
    damaged = found.reading.warning(store)
    if damaged and not found.rows:
        raise ProblemError(damaged)
    click.echo(str(found))
    write_json(found.as_dict(), json_file)
    if damaged:
        click.echo(f"Error: {damaged}", err=True)
        sys.exit(FAILED)
