"""The command ``hhtbench study``."""

from __future__ import annotations

from typing import Any

import click

from hhtbench.cli.acceptance import acceptance_command
from hhtbench.cli.atlas import atlas_command
from hhtbench.cli.output import NEW_FILE, Command, Found, jobs_option
from hhtbench.cli.stability import stability_command
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress


@click.group("study")
def study_command() -> None:
    """Studies of the bench's own advice, and of solvers at their extremes.

    For example: hhtbench study selection
    """


@study_command.command("selection", cls=Command)
@click.option("--store", type=NEW_FILE, help="Rows of the drawn scenes; made where missing.")
@click.option(
    "--scenes", type=click.IntRange(min=3), help="Run that many of the drawn scenes.  [default: what the store holds]"
)
@click.option("--seconds", type=float, default=1.0, show_default=True, help="Of each solver on each scene [s].")
@jobs_option
@click.option("--database", type=NEW_FILE, help="Write the rows, reduced, to this file for select.")
def selection_command(**asked: Any) -> Found:
    """Measure the regret of the advice on held-out problems and families, beside fixed choices and a rule of thumb.

    Without --store and --scenes the database of the package is judged, in seconds.

    For example: hhtbench study selection --scenes 94 --store families.sqlite --database mine.json
    """
    with ends_at_once():
        from hhtbench.advice.study import study_selection

    with progress() as bar:
        found = study_selection(**asked, tell=bar.say, progress=bar.advance)
    return Found(found, found.as_dict(), not found.judgements)


for command in (acceptance_command, atlas_command, stability_command):
    study_command.add_command(command)
