"""The command ``hhtbench study parts``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder, write_json
from hhtbench.progress import progress


@click.command("parts")
@click.option(
    "--rounds", type=click.IntRange(min=1), default=9, show_default=True, help="Of times, of which the shortest count."
)
@json_option
def parts_command(rounds: int, json_file: Path | None) -> None:
    """Measure what HHT's optional parts cost, present and absent, and what its automatic reductions gain.

    Exit 1 where an absent part is called, a reduction changes the answer, or describe does not tell of it.
    For example: hhtbench study parts --json parts.json
    """
    with ends_at_once():
        from hhtbench.conformance.parts.study import study_parts

    require_folder(json_file)
    with progress() as told:
        found = study_parts(rounds, lambda done, total: told.advance("parts", done, total))
    click.echo(found)
    write_json(found.as_dict(), json_file)
    sys.exit(FAILED if found.faults else 0)
