"""The acceleration level by machine code of full matrices, for starts and rows: ten times as fast as in Python."""

from __future__ import annotations

import threading
from typing import Any

from hhtbench.lowering import Dynamics, NotNative
from hhtbench.lowering.dynamics.kkt_rows import Acceleration
from solvers.kernel import memory as mem
from solvers.kernel.compiled import shipped
from solvers.kernel.full import GOOD_START, of_full_matrices
from solvers.kernel.memory import copied, view


def compiled_level(dynamics: Dynamics) -> CompiledLevel | None:
    """The compiled acceleration level; None if the system's functions cannot be machine code."""
    try:
        return CompiledLevel(dynamics)
    except NotNative:
        return None


class CompiledLevel:
    """Compiled acceleration level of one system, with its memory.

    Raises
    ------
    NotNative
        The functions of the system cannot be machine code.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        places = of_full_matrices(dynamics)
        self._codes, z = places.codes, places.memory
        view(z, mem.START_BOUNDS)[:] = GOOD_START
        self._place, self._lam, self._mu, self._vdot = (view(z, name) for name in (mem.PLACE, mem.LAM, mem.MU, mem.VDOT))
        self._start, self._lock = shipped("start").following(z), threading.Lock()
        #: (rows [t, q, v, lam, mu], done): fills in multipliers and marks rows; thread-safe
        self.recover = shipped("recover").following(copied(z))

    def at(self, place: Any, guesses: Any) -> Acceleration | None:
        """Acceleration of the start at ``place``; None if it is not plainly good, or a guess has a wrong shape."""
        n = place.q.size
        with self._lock:
            for section, guess in zip((self._lam, self._mu), guesses, strict=True):
                if guess is not None and guess.shape != section.shape:
                    return None
                section[:] = 0.0 if guess is None else guess
            self._place[0], self._place[1 : 1 + n], self._place[1 + n :] = place.t, place.q, place.v
            if not self._start():
                return None
            return Acceleration(self._vdot.copy(), self._lam.copy(), self._mu.copy(), converged=True, singular=False)
