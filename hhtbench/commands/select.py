"""The command ``hhtbench select``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder, write_json


@click.command("select")
@click.argument("problem")
@click.option("--accuracy", type=float, default=1e-4, show_default=True, help="Scaled error of q and v.")
@click.option("--drift", type=float, help="Most scaled drift.  [default: any]")
@click.option("--on", metavar="[time|evaluations]", default="time", show_default=True, help="What shall be little.")
@click.option(
    "--seconds", type=float, default=0.0, show_default=True, help="What measuring may take [s]; 0: nothing is run."
)
@click.option("--store", type=click.Path(dir_okay=False, path_type=Path), help="Rows of run or trade; made with --seconds.")
@click.option(
    "--database", type=click.Path(dir_okay=False, path_type=Path), help="Of study selection.  [default: the package's]"
)
@json_option
def select_command(
    problem: str,
    accuracy: float,
    drift: float | None,
    on: str,
    seconds: float,
    store: Path | None,
    database: Path | None,
    json_file: Path | None,
) -> None:
    """Say which solver reaches an error on PROBLEM most cheaply, with the evidence; exit 1 where it cannot be told.

    For example: hhtbench select andrews --accuracy 1e-4 --on evaluations
    """
    with ends_at_once():
        from hhtbench.advice.selecting import select

    for file in (json_file, store):
        require_folder(file)
    found = select(problem, accuracy=accuracy, drift=drift, on=on, seconds=seconds, store=store, database=database)
    click.echo(found)
    write_json(found.as_dict(), json_file)
    sys.exit(FAILED if found.taken is None else 0)
