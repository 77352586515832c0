"""The command ``hhtbench status``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hhtbench.cli.output import FILE, Command, Found
from hhtbench.cli.run import campaign_options
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime.interruption import ends_at_once


@click.command("status", cls=Command)
@click.argument("store", type=FILE)
@campaign_options
def status_command(store: Path, **chosen: Any) -> Found:
    """Show what the store of a campaign holds and what is left to run.

    Number of cells by status, failures by reason, dates and machines, damaged rows; with the options that name a campaign,
    what of it is left.  Nothing is run or written, and the campaign may be running.
    Exit 1 if rows are damaged, 2 if none can be read.

    For example: hhtbench status runs.sqlite --campaign quick
    """
    with ends_at_once():
        from hhtbench.campaign.asked import asked_campaign
        from hhtbench.campaign.status import status_of

    named = any(value not in (None, ()) for value in chosen.values())
    asked = asked_campaign(**chosen) if named else None
    found = status_of(store, chosen["name"] or "asked for", asked)
    damaged = found.reading.warning(store)
    if damaged and not found.rows:
        raise ProblemError(damaged)
    return Found(found, found.as_dict(), error=damaged)
