"""Accelerations and multipliers by compiled loops: of a start that is plainly good, and of rows of output.

In Python the acceleration level of one row takes as long as ten rows here.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import Work, uncounted
from hhtbench.lowering import Dynamics, NotNative, derive, route_of
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.compiling import too_large
from hhtbench.lowering.dynamics.kkt import Acceleration
from hhtbench.protocol import NumpySystem, System, declared
from solvers._start import Guesses, Place, of_dynamics
from solvers.kernel import acceleration
from solvers.kernel import memory as mem
from solvers.kernel.blocks import FEW, in_blocks
from solvers.kernel.kkt import GOOD_START, kkt_of, of_full_matrices, plain_mass
from solvers.kernel.memory import copied, view

BLOCK = 256  # rows of the first call

Recover = Callable[[Matrix, Any], Any]  # (rows [t, q, v, lam, mu], done): fills rows and marks them

_known = Cache(16)


class SmallLevel:
    """Starts and rows of one system by machine code of full matrices, solved by LAPACK.

    Raises
    ------
    NotNative
        Its functions cannot be machine code.
    """

    def __init__(self, dynamics: Dynamics) -> None:
        places, known = of_full_matrices(dynamics), of_dynamics(dynamics)
        self._codes, z = places.codes, places.memory
        view(z, mem.START_BOUNDS)[:] = GOOD_START
        self._place, self._lam, self._mu, self._vdot = (view(z, name) for name in (mem.PLACE, mem.LAM, mem.MU, mem.VDOT))
        self._start, self._lock = acceleration.start.following(z), threading.Lock()
        self.recover = acceleration.recover.following(copied(z))  # of many threads at once: nothing is left there
        #: whether nothing but the place tells whether a start is good
        self.judges = plain_mass(dynamics) and not known.compared and not declared(dynamics.system, "sparsity")

    def at(self, place: Place, guesses: Guesses) -> Acceleration | None:
        """Of the start at ``place``; None where it is not plainly good, or a guess is of another system."""
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


def small_level(dynamics: Dynamics) -> SmallLevel | None:
    """Remembered; None of a system that is large, or whose functions are no machine code.

    It depends on the system only: where code served once it was there, results would depend on what was solved before.
    """
    found: SmallLevel | None = _known.find(by_id(dynamics), lambda: _small_level(dynamics))
    return found


def _small_level(dynamics: Dynamics) -> SmallLevel | None:
    if route_of(dynamics) == "numpy" or not dynamics.matrices or too_large(dynamics) is not None:
        return None
    try:
        return SmallLevel(dynamics)
    except NotNative:
        return None


def plain_start(
    system: System | NumpySystem, place: Place, guesses: Guesses, work: Work
) -> tuple[Dynamics, Acceleration] | None:
    """The dynamics, and accelerations and multipliers at a start that is plainly good; None where Python looks closer."""
    if not issubclass(type(system), System):
        return None
    with uncounted():
        dynamics = derive(system, place.t, place.q, place.v)
    level = small_level(dynamics)
    found = level.at(place, guesses) if level is not None and level.judges else None
    if found is None:
        return None
    work.add("residual_evaluations")
    return dynamics, found


def recovered(
    dynamics: Dynamics, work: Work, recover: Recover | None, times: Vector, q: Matrix, v: Matrix, lam: Matrix, mu: Matrix
) -> Any:
    """Which rows (k,) got their multipliers from the acceleration level in ``lam`` and ``mu``; counted.

    By ``recover``, or other machine code; none where there is none.
    """
    done = np.zeros(times.size, dtype=bool)
    recover = recover or _by_machine_code(dynamics, times.size)
    if recover is None:
        return done
    rows = np.concatenate([times[:, None], q, v, lam, mu], axis=1)
    in_blocks(times.size, BLOCK, lambda block: recover(rows[block], done[block]), lambda: work.clock.left() >= 0.0)
    found = rows[done, 1 + 2 * q.shape[1] :]
    lam[done], mu[done] = found[:, : lam.shape[1]], found[:, lam.shape[1] :]
    work.add("residual_evaluations", int(done.sum()))
    return done


def _by_machine_code(dynamics: Dynamics, count: int) -> Recover | None:
    """Of full matrices, or where ``count`` rows pay for it by the entries of larger ones."""
    level = small_level(dynamics)
    if level is not None:
        return level.recover
    entries = kkt_of(dynamics) if count >= FEW and route_of(dynamics) != "numpy" else None
    return None if entries is None else acceleration.recover.following(entries.memory(dynamics))
