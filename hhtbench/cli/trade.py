"""The command ``hhtbench trade``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from hhtbench.cli.output import NEW_FILE, Command, Found, jobs_option
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress


@click.command("trade", cls=Command)
@click.argument("problem")
@click.option("--accuracy", default="1e-2..1e-6", show_default=True, help="Errors to reach: 1e-2..1e-6, 1e-4 or 1e-3,1e-5.")
@click.option("--seconds", type=float, default=60.0, show_default=True, help="About how long it may take [s].")
@click.option("--drift", type=float, help="Largest scaled drift allowed.  [default: any]")
@click.option("--on", metavar="[time|evaluations]", default="time", show_default=True, help="What to minimise.")
@click.option("--solvers", multiple=True, help='Candidates instead of the usual ones, "hht, ida(form=ggl), my.py:RK4".')
@click.option("--store", type=NEW_FILE, help="SQLite file that keeps the rows.")
@click.option("--page", type=NEW_FILE, help="Draw error against cost into this HTML file.")
@jobs_option
def trade_command(problem: str, accuracy: str, solvers: tuple[str, ...], page: Path | None, **asked: Any) -> Found:
    """Measure which solver reaches an error on PROBLEM most cheaply: table, plots and one sentence.

    For example: hhtbench trade my.py:crane --accuracy 1e-2..1e-6 --seconds 60 --page trade.html
    """
    with ends_at_once():
        from hhtbench.advice.criteria import accuracies_of
        from hhtbench.advice.trading import trade
        from hhtbench.campaign.asked import split_specs

    accuracies, some = accuracies_of(accuracy), split_specs(solvers)
    with progress() as bar:
        found = trade(problem, accuracies=accuracies, solvers=some, tell=bar.say, progress=bar.advance, **asked)
    if page is not None:
        found.write_page(page)
    written = f"\n\nwritten: {page}" if page is not None else ""
    return Found(f"{found}{written}", found.as_dict(), not found.choices)
