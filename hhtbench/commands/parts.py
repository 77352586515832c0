"""The command ``hhtbench study parts``."""

from __future__ import annotations

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import Command, Found
from hhtbench.progress import progress


@click.command("parts", cls=Command)
@click.option(
    "--rounds", type=click.IntRange(min=1), default=9, show_default=True, help="Of times, of which the shortest count."
)
def parts_command(rounds: int) -> Found:
    """Measure what HHT's optional parts cost, present and absent, and what its automatic reductions gain.

    Exit 1 where an absent part is called, a reduction changes the answer, or describe does not tell of it.
    For example: hhtbench study parts --json parts.json
    """
    with ends_at_once():
        from hhtbench.studies.parts.study import study_parts

    with progress() as told:
        found = study_parts(rounds, lambda done, total: told.advance("parts", done, total))
    return Found(found, found.as_dict(), bool(found.faults))
