"""Line pieces for the drawings of problems: springs, supports, outlines; arrays (l, 2, d) of end points."""

from __future__ import annotations

from typing import Any

import numpy as np

HATCHES = 5  # strokes below a piece of ground


def chain(points: Any) -> Any:
    """Line pieces (k - 1, 2, d) from each of ``points`` (k, d) to the next."""
    points = np.asarray(points, dtype=float)
    return np.stack([points[:-1], points[1:]], axis=1)


def outline(corners: Any) -> Any:
    """Closed polygon (k, 2, d) through ``corners`` (k, d)."""
    corners = np.asarray(corners, dtype=float)
    return np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)


def box_lines(middle: Any, width: float, height: float) -> Any:
    """Rectangle (4, 2, 2) in the plane with centre ``middle`` (2,)."""
    half = np.array([width, height]) / 2
    return outline(np.asarray(middle) + half * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]))


def circle_lines(middle: Any, radius: float, pieces: int = 16) -> Any:
    """Circle (pieces, 2, 2) in the plane, as a polygon."""
    turn = np.linspace(0.0, 2 * np.pi, pieces, endpoint=False)
    return outline(np.asarray(middle) + radius * np.column_stack([np.cos(turn), np.sin(turn)]))


def spring_lines(a: Any, b: Any, coils: int = 5, width: float = 0.1) -> Any:
    """Spring (2 coils + 2, 2, 2) from ``a`` to ``b`` in the plane: straight ends and a zigzag ``width`` wide."""
    a, b = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
    along = b - a
    length = float(np.linalg.norm(along))
    across = np.array([-along[1], along[0]]) / length if length > 0 else np.zeros(2)
    share = np.concatenate([[0.0], np.linspace(0.15, 0.85, 2 * coils + 1), [1.0]])
    side = np.concatenate([[0.0, 0.0], np.where(np.arange(2 * coils - 1) % 2, -0.5, 0.5), [0.0, 0.0]])
    return chain(a + np.outer(share, along) + width * np.outer(side, across))


def ground_lines(left: Any, right: Any, depth: float) -> Any:
    """Ground line (1 + HATCHES, 2, 2) from ``left`` to ``right``, hatched on its right-hand side to ``depth``."""
    left, right = np.asarray(left, dtype=float), np.asarray(right, dtype=float)
    ahead = (right - left) / np.linalg.norm(right - left)
    down = depth * (np.array([ahead[1], -ahead[0]]) - 0.8 * ahead)
    feet = left + np.outer(np.linspace(0.2, 1.0, HATCHES), right - left)
    return np.concatenate([[[left, right]], np.stack([feet, feet + down], axis=1)])


def pin_lines(at: Any, size: float, up: float = -1.0) -> Any:
    """Pin support at ``at`` in the plane: a triangle on hatched ground below the pin, or above it with ``up=1``."""
    at = np.asarray(at, dtype=float)
    triangle = outline(at + size * np.array([(0.0, 0.0), (-0.6, up), (0.6, up)]))
    ends = at + size * np.array([(-1.0, up), (1.0, up)])
    left, right = ends if up < 0 else ends[::-1]
    return np.concatenate([triangle, ground_lines(left, right, 0.4 * size)])
