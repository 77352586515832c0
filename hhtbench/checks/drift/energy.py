"""Energy balance: change of the energy since the start minus the integral of the declared power."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from hhtbench.lowering import Dynamics, compile_function
from hhtbench.lowering.dynamics.kkt_rows import kkt_terms
from hhtbench.protocol.arguments import Matrix, Vector

States = tuple[Vector, Matrix, Matrix]  # t (k,), q and v (k, n)
KNOWN = 0.5  # largest error of the power's integral, over the imbalance:
FINE = 1e-6  # or to that part of the scale


class Balance(NamedTuple):
    """Imbalance of the energy at every state divided by its scale, or None and the reason."""

    drift: Vector | None  #: (k,)
    note: str | None


class Fed(NamedTuple):
    """Integral of the power since the start at every state, (k,) [J]."""

    energy: Vector
    error: Vector  #: by how much two rules differ


def power_needs_multipliers(dynamics: Dynamics, t: float, q: Vector, v: Vector) -> bool:
    """True if the declared power depends on lam or mu (it is NaN for NaN multipliers)."""
    s = dynamics.structure
    found = compile_function(power_with, dynamics, route="xla")(t, q, v, np.full(s.m, np.nan), np.full(s.p, np.nan))
    return not np.isfinite(found).all()


def power_with(dynamics: Dynamics, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
    """Declared power [W] with these multipliers, (1,)."""
    return dynamics.xp.reshape(dynamics.system.power(t, q, v, lam, mu), (1,))


def power_of_state(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """Declared power [W] if it does not depend on the multipliers, (1,)."""
    s, xp = dynamics.structure, dynamics.xp
    return power_with(dynamics, t, q, v, xp.zeros(s.m), xp.zeros(s.p))


def power_of_level(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """Declared power [W] with the multipliers of the acceleration level, in which it must be linear, (1,)."""
    return power_with(dynamics, t, q, v, *_recovered(dynamics, t, q, v))


def with_middles(states: States) -> States:
    """Return the states and those half-way between them by the cubic through q and v, (2k - 1, ...)."""
    t, first = np.unique(states[0], return_index=True)
    curve: Any = CubicHermiteSpline(t, states[1][first], states[2][first])
    times = np.sort(np.concatenate([t, (t[1:] + t[:-1]) / 2]))
    return times, curve(times), curve(times, 1)


def fed_by(t: Vector, times: Vector, power: Vector) -> Fed:
    """Integrate ``power`` (2k - 1,) [W] over ``times`` with midpoints, up to every ``t``, by Simpson's rule and a spline."""
    h, ends, middles = np.diff(times[::2]), power[::2], power[1::2]
    simpson = np.append(0.0, np.cumsum(h / 6 * (ends[:-1] + 4 * middles + ends[1:])))
    spline = CubicSpline(times[::2], ends).antiderivative()(times[::2]) if h.size > 1 else h.sum() * np.append(0.0, ends[1:])
    places = np.searchsorted(times[::2], t)
    error = np.abs(simpson - spline)
    return Fed((simpson - simpson[places[0]])[places], error[places] + error[places[0]])


def balance(energy: Vector, kinetic: Vector, fed: Fed) -> Balance:
    """Return the change of ``energy`` (k,) [J] minus the work fed in, over the largest of energy, kinetic energy and work.

    This is an upper bound: the difference of two rules for the integral of the power is added.
    """
    off = np.abs(energy - energy[0] - fed.energy)
    scale = max(abs(energy[0]), float(np.max(kinetic)), float(np.max(np.abs(fed.energy)))) or 1.0
    if np.max(fed.error) > max(KNOWN * np.max(off), FINE * scale):
        return Balance(None, f"the integral of the power over the steps is known to {np.max(fed.error) / scale:.1g} only")
    return Balance((off + fed.error) / scale, None)


def _recovered(dynamics: Dynamics, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
    """Return lam (m,) and mu (p,) of the acceleration level; not finite, or an exception, if they are not determined."""
    s, xp = dynamics.structure, dynamics.xp
    size = s.n + s.m + s.p
    packed = kkt_terms(dynamics, t, q, v, xp.zeros(size))
    x = -xp.linalg.solve(packed[size:].reshape(size, size), packed[:size])
    return x[s.n : s.n + s.m], x[s.n + s.m :]
