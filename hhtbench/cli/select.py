"""The command ``hhtbench select``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hhtbench.cli.output import FILE, NEW_FILE, Command, Found
from hhtbench.runtime.interruption import ends_at_once


@click.command("select", cls=Command)
@click.argument("problem")
@click.option("--accuracy", type=float, default=1e-4, show_default=True, help="Scaled error of q and v.")
@click.option("--drift", type=float, help="Most scaled drift.  [default: any]")
@click.option("--on", metavar="[time|evaluations]", default="time", show_default=True, help="What shall be little.")
@click.option(
    "--seconds", type=float, default=0.0, show_default=True, help="What measuring may take [s]; 0: nothing is run."
)
@click.option("--store", type=NEW_FILE, help="Rows of run or trade; made with --seconds.")
@click.option("--database", type=FILE, help="Of study selection.  [default: the package's]")
def select_command(problem: str, store: Path | None, database: Path | None, **asked: Any) -> Found:
    """Say which solver reaches an error on PROBLEM most cheaply, with the evidence; exit 1 where it cannot say.

    For example: hhtbench select andrews --accuracy 1e-4 --on evaluations
    """
    with ends_at_once():
        from hhtbench.advice.selecting import select

    found = select(problem, store=store, database=database, **asked)
    return Found(found, found.as_dict(), found.taken is None)
