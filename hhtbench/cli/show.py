"""The command ``hhtbench show``: a drawing of one problem's motion, thumbnails and the table of all."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from hhtbench.cli.output import FAILED, json_option, require_folder, write_json
from hhtbench.runtime.interruption import ends_at_once
from hhtbench.runtime.progress import progress


@click.command("show")
@click.argument("problem", required=False)
@click.option("--out", type=click.Path(path_type=Path), help="FILE.png, .svg, .gif or .html; with --all a folder.")
@click.option("--frames", type=click.IntRange(min=2), help="Phases of a still, pictures of a film.  [default: 9; 60]")
@click.option("--solver", help="For example ida(form=ggl).  [default: the closed solution, else collocation]")
@click.option("--seconds", type=float, help="From the start [s].  [default: about one turn, swing or until it rests]")
@click.option("--all", "every", is_flag=True, help="A thumbnail NAME.png of every registered problem.")
@click.option(
    "--table", type=click.Path(dir_okay=False, path_type=Path), help="Renew the table of all problems in this Markdown file."
)
@json_option
def show_command(
    problem: str | None,
    out: Path | None,
    frames: int | None,
    solver: str | None,
    seconds: float | None,
    every: bool,
    table: Path | None,
    json_file: Path | None,
) -> None:
    """Draw the motion of PROBLEM from its sketch: phases in one picture (.png, .svg) or a film (.gif, .html).

    For example: hhtbench show andrews --out andrews.html
    """
    with ends_at_once():
        from hhtbench.drawing.files import draw_all, draw_one
        from hhtbench.drawing.table import update_table

    if (problem is not None) == (every or table is not None):
        raise click.UsageError("name one PROBLEM, or give --all or --table.")
    require_folder(json_file)
    drawings: list[dict[str, Any]] = []
    if every:
        if out is None or frames is not None or solver is not None or seconds is not None:
            raise click.UsageError("--all needs --out FOLDER and takes no other option than --table.")
        with progress() as bar:
            drawings = draw_all(out, bar.show, bar.advance)
    if table is not None:
        update_table(table)
        click.echo(f"written: {table}")
    if problem is not None:
        drawings = [draw_one(problem, out, frames, solver, seconds)]
    write_json({"drawings": drawings, "table": None if table is None else str(table)}, json_file)
    sys.exit(FAILED if any(drawing["failed"] for drawing in drawings) else 0)
