"""Write drawings to files: one problem's motion, or thumbnails of all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from hhtbench.catalogue.registry import list_problems, load_problem
from hhtbench.drawing import draw
from hhtbench.drawing.motion import Course, draw_state, find_course
from hhtbench.drawing.scene import Scene, make_scene
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem

Writer = Callable[[Scene, int | None, Path], None]

WRITERS: dict[str, Writer] = {
    ".png": lambda scene, count, file: draw.write_png(draw.stroboscope(scene, count), file),
    ".svg": lambda scene, count, file: draw.write_svg(draw.stroboscope(scene, count), file),
    ".gif": lambda scene, count, file: draw.write_gif(draw.film(scene, count), _span(scene), file),
    ".html": lambda scene, count, file: draw.write_html(draw.film(scene, count), _span(scene), scene.name, file),
}


def draw_one(spec: str, out: Path | None, frames: int | None, solver: str | None, seconds: float | None) -> dict[str, Any]:
    """Write the drawing of one problem; the result says what it shows and, in ``failed``, why it ends early, or ""."""
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
    return _drawn(problem.name, file, course) | {"notes": list(scene.notes), "failed": course.stopped}


def _drawn(problem: str, file: Path, course: Course) -> dict[str, Any]:
    return {"problem": problem, "file": str(file), "t": [course.t[0], course.t[-1]], "states": course.source, "failed": ""}


def draw_all(
    folder: Path, tell: Callable[[str], None] = click.echo, progress: Callable[[str, int, int], None] = lambda *_: None
) -> list[dict[str, Any]]:
    """Write one thumbnail per problem; those that cannot be drawn are marked ``failed``.

    ``tell`` receives one line per problem, ``progress`` the number drawn and the number in all.
    """
    folder.mkdir(parents=True, exist_ok=True)
    drawings: list[dict[str, Any]] = []
    names = list_problems()
    for count, name in enumerate(names):
        progress("drawings", count, len(names))
        try:
            course = _draw_thumbnail(load_problem(name), folder / f"{name}.png")
        except Exception as error:  # noqa: BLE001 - whatever one problem's file raises, the others are drawn
            text = f"{type(error).__name__}: {error}"
            drawings.append({"problem": name, "file": None, "failed": text})
            tell(f"{name}: NOT DRAWN: {text}")
            continue
        notes = [course.stopped] if course.stopped else []
        drawings.append(_drawn(name, folder / f"{name}.png", course) | {"notes": notes})
        tell("; ".join([f"{name}: t = {course.t[0]:.4g} to {course.t[-1]:.4g} s", course.source, *notes]))
    return drawings


def _draw_thumbnail(problem: Problem, file: Path) -> Course:
    """Write the thumbnail and return the states it shows."""
    draw_state(problem, problem.q0)
    course = find_course(problem)
    draw.write_png(draw.stroboscope(make_scene(problem, course), look=draw.SMALL), file)
    return course


def _span(scene: Scene) -> float:
    return float(scene.t[-1] - scene.t[0])
