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
@click.option("--drift", type=float, help="Largest scaled drift allowed.  [default: any]")
@click.option("--on", metavar="[time|evaluations]", default="time", show_default=True, help="What to minimise.")
@click.option(
    "--seconds",
    type=float,
    default=0.0,
    show_default=True,
    help="Time for measuring [s]; 0: nothing is run, only known results are used.",
)
@click.option("--store", type=NEW_FILE, help="Rows of run or trade; made with --seconds.")
@click.option("--database", type=FILE, help="File written by study selection.  [default: the package's]")
def select_command(problem: str, store: Path | None, database: Path | None, **asked: Any) -> Found:
    """Recommend the solver that reaches an error on PROBLEM most cheaply, with the evidence; exit 1 if there is none.

    For example: hhtbench select andrews --accuracy 1e-4 --on evaluations
    """
    with ends_at_once():
        from hhtbench.advice.selecting import select

    found = select(problem, store=store, database=database, **asked)
    return Found(found, found.as_dict(), found.taken is None)
