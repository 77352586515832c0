"""The command ``hhtbench show``: a drawing of one problem's motion, thumbnails and the table of all."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from hhtbench.drawing import draw
from hhtbench.drawing.motion import Course, draw_state, find_course
from hhtbench.drawing.scene import Scene, make_scene
from hhtbench.drawing.table import update_table
from hhtbench.errors import ProblemError
from hhtbench.output import FAILED, json_option, require_folder, write_json
from hhtbench.protocol import Problem
from hhtbench.registry import list_problems, load_problem

Writer = Callable[[Scene, int | None, Path], None]

WRITERS: dict[str, Writer] = {
    ".png": lambda scene, count, file: draw.write_png(draw.stroboscope(scene, count), file),
    ".svg": lambda scene, count, file: draw.write_svg(draw.stroboscope(scene, count), file),
    ".gif": lambda scene, count, file: draw.write_gif(draw.film(scene, count), _span(scene), file),
    ".html": lambda scene, count, file: draw.write_html(draw.film(scene, count), _span(scene), scene.name, file),
}


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
    """Draw the motion of PROBLEM from its sketch: phases in one picture (.png, .svg) or a film (.gif, .html)."""
    if (problem is not None) == (every or table is not None):
        raise click.UsageError("name one PROBLEM, or give --all or --table.")
    require_folder(json_file)
    drawings: list[dict[str, Any]] = []
    if every:
        if out is None or frames is not None or solver is not None or seconds is not None:
            raise click.UsageError("--all needs --out FOLDER and takes no other option than --table.")
        drawings = _draw_all(out)
    if table is not None:
        update_table(table)
        click.echo(f"written: {table}")
    if problem is not None:
        drawings = [_draw_one(problem, out, frames, solver, seconds)]
    write_json({"drawings": drawings, "table": None if table is None else str(table)}, json_file)
    sys.exit(FAILED if any(drawing["failed"] for drawing in drawings) else 0)


def _draw_one(spec: str, out: Path | None, frames: int | None, solver: str | None, seconds: float | None) -> dict[str, Any]:
    """Write the drawing; what it shows, and in ``failed`` why not all that was asked for, "" where it does."""
    problem = load_problem(spec)
    file = out or Path(f"{problem.name}.png")
    write = WRITERS.get(file.suffix.lower())
    if write is None:
        raise ProblemError(f"a drawing is written as {', '.join(WRITERS)}; got {file.name}.")
    if not file.parent.is_dir():
        raise ProblemError(f"there is no folder {file.parent} to write {file.name} into; make it first.")
    draw_state(problem, problem.q0)  # before any solver works
    course = find_course(problem, solver, seconds)
    scene = make_scene(problem, course)
    write(scene, frames, file)
    click.echo(f"{problem.name}: t = {scene.t[0]:.6g} to {scene.t[-1]:.6g} s; states: {scene.source}")
    for note in scene.notes:
        click.echo(note)
    click.echo(f"written: {file}")
    return _drawn(problem.name, file, course, scene.source, scene.notes)


def _drawn(problem: str, file: Path, course: Course, source: str, notes: Sequence[str]) -> dict[str, Any]:
    return {
        "problem": problem,
        "file": str(file),
        "t": [course.t[0], course.t[-1]],
        "states": source,
        "notes": list(notes),
        "failed": course.stopped,
    }


def _draw_all(folder: Path) -> list[dict[str, Any]]:
    """One thumbnail a problem; those that cannot be drawn are named and ``failed``."""
    folder.mkdir(parents=True, exist_ok=True)
    drawings = []
    for name in list_problems():
        try:
            course = _draw_thumbnail(load_problem(name), folder / f"{name}.png")
        except Exception as error:  # noqa: BLE001 - whatever one problem's file raises, the others are drawn
            text = f"{type(error).__name__}: {error}"
            drawings.append({"problem": name, "file": None, "failed": text})
            click.echo(f"{name}: NOT DRAWN: {text}")
            continue
        notes = [course.stopped] if course.stopped else []
        drawings.append(_drawn(name, folder / f"{name}.png", replace(course, stopped=""), course.source, notes))
        shown = f"t = {course.t[0]:.4g} to {course.t[-1]:.4g} s", course.source, course.stopped
        click.echo(f"{name}: {'; '.join(filter(None, shown))}")
    return drawings


def _draw_thumbnail(problem: Problem, file: Path) -> Course:
    """Write the thumbnail; what it shows."""
    draw_state(problem, problem.q0)
    course = find_course(problem)
    draw.write_png(draw.stroboscope(make_scene(problem, course), look=draw.SMALL), file)
    return course


def _span(scene: Scene) -> float:
    return float(scene.t[-1] - scene.t[0])
