"""Rows and dense output that a run keeps of its steps, and their projection onto the constraints."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from hhtbench.lowering import Dynamics, padded
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.printing import exact
from hhtbench.solution.result import DenseOutput
from solvers.forms.form import Form

if TYPE_CHECKING:
    from solvers._projection import ProjectionFailure

#: (times (k,), q and v (k, n) to be projected in place, sizes (2n,)) -> a warning, or an empty text
Put = Callable[[Vector, Matrix, Matrix, Vector], "ProjectionFailure | str"]


INTEGRALS = ("Lam", "Mu")  # unknowns whose rates are the multipliers


@dataclass
class Kept:
    """Output rows collected during a run."""

    form: Form
    times: list[float] = field(default_factory=list)  #: [s]
    states: list[Vector] = field(default_factory=list)  #: (size,) each
    rates: list[Vector] = field(default_factory=list)  #: (m + p,) of the multipliers' integrals, where the library gives y'

    def keep(self, time: float, y: Any, rate: Callable[[], Any] | None) -> None:
        """Append a row; ``rate`` gives y' there."""
        self.times.append(time)
        self.states.append(np.array(y, dtype=np.float64))
        integrals = [self.form.blocks[name] for name in INTEGRALS if name in self.form.blocks]
        if rate is not None and integrals:
            yp = np.array(rate(), dtype=np.float64)
            self.rates.append(np.concatenate([yp[block] for block in integrals]))

    def drop_last(self) -> None:
        """Remove the last row."""
        del self.times[-1], self.states[-1], self.rates[-1:]

    @property
    def motion(self) -> tuple[Vector, Matrix, Matrix]:
        """Copies of t (k,), q and v (k, n)."""
        q, v = (part.copy() for part in self.form.state(self._y))
        return np.array(self.times), q, v

    @property
    def _y(self) -> Matrix:
        return np.array(self.states).reshape(-1, self.form.size)

    def multipliers(self, m: int) -> list[Matrix] | None:
        """The solver's own ``m`` lam and mu, (k, ...) each; None if its form has none."""
        if self.rates and len(self.rates) == len(self.times):
            return [part.copy() for part in np.split(np.array(self.rates), [m], axis=1)]
        blocks = self.form.blocks
        if "lam" not in blocks and "mu" not in blocks:
            return None
        return [self._y[:, blocks.get(name, slice(0, 0))] for name in ("lam", "mu")]

    def carried(self, dynamics: Dynamics) -> Mapping[str, Matrix] | None:
        """The solver's own multipliers by name, with zeros for redundant rows that it left out."""
        held = self.multipliers(dynamics.structure.m)
        return None if held is None else dict(zip(("lam", "mu"), padded(dynamics, *held), strict=True))


class OnConstraints:
    """``Solution.projection`` of a solve: projects states of dense output onto both levels of the constraints.

    Not pickled with a Solution, since it refers to the system's functions.

    Parameters
    ----------
    put
        Projects states.
    steps
        The dense output, with ``t``, ``q``, ``v`` at the ends of its steps.
    held
        True if the ends of steps are on the constraints already, so that they stay unchanged.
    """

    def __init__(self, dynamics: Dynamics, put: Put, steps: Any, *, held: bool) -> None:
        self._dynamics, self._put, self._steps, self._held = dynamics, put, steps, held

    def __call__(self, t: Any, found: DenseOutput) -> DenseOutput:
        """Project the states ``found`` at ``t``, scalar or (k,); warns where a projection fails."""
        if not self._dynamics.structure.constrained:
            return found
        times, steps = np.ravel(np.asarray(t, dtype=np.float64)), self._steps
        q, v = (np.array(x, dtype=np.float64).reshape(times.size, np.shape(x)[-1]) for x in found)
        which = np.ones(times.size, dtype=bool)
        if self._held:
            ends = np.flatnonzero(np.isin(times, steps.t))
            own = steps(times[ends])
            which[ends] = (own.q != q[ends]).any(axis=1) | (own.v != v[ends]).any(axis=1)
        from solvers._projection import sizes_from  # few ask for it

        moved = q[which], v[which]
        if text := str(self._put(times[which], *moved, sizes_from(steps.q, steps.v))):
            warnings.warn(text, UserWarning, stacklevel=3)
        q[which], v[which] = moved
        return DenseOutput(q.reshape(np.shape(found.q)), v.reshape(np.shape(found.v)))

    def __reduce__(self) -> Any:
        return type(None), ()


Piece = Callable[[float], Vector]  # time within one step, of the library's clock [s] -> y (size,)
SAMPLES = 13  # per step: polynomials of all libraries are of degree 12 at most (Adams' method)
NODES = 0.5 - 0.5 * np.cos(np.pi * (np.arange(SAMPLES) + 0.5) / SAMPLES)  # Chebyshev nodes on [0, 1]


class Pieces:
    """Dense output from a library's own interpolants, one per accepted step; exact at the ends of steps."""

    def __init__(self, first: Vector, blocks: tuple[slice, slice], t0: float) -> None:
        """Start with y ``first``; ``blocks``: slices of q and v in y; ``t0``: the problem's time [s] at clock 0."""
        self._blocks, self._t0, self._pieces = blocks, t0, list[Piece]()
        self._clock, self._ends, self._times = [0.0], [first], [t0]

    def append(self, clock: float, time: float, y: Vector, piece: Piece) -> None:
        """Add the step that ended at ``time`` [s] and y with its interpolant ``piece``."""
        self._clock.append(clock)
        self._times.append(time)
        self._ends.append(y)
        self._pieces.append(piece)

    @property
    def t(self) -> Vector:
        """Ends of the steps [s], (k,), the start first."""
        return np.array(self._times)

    @property
    def q(self) -> Matrix:
        """q at the ends of the steps, (k, n)."""
        return np.array(self._ends)[:, self._blocks[0]]

    @property
    def v(self) -> Matrix:
        """v at the ends of the steps, (k, n)."""
        return np.array(self._ends)[:, self._blocks[1]]

    def __call__(self, t: Any) -> DenseOutput:
        """q and v at ``t``: scalar -> (n,), (j,) -> (j, n).  Raises ProblemError outside the steps."""
        times, ends = np.ravel(np.asarray(t, dtype=np.float64)), self.t
        low, high = min(ends[0], ends[-1]), max(ends[0], ends[-1])
        if not np.all((times >= low) & (times <= high)):
            raise ProblemError(f"the solution covers [{exact(low)}, {exact(high)}] s; it is not extrapolated.")
        sign = -1.0 if ends[-1] < ends[0] else 1.0
        index = np.searchsorted(sign * ends, sign * times, side="left")
        y = np.array([self._at(float(time), int(i)) for time, i in zip(times, index, strict=True)])
        q, v = (y.reshape(times.size, self._ends[0].size)[:, block] for block in self._blocks)
        return DenseOutput(*(x.reshape(*np.shape(t), x.shape[1]) for x in (q, v)))

    def _at(self, time: float, i: int) -> Vector:
        """y at ``time`` [s] within step ``i``."""
        if time == self._times[i]:
            return self._ends[i]
        low, high = sorted(self._clock[i - 1 : i + 1])
        return self._pieces[i - 1](min(max(time - self._t0, low), high))


class Polynomial:
    """Interpolating polynomial through values at some times (barycentric formula)."""

    def __init__(self, times: Vector, values: Matrix) -> None:
        self._times, self._values = times, values
        self._weights = barycentric((times - times[0]) / (times[-1] - times[0]))

    def __call__(self, time: float) -> Vector:
        """Value (size,) at ``time`` [s]."""
        off = time - self._times
        if not off.all():
            return np.asarray(self._values[np.argmin(np.abs(off))])
        parts = self._weights / off
        return np.asarray(parts @ self._values / parts.sum())


def barycentric(x: Vector) -> Vector:
    """Barycentric weights of Lagrange interpolation at the nodes ``x``."""
    return np.asarray(1 / np.prod(x[:, None] - x[None, :] + np.eye(x.size), axis=1))
