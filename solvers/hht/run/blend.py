"""Multipliers of rows between steps: interpolation of those at the ends of nearby steps, (H60)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hhtbench.protocol.arguments import Matrix, Vector

AROUND = np.arange(-1, 3)  # offsets of the ends of a row's step, and of one end before and one after
OUTER = [0, 3]
MAX_STEP_RATIO = 3.0  # to a shorter neighbouring step that is used: magnitudes of weights then sum to 2.2 at most


class StepEnds(NamedTuple):
    """Ends of steps in the order of the motion; two with one time where an event has changed the state."""

    t: Vector  #: (s,) [s]
    states: Matrix  #: (s, 2n) q and v

    def around(self, times: Vector) -> Any:
        """(k, 4) indices of the ends around each of ``times`` (k,); one is repeated at the first and last step."""
        direction = -1.0 if self.t[-1] < self.t[0] else 1.0
        before = np.searchsorted(direction * self.t, direction * times, "right") - 1
        return np.clip(before[:, None] + AROUND, 0, self.t.size - 1)


def weights_at(times: Vector, nodes: Matrix) -> Matrix:
    """(k, 4) Lagrange weights at ``times`` (k,) for the usable ones of the ``nodes`` (k, 4) [s].

    An outer node is not usable if its step is much shorter than the row's, or of length zero: the node is repeated, or a
    change of state lies between.
    """
    lengths, serve = np.abs(np.diff(nodes, axis=1)), np.ones(nodes.shape, dtype=bool)
    serve[:, OUTER] = MAX_STEP_RATIO * lengths[:, [0, 2]] >= lengths[:, [1]]
    others = serve[:, :, None] & serve[:, None, :] & ~np.eye(4, dtype=bool)
    distances = np.where(others, nodes[:, :, None] - nodes[:, None, :], 1.0)
    return np.where(others, (times[:, None] - nodes)[:, None, :] / distances, 1.0).prod(axis=2) * serve


def blend(rows: Matrix, steps: StepEnds, recover: Callable[[Matrix, Any], Any]) -> Any:
    """Put interpolated multipliers into ``rows`` (k, ...) [t, q, v, lam, mu] between the ends of ``steps``.

    ``recover(places, found)`` solves (H16) for such rows.  Returns a mask (k,) of rows for which all were found.
    """
    behind = 1 + steps.states.shape[1]  # where the multipliers begin
    ends = steps.around(rows[:, 0])
    weights = weights_at(rows[:, 0], steps.t[ends])
    row, which = np.nonzero(weights)
    places, found = rows[row], np.zeros(row.size, dtype=bool)
    places[:, 1:behind] = steps.states[ends[row, which]]
    recover(places, found)
    first = np.flatnonzero(np.diff(row, prepend=-1))
    done = np.logical_and.reduceat(found, first)
    blended = np.add.reduceat(places[:, behind:] * weights[row, which, None], first)  # (H60)
    rows[done, behind:] = blended[done]
    return done
