"""Dense output of solvers: :class:`Pieces` of a library's own interpolant, and :class:`OnConstraints` what puts it there."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.lowering import Dynamics
from hhtbench.result import DenseOutput
from solvers._projection import Unmet

Put = Callable[[Vector, Matrix, Matrix, Vector], Unmet]  # times (k,), q and v (k, n) to be moved, sizes (2n,)


class Steps(Protocol):
    """Dense output that tells the ends of its steps."""

    t: Vector  #: (k,) [s]
    q: Matrix  #: (k, n)
    v: Matrix  #: (k, n)


class OnConstraints:
    """``Solution.projection`` of a solve: states of its dense output moved onto both levels of the constraints.

    It is not pickled with a Solution: it refers to the system's functions.

    Parameters
    ----------
    put
        Moves states.
    held
        Whether the ends of steps are on the constraints as they are: they keep their bits.
    """

    def __init__(self, dynamics: Dynamics, put: Put, steps: Steps, *, held: bool) -> None:
        self._constrained, self._put, self._steps, self._held = dynamics.structure.constrained, put, steps, held

    def __call__(self, t: Any, found: DenseOutput) -> DenseOutput:
        """``found`` at ``t``, scalar or (k,), on the constraints; warns where no state near it is."""
        if not self._constrained:
            return found
        times, steps = np.atleast_1d(np.asarray(t, dtype=np.float64)), self._steps
        q, v = (np.array(x, dtype=np.float64).reshape(times.size, -1) for x in found)
        which = ~np.isin(times, steps.t) if self._held else np.ones(times.size, dtype=bool)
        moved, sizes = (q[which], v[which]), np.concatenate([np.abs(x).max(axis=0) for x in (steps.q, steps.v)])
        if text := str(self._put(times[which], *moved, sizes)):
            warnings.warn(text, UserWarning, stacklevel=3)
        q[which], v[which] = moved
        return DenseOutput(q.reshape(np.shape(found.q)), v.reshape(np.shape(found.v)))

    def __reduce__(self) -> Any:
        return type(None), ()
