"""Draw a scene with Matplotlib: all phases in one figure, or one after the other as a film."""

from __future__ import annotations

import base64
import html
import io
import json
import textwrap
from dataclasses import dataclass
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from PIL import Image

from hhtbench.drawing.scene import Scene

FRAMES = 60
DPI = 100
WIDTH, LOWEST, HIGHEST = 8.0, 2.5, 8.0  # of a figure [in]
THUMBNAIL = (3.2, 2.4)  # [in]
COLOURS = 32  # of a stored raster: thin lines in four hues need no more
FADED = 0.14  # strength of the second phase; the last one has 1
BODY, PATH, GROUND, START, FLOOR, SHADOW = "#004a80", "#D55E00", "#8a8a8a", "#7d7d7d", "#d9d9d9", "#e6e6e6"
ROW_GAP, ROW_LEAST = 0.4, 0.09  # between the phases of a motion along a line: share of their height, of the width
SHORTEST, LONGEST = 3.0, 8.0  # of a film [s]

PLAYER = Template("""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>$name</title>
<style>body{font-family:system-ui,sans-serif;text-align:center;margin:1em}img{max-width:100%}input{width:60%}</style>
<img id="picture" alt="$name"><p><button id="play">pause</button> <input id="time" type="range" min="0" max="$last"></p>
<script>
const frames = $frames, picture = document.getElementById("picture"), time = document.getElementById("time");
const play = document.getElementById("play");
let playing = true, i = 0;
function show(k) { i = k; picture.src = "data:image/png;base64," + frames[k]; time.value = k; }
time.oninput = () => { playing = false; play.textContent = "play"; show(Number(time.value)); };
play.onclick = () => { playing = !playing; play.textContent = playing ? "pause" : "play"; };
setInterval(() => { if (playing) show((i + 1) % frames.length); }, $pause);
show(0);
</script></html>
""")


@dataclass(frozen=True, kw_only=True)
class Look:
    """Line widths, sizes and number of phases of one kind of picture."""

    line: float = 1.8  #: width of the bodies' lines [pt]
    dot: float = 11.0  #: area of a joint [pt^2]
    text: bool = True  #: with a caption
    phases: int = 9  #: on top of one another
    rows: int = 7  #: below one another


SMALL = Look(line=1.2, dot=4.0, text=False, phases=6, rows=5)


def stroboscope(scene: Scene, phases: int | None = None, look: Look | None = None) -> Figure:
    """Draw all phases in one figure, fading into the past, with thin lines for the paths of the points.

    Phases of a motion along a line stand below one another, time runs down.
    """
    look = look or Look()
    rows = scene.along_a_line
    chosen = scene.pick(phases or (look.rows if rows else look.phases))
    pitch = _pitch(scene) if rows else 0.0
    drop = -pitch * (scene.t - scene.t[0]) / (scene.t[chosen[-1]] - scene.t[0] or 1.0) * (len(chosen) - 1)
    low, high = scene.box
    figure, axes = _sheet(low + np.array([0.0, drop[-1]]), high, _caption(scene, chosen) if look.text else "", look)
    for count, i in enumerate(chosen):
        if rows or not count:
            _draw_ground(axes, scene, drop[i], look)
        _draw_phase(axes, scene, int(i), count / max(len(chosen) - 1, 1), drop[i], look)
        if rows and look.text:
            label = f"{scene.t[i] - scene.t[0]:.3g} s  "
            axes.text(low[0], (low[1] + high[1]) / 2 + drop[i], label, ha="right", va="center", fontsize=8, color=START)
    _draw_paths(axes, scene, len(scene.t), drop, look)
    return figure


def film(scene: Scene, frames: int | None = None) -> list[Image.Image]:
    """Return one picture per time, with the paths up to it."""
    look, pictures = Look(), []
    low, high = scene.box
    for i in scene.pick(frames or FRAMES):
        text = f"{scene.name}   t = {scene.t[i]:#.3g} s\n" + "\n".join([f"states: {scene.source}", *scene.notes])
        figure, axes = _sheet(low, high, text, look)
        _draw_ground(axes, scene, 0.0, look)
        _draw_paths(axes, scene, i + 1, np.zeros(len(scene.t)), look)
        _draw_phase(axes, scene, int(i), 1.0, 0.0, look)
        pictures.append(_picture(figure))
    return pictures


def write_png(figure: Figure, file: Path) -> None:
    """Write a small PNG file: few colours, best compression."""
    _picture(figure).save(file, optimize=True)


def write_svg(figure: Figure, file: Path) -> None:
    """Write an SVG file with text as text and without a date, so that the same motion gives the same file."""
    figure.savefig(file, format="svg", metadata={"Date": None})


def write_gif(pictures: list[Image.Image], span: float, file: Path) -> None:
    """Write an endless GIF that runs in the time of the motion, clipped to SHORTEST and LONGEST seconds."""
    first, *others = pictures
    pause = int(_pause(len(pictures), span))
    first.save(file, save_all=True, append_images=others, duration=pause, loop=0, optimize=True)


def write_html(pictures: list[Image.Image], span: float, name: str, file: Path) -> None:
    """Write a self-contained page with the frames, a button and a slider."""
    frames = [base64.b64encode(_png(picture)).decode("ascii") for picture in pictures]
    pause = f"{_pause(len(frames), span):.0f}"
    page = PLAYER.substitute(name=html.escape(name), frames=json.dumps(frames), last=len(frames) - 1, pause=pause)
    file.write_text(page, encoding="utf-8")


def _pause(count: int, span: float) -> float:
    """Time between two pictures [ms]."""
    return 1000 * float(np.clip(abs(span), SHORTEST, LONGEST)) / count


def _sheet(low: Any, high: Any, caption: str, look: Look) -> tuple[Figure, Axes]:
    """Return an empty figure with equal scales that holds the box from ``low`` to ``high``."""
    middle, size = (low + high) / 2, np.maximum(1.1 * (high - low), 1e-12)
    size = np.maximum(size, 0.05 * size.max())
    if look.text:
        height = float(np.clip(WIDTH * size[1] / size[0], LOWEST, HIGHEST))
        foot = 0.3 + 0.2 * len(caption.splitlines())
        figure = Figure(figsize=(WIDTH, height + foot), dpi=DPI)
        axes = figure.add_axes((0.0, foot / (height + foot), 1.0, height / (height + foot)))
        figure.text(0.5, 0.15 / (height + foot), caption, ha="center", va="bottom", fontsize=9, linespacing=1.3)
        paper = np.array([WIDTH, height])
    else:
        figure = Figure(figsize=THUMBNAIL, dpi=DPI)
        axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
        paper = np.array(THUMBNAIL)
    half = (size / paper).max() * paper / 2
    axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]))
    axes.set_axis_off()
    return figure, axes


def _draw_phase(axes: Axes, scene: Scene, i: int, share: float, drop: float, look: Look) -> None:
    """Draw the moving parts at time number ``i``; ``share`` is 0 for the first phase and 1 for the last."""
    shift, moving = np.array([0.0, drop]), ~scene.fixed_lines
    strength = 0.45 if share == 0 else FADED + (1 - FADED) * share**2
    colour = START if share == 0 else BODY
    if share == 1:
        axes.add_collection(LineCollection(scene.shadows[i], colors=SHADOW, linewidths=look.line, zorder=0.5))
    bodies = LineCollection(
        scene.lines[i, moving] + shift,
        colors=colour,
        alpha=strength,
        linewidths=look.line * (1.0 if share == 1 else 0.7),
        capstyle="round",
        zorder=2 + share,
    )
    bodies.set_gid(f"phase-{i}")
    axes.add_collection(bodies)
    joints = scene.points[i, ~scene.fixed_points] + shift
    axes.scatter(joints[:, 0], joints[:, 1], s=look.dot, color=colour, alpha=strength, linewidths=0, zorder=2.1 + share)


def _draw_ground(axes: Axes, scene: Scene, drop: float, look: Look) -> None:
    """Draw the parts that never move."""
    shift = np.array([0.0, drop])
    axes.add_collection(LineCollection(scene.floor, colors=FLOOR, linewidths=0.6 * look.line, zorder=0.4))
    still = scene.lines[0, scene.fixed_lines] + shift
    ground = LineCollection(still, colors=GROUND, linewidths=0.7 * look.line, zorder=1)
    ground.set_gid("ground")
    axes.add_collection(ground)
    pins = scene.points[0, scene.fixed_points] + shift
    axes.scatter(pins[:, 0], pins[:, 1], s=look.dot, color=GROUND, linewidths=0, zorder=1.1)


def _draw_paths(axes: Axes, scene: Scene, stop: int, drop: Any, look: Look) -> None:
    """Draw the paths of the moving points before time number ``stop``."""
    places = scene.points[:stop, ~scene.fixed_points] + np.stack([0 * drop, drop], axis=1)[:stop, None]
    paths = LineCollection(list(places.transpose(1, 0, 2)), colors=PATH, alpha=0.75, linewidths=0.45 * look.line, zorder=1.5)
    paths.set_gid("paths")
    axes.add_collection(paths)


def _pitch(scene: Scene) -> float:
    """Vertical distance between two phases that stand below one another."""
    width, height = np.ptp(scene.box, axis=0)
    return float(max((1 + ROW_GAP) * height, ROW_LEAST * width))


def _caption(scene: Scene, chosen: Any) -> str:
    t = scene.t[chosen]
    phases = f"{len(t)} phases, {(t[-1] - t[0]) / (len(t) - 1):.3g} s apart" if len(t) > 1 else "one phase"
    first = f"{scene.name}: t = {t[0]:.4g} to {t[-1]:.4g} s, {phases}; states: {scene.source}"
    return "\n".join(line for text in (first, *scene.notes) for line in textwrap.wrap(text, 110))


def _picture(figure: Figure) -> Image.Image:
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy()).quantize(COLOURS)


def _png(picture: Image.Image) -> bytes:
    memory = io.BytesIO()
    picture.save(memory, format="PNG", optimize=True)
    return memory.getvalue()
