"""Tolerances: the size of a step's local error against them, (H23) to (H26)."""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError
from solvers.hht.equations.formulas import CERTAIN, relative_tolerance, roundoff_of
from solvers.hht.step.state import State
from solvers.hht.step.stopping import weigh_part
from solvers.kernel.numbers import EPS, TINY
from solvers.kernel.sections import weighted_rms

AT_REST = 1e-7  # relative to the speed that applied forces alone give: less is roundoff of forces in balance


@dataclass(frozen=True)
class Tolerances:
    """Weights of the error norm: rtol times the size of each component plus atol."""

    rtol: Vector  #: (2n,) relative tolerances of q and v
    atol: Vector  #: (2n,) absolute tolerances of q [m, rad] and v [m/s, rad/s]

    @cached_property
    def finest(self) -> float:
        """Smallest relative tolerance."""
        return float(np.minimum.reduce(self.rtol))

    @cached_property
    def least(self) -> float:
        """Smallest absolute tolerance of q."""
        return float(np.minimum.reduce(self.atol[: self.atol.size // 2]))

    def warn(self, size_q: float) -> str:
        """Warn if atol exceeds ``size_q`` = max|q|, so that q is not controlled; returns the text, or ""."""
        if not 0.0 < size_q < self.least:
            return ""
        text = f"atol={self.least:g} exceeds the size of q, {size_q:.3g}: none of its digits is known to be right."
        warnings.warn(text, UserWarning, stacklevel=2)
        return text

    def size(self, before: State, after: State, error: Vector) -> float:
        """Size of the ``error`` (2n,) of q and v of a step over its tolerance, (H26)."""
        n, weights = after.q.size, np.empty_like(self.rtol)
        of_q = weigh_part(self.rtol[:n], self.atol[:n], before.q, after.q, after.size_q, weights[:n])
        of_v = weigh_part(self.rtol[n:], self.atol[n:], before.v, after.v, after.size_v, weights[n:])
        with np.errstate(over="ignore"):
            return float(weighted_rms(error, weights) / math.sqrt(relative_tolerance(of_q, of_v)))

    def roundoff(self, state: State, h: float = math.inf) -> float:
        """Size of the roundoff of q and v in a step of h [s] over its tolerance."""
        with np.errstate(over="ignore"):
            return self.size(state, state, np.concatenate(roundoff_of(state.q, state.v, h)))

    @property
    def above_roundoff(self) -> bool:
        """True if the tolerances exceed roundoff at the end of a long step, whatever the state's size."""
        return CERTAIN * self.finest**1.5 >= EPS

    def reachable(self, state: State, h: float) -> str:
        """Advice on tolerances that roundoff permits, where these lead to steps of h [s]; "" if roundoff is not the limit.

        The error allowed is proportional to tolerance^(3/2), (H26), and the roundoff of q over h to tolerance^(-1/2).
        """
        factor = max(self.roundoff(state) ** (2 / 3), self.roundoff(state, h) ** (1 / 2))
        if factor <= 1.0:
            return ""
        relative = max(self.finest, self.least / max(state.size_q, TINY))
        if factor * relative > 1.0:
            return "roundoff is reached at any tolerance: the motion is too fast for its sizes; check units and sizes."
        smallest = {"rtol": self.finest, "atol": float(self.atol.min())}
        values = ", ".join(f"{name}={factor * value:.1g}" for name, value in smallest.items() if value > 0)
        return f"roundoff is reached. Loosen the tolerances {factor:.2g} times, to {values}."


def make_tolerances(rtol: Any, atol: Any, start: State, applied: Vector) -> Tolerances:
    """Tolerances from a request; ``atol=None`` takes rtol times typical sizes of q and v at the start.

    That of q is max|q|, that of v the larger of max|v| and sqrt(max|v'| max|q|), as in a fall over |q|.  At rest, where
    v' is roundoff of forces that constraints balance, ``applied`` (n,), the applied forces over the mass, replaces v'.

    Raises
    ------
    ProblemError
        ``rtol`` or ``atol`` has neither one entry, nor n, nor 2n.
    """
    vdot = start.vdot
    n, size_q = vdot.size, start.size_q
    relative = components("rtol", 0.0 if rtol is None else rtol, n)
    if atol is None:
        absolute, typical = relative.copy(), size_q or 1.0
        absolute[:n] *= typical
        fall, free = (math.sqrt(float(np.maximum.reduce(np.abs(x))) * typical) for x in (vdot, applied))
        speed = max(start.size_v, fall)
        absolute[n:] *= (speed if speed > AT_REST * free else free) or 1.0
        return Tolerances(relative, absolute)
    return Tolerances(relative, components("atol", atol, n))


def components(name: str, value: Any, n: int) -> Vector:
    """Expand ``value`` (a number, (n,) or (2n,)) to all components of q and v, (2n,)."""
    if type(value) is float:
        given = np.empty(2 * n)
        given.fill(value)  # in a fifth of the time that np.full takes
        return given
    given = np.asarray(value, dtype=np.float64)
    if given.shape not in ((), (n,), (2 * n,)):
        raise ProblemError(f"{name} must be a number, ({n},) for q and v alike, or ({2 * n},); got shape {given.shape}.")
    return given.copy() if given.ndim and given.size == 2 * n else np.resize(given, 2 * n)
