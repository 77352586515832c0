"""The command ``hhtbench study``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.commands.acceptance import acceptance_command
from hhtbench.commands.atlas import atlas_command
from hhtbench.commands.parts import parts_command
from hhtbench.commands.stability import stability_command
from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder, write_json
from hhtbench.progress import progress


@click.group("study")
def study_command() -> None:
    """Studies of the bench's own advice, of solvers at their extremes, of parts and reductions.

    For example: hhtbench study selection
    """


@study_command.command("selection")
@click.option(
    "--store", type=click.Path(dir_okay=False, path_type=Path), help="Rows of the drawn scenes; made where missing."
)
@click.option(
    "--scenes", type=click.IntRange(min=3), help="Run that many of the drawn scenes.  [default: what the store holds]"
)
@click.option("--seconds", type=float, default=2.0, show_default=True, help="Of each solver on each scene [s].")
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes.  [default: one a core]")
@click.option(
    "--database", type=click.Path(dir_okay=False, path_type=Path), help="Write the rows, reduced, to this file for select."
)
@json_option
def selection_command(
    store: Path | None,
    scenes: int | None,
    seconds: float,
    jobs: int | None,
    database: Path | None,
    json_file: Path | None,
) -> None:
    """Regret of advice on problems and families that it has not seen, beside fixed choices and a rule of thumb.

    Without --store and --scenes the database of the package is judged, in seconds.
    For example: hhtbench study selection --scenes 116 --store families.sqlite --database mine.json
    """
    with ends_at_once():
        from hhtbench.studies.selection import study_selection

    for file in (store, database, json_file):
        require_folder(file)
    with progress() as told:
        found = study_selection(
            store=store,
            scenes=scenes,
            seconds=seconds,
            jobs=jobs,
            database=database,
            tell=told.say,
            progress=told.advance,
        )
    click.echo(found)
    write_json(found.as_dict(), json_file)
    sys.exit(0 if found.judgements else FAILED)


study_command.add_command(acceptance_command)
study_command.add_command(atlas_command)
study_command.add_command(parts_command)
study_command.add_command(stability_command)
