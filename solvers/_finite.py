"""Find the function of a system that returned a value that is not finite."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.sparse import csr_array

from hhtbench.lowering import Dynamics
from hhtbench.lowering.dynamics.products import large
from hhtbench.protocol.errors import NonFiniteValue


def as_arguments(dynamics: Dynamics, *values: Any) -> list[Any]:
    """Convert ``values`` to arrays of the namespace of ``dynamics``, for calls outside compiled code."""
    return list(values) if dynamics.xp is np else [dynamics.xp.asarray(value, dtype=float) for value in values]


def inverse_mass_at(dynamics: Dynamics, t: Any, q: Any) -> Any:
    """M^-1 (n, n) at (t, q); not finite where M is singular."""
    mass = dynamics.mass(t, q)
    if dynamics.xp is not np:
        from hhtbench.lowering.compile.inverse import inverse  # an operation of code, which plain callables have none of

        return inverse(mass)
    try:
        return np.linalg.inv(mass)
    except np.linalg.LinAlgError:  # compiled code raises nothing
        return np.full_like(mass, np.nan)


def expect_finite(function: str, value: Any, t: float) -> None:
    """Raise :class:`NonFiniteValue` for the first component of ``value`` that is not finite."""
    array = np.asarray(value.data if isinstance(value, csr_array) else value)
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise NonFiniteValue(function, where, float(array[where]), t)


MAX_SQUARED = math.sqrt(float(np.finfo(np.float64).max))  # the square of more overflows


def explain_nonfinite(d: Any, t: Any, q: Any, v: Any, otherwise: str = "the step's residual") -> None:
    """Raise :class:`NonFiniteValue` naming the function of ``d`` that is not finite at (t, q, v).

    Called only after a failure; if each function by itself is finite, the error names ``otherwise``.
    """
    products = large(d)
    d, full = (d, True) if products is None else (products, False)
    s = d.structure
    t, q, v = as_arguments(d, t, q, v)
    candidates = {"force": lambda: d.force(t, q, v)}
    if d.wraps and d.entries is not None:
        candidates["mass_matrix"] = lambda: d.inner.mass(t, q)
    if s.mass != "identity" and full:
        candidates["mass_matrix"] = lambda: d.mass(t, q)
        candidates["the inverse of mass_matrix"] = lambda: inverse_mass_at(d, t, q)
    if s.m:
        candidates["constraint"] = lambda: d.constraint(t, q)
        if full:
            candidates["constraint_jacobian"] = lambda: d.constraint_jacobian(t, q)
        candidates["constraint_velocity"] = lambda: d.constraint_velocity(t, q, v)
        candidates["constraint_acceleration"] = lambda: d.constraint_acceleration(t, q, v)
        candidates["reaction"] = lambda: d.reaction(t, q, v, d.xp.zeros(s.m))
    if s.p:
        candidates["velocity_constraint"] = lambda: d.velocity_constraint(t, q, v)
        if full:
            candidates["velocity_constraint_jacobian"] = lambda: d.velocity_constraint_jacobian(t, q, v)
        candidates["velocity_reaction"] = lambda: d.velocity_reaction(t, q, v, d.xp.zeros(s.p))
    if full:
        zero = np.zeros((s.n, s.n))
        candidates["force_jacobians"] = lambda: np.stack([zero if x is None else x for x in d.force_jacobians(t, q, v)])
    for name, function in candidates.items():
        expect_finite(name, function(), float(t))
    force = np.asarray(d.force(t, q, v))
    most = int(np.abs(force).argmax())
    note = f", where products with force[{most}] = {force[most]:.3g} overflow" if abs(force[most]) > MAX_SQUARED else ""
    raise NonFiniteValue(otherwise, (), float("nan"), float(t), note)
