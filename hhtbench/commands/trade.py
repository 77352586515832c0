"""The command ``hhtbench trade``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from hhtbench.interruption import ends_at_once
from hhtbench.output import FAILED, json_option, require_folder, write_json
from hhtbench.progress import progress


@click.command("trade")
@click.argument("problem")
@click.option("--accuracy", default="1e-2..1e-6", show_default=True, help="Errors to reach: 1e-2..1e-6, 1e-4 or 1e-3,1e-5.")
@click.option("--seconds", type=float, default=60.0, show_default=True, help="About how long it may take [s].")
@click.option("--drift", type=float, help="Most scaled drift of the runs that count.  [default: any]")
@click.option("--on", metavar="[time|evaluations]", default="time", show_default=True, help="What shall be little.")
@click.option("--solvers", multiple=True, help='Candidates instead of the usual ones, "hht, ida(form=ggl), my.py:RK4".')
@click.option("--store", type=click.Path(dir_okay=False, path_type=Path), help="SQLite file that keeps the rows.")
@click.option("--page", type=click.Path(dir_okay=False, path_type=Path), help="Draw error against cost into this HTML file.")
@click.option("--jobs", type=click.IntRange(min=1), help="Worker processes.  [default: one a core]")
@json_option
def trade_command(
    problem: str,
    accuracy: str,
    seconds: float,
    drift: float | None,
    on: str,
    solvers: tuple[str, ...],
    store: Path | None,
    page: Path | None,
    jobs: int | None,
    json_file: Path | None,
) -> None:
    """Measure on PROBLEM who reaches an error most cheaply: table, plots and one sentence.

    For example: hhtbench trade my.py:crane --accuracy 1e-2..1e-6 --seconds 60 --page trade.html
    """
    with ends_at_once():
        from hhtbench.advice.criteria import accuracies_of
        from hhtbench.advice.trading import trade
        from hhtbench.campaign.asked import split_specs

    for file in (json_file, page, store):
        require_folder(file)
    with progress() as told:
        found = trade(
            problem,
            accuracies=accuracies_of(accuracy),
            seconds=seconds,
            drift=drift,
            on=on,
            solvers=split_specs(solvers),
            store=store,
            jobs=jobs,
            tell=told.say,
            progress=told.advance,
        )
    click.echo(found)
    write_json(found.as_dict(), json_file)
    if page is not None:
        found.write_page(page)
        click.echo(f"\nwritten: {page}")
    sys.exit(0 if found.choices else FAILED)
