"""The command ``hhtbench study acceptance``."""

from __future__ import annotations

import itertools
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hhtbench.cli.output import FAILED, json_option, require_folder, write_json
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress

if TYPE_CHECKING:
    from hhtbench.conformance.entry import Entry, Outcome


@click.command("acceptance")
@click.argument("rows", nargs=-1)
@click.option("--solver", "solvers", multiple=True, help="A column, or a solver of your own.  [default: all columns]")
@click.option("--fast", is_flag=True, help="Leave out the slow lane, which takes minutes.")
@json_option
def acceptance_command(rows: tuple[str, ...], solvers: tuple[str, ...], fast: bool, json_file: Path | None) -> None:
    """Measure ROWS of the acceptance matrix (extreme problems), by default all; exit 1 if one fails with HHT.

    For example: hhtbench study acceptance M C3 --solver hht --solver ida
    """
    with ends_at_once():
        from hhtbench.conformance.acceptance import chosen_rows, shown, study_acceptance

    require_folder(json_file)
    count = len(chosen_rows(rows, slow=not fast))
    with progress() as bar:

        def tell(measured: Entry, outcomes: Sequence[Outcome]) -> None:
            bar.show(shown(measured, outcomes))
            bar.advance("rows", next(done), count)

        done = itertools.count(1)
        bar.advance("rows", 0, count)
        found = study_acceptance(rows, solvers, slow=not fast, tell=tell)
    click.echo(f"\n{found.summary}")
    write_json(found.as_dict(), json_file)
    sys.exit(0 if found.passed else FAILED)
