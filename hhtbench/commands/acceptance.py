"""The command ``hhtbench study acceptance``."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import click

from hhtbench.output import FAILED, require_folder, write_json
from hhtbench.studies.acceptance.rows import Outcome, Row
from hhtbench.studies.acceptance.study import shown, study_acceptance


@click.command("acceptance")
@click.argument("rows", nargs=-1)
@click.option("--solver", "solvers", multiple=True, help="A column, or a solver of your own.  [default: all columns]")
@click.option("--fast", is_flag=True, help="Leave out what takes minutes.")
@click.option("--json", "file", type=click.Path(dir_okay=False, path_type=Path), help="Write what is found to this file.")
def acceptance_command(rows: tuple[str, ...], solvers: tuple[str, ...], fast: bool, file: Path | None) -> None:
    """Measure ROWS of the acceptance matrix at the extremes, by default all; exit 1 where one fails with HHT.

    For example: hhtbench study acceptance M C3 --solver hht --solver ida
    """
    require_folder(file)
    found = study_acceptance(rows, solvers, long=not fast, tell=_tell)
    click.echo(f"\n{found.summary}")
    write_json(found.as_dict(), file)
    sys.exit(0 if found.passed else FAILED)


def _tell(measured: Row, outcomes: Sequence[Outcome]) -> None:
    click.echo(shown(measured, outcomes))
