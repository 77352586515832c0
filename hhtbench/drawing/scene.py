"""Points and lines over time, projected onto the plane of the paper."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.drawing.motion import Course, draw_state
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem

AZIMUTH, HEIGHT = np.radians(-60.0), np.radians(22.0)  # of the eye, for sketches in space; parallel projection
STILL = 1e-4  # movement over size below which a piece belongs to the ground: a tenth of a pixel, more than drift
MARGIN = 0.06  # of the floor around the motion


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A motion in the plane of the paper."""

    name: str
    t: Vector  #: (k,) [s]
    points: Any  #: (k, j, 2)
    lines: Any  #: (k, l, 2, 2)
    fixed_points: Any  #: (j,) True where a point never moves
    fixed_lines: Any  #: (l,)
    floor: Any  #: (4, 2, 2) outline of the floor below a motion in space, (0, 2, 2) in the plane
    shadows: Any  #: (k, l, 2, 2) of the moving lines on the floor, (k, 0, 2, 2) in the plane
    source: str  #: where the states come from
    notes: tuple[str, ...]  #: what the reader must know: where it was cut off, what is magnified

    @property
    def box(self) -> Any:
        """(2, 2): lowest and highest corner of all points and lines."""
        every = np.concatenate([self.points.reshape(-1, 2), self.lines.reshape(-1, 2), self.floor.reshape(-1, 2)])
        return np.array([every.min(axis=0), every.max(axis=0)])

    @property
    def along_a_line(self) -> bool:
        """True if nothing moves up or down on the paper, so that phases on top of one another would show nothing."""
        size = np.ptp(self.box, axis=0).max()
        moves = [np.ptp(x[..., 1], axis=0).max(initial=0.0) for x in (self.points, self.lines)]
        return not len(self.floor) and len(self.t) > 1 and max(moves) <= STILL * size

    def pick(self, count: int) -> Any:
        """Return the indices of ``count`` times, equally spaced from the first to the last."""
        return np.unique(np.round(np.linspace(0, len(self.t) - 1, count)).astype(int))


def make_scene(problem: Problem, course: Course) -> Scene:
    """Evaluate the sketch at every state of ``course`` and project it.

    Raises
    ------
    ProblemError
        The number of its points or lines changes along the motion.
    """
    drawings = [draw_state(problem, q) for q in course.q]
    if len({(points.shape, lines.shape) for points, lines, _ in drawings}) > 1:
        raise ProblemError(f"{problem.name}: sketch(q) must return the same number of points and lines at every q.")
    points, lines = (np.array([drawing[i] for drawing in drawings]) for i in (0, 1))
    size = max(np.ptp(x.reshape(-1, x.shape[-1]), axis=0).max() for x in (points, lines) if x.size)
    fixed = [np.ptp(x, axis=0).reshape(x.shape[1], -1).max(axis=1, initial=0.0) <= STILL * size for x in (points, lines)]
    if len(course.t) == 1:
        fixed = [np.zeros_like(flags) for flags in fixed]  # one state does not show what moves
    floor, shadows = np.zeros((0, 2, 2)), np.zeros((len(points), 0, 2, 2))
    if points.shape[-1] == 3:
        floor, shadows = (project(x) for x in _floor(points, lines, fixed[1]))
        points, lines = project(points), project(lines)
    return Scene(
        name=problem.name,
        t=course.t,
        points=points,
        lines=lines,
        fixed_points=fixed[0],
        fixed_lines=fixed[1],
        floor=floor,
        shadows=shadows,
        source=course.source,
        notes=tuple(text for text in (course.stopped, drawings[0][2]) if text),
    )


def project(places: Any) -> Any:
    """Project points (..., 3) to the paper (..., 2), seen from AZIMUTH and HEIGHT with the third axis up."""
    right = np.array([-np.sin(AZIMUTH), np.cos(AZIMUTH), 0.0])
    up = np.array([-np.sin(HEIGHT) * np.cos(AZIMUTH), -np.sin(HEIGHT) * np.sin(AZIMUTH), np.cos(HEIGHT)])
    return places @ np.column_stack([right, up])


def _floor(points: Any, lines: Any, fixed: Any) -> tuple[Any, Any]:
    """Return the outline of the floor at the lowest point, and the shadows of the moving lines on it."""
    every = np.concatenate([points.reshape(-1, 3), lines.reshape(-1, 3)])
    low, high = every.min(axis=0), every.max(axis=0)
    margin = MARGIN * (high - low)[:2].max()
    (x0, y0), (x1, y1) = low[:2] - margin, high[:2] + margin
    corners = np.array([(x0, y0, low[2]), (x1, y0, low[2]), (x1, y1, low[2]), (x0, y1, low[2])])
    shadows = lines[:, ~fixed].copy()
    shadows[..., 2] = low[2]
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), shadows
