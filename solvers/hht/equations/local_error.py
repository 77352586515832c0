"""What the local error of a step is made of, (H23) to (H25), before :mod:`~solvers.hht.estimate` filters it.

Backend-neutral, so that every engine traces or calls the same lines: all that is known travels in one vector.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hhtbench.lowering import Dynamics
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.layout import Layout

SCALARS = ("h", "last", "share", "weight_k")


def inputs(layout: Layout) -> dict[str, int]:
    """Names and sizes of the arrays that :func:`raw_errors` takes after its scalars, in order."""
    s = layout.structure
    sizes = {"t1": 1, "q1": s.n, "v1": s.n, "v0": s.n, "a0": s.n, "a1": s.n, "f1": s.n, "earlier": s.n, "acceleration": s.n}
    if s.m:
        sizes |= {"R0": s.n, "R1": s.n, "lam": s.m, "lam_start": s.m, "lam_end": s.m}
    if s.p:
        sizes |= {"Rk": s.n, "Rk_before": s.n, "mu": s.p, "mu_half": s.p}
    return sizes | ({"inverse_mass": s.n * s.n} if s.mass == "variable" else {})


def raw_errors(dynamics: Dynamics, method: Method, layout: Layout, given: Any) -> Any:
    """Imbalances that make the errors of q1 and of v1, unfiltered, and f + r at the end of the step: (3n,).

    Parameters
    ----------
    given
        ``h``, the time ``last`` [s] before it, the ``share`` of a change of the multipliers that is still to come, the
        weight ``weight_k`` of the change of R_k, then :func:`inputs`: v0, a0, lam, mu before the step, the others of it;
        ``earlier`` and ``acceleration`` are f + r at -last and 0.
    """
    known, at = dict(zip(SCALARS, given[: len(SCALARS)], strict=True)), len(SCALARS)
    for name, size in inputs(layout).items():
        known[name], at = given[at : at + size], at + size
    if "inverse_mass" in known:
        known["inverse_mass"] = layout.sparse_inverse(known["inverse_mass"], dynamics.xp)
    end = known["f1"] + _reaction(dynamics, method, known)
    raw_v = (
        known["v1"] - known["v0"] - parabola(known["last"], known["h"], known["earlier"], known["acceleration"], end)
    )  # (H25)
    return dynamics.xp.concatenate([_position(dynamics, method, known), raw_v, end])


def _position(dynamics: Dynamics, method: Method, known: Mapping[str, Any]) -> Any:
    """(H23), (n,)."""
    c = method.coefficients
    raw = (1 + 3 * c.alpha**2) / 12 * (known["a1"] - known["a0"])
    if dynamics.structure.m:
        twice = 2.0 if method.reaction.startswith("midpoint") else 1.0
        raw = raw + twice * (3 * c.b - 1) / 6 * (known["R1"] - known["R0"])
    if dynamics.structure.p:
        raw = raw + known["weight_k"] * (known["Rk"] - known["Rk_before"])
    return raw


def _reaction(dynamics: Dynamics, method: Method, known: Mapping[str, Any]) -> Any:
    """r at the end of the step with multipliers of second order, (n,), (H24)."""
    s, force = dynamics.structure, 0.0
    if s.m:
        change = known["lam_end"] if method.reaction.startswith("midpoint") else known["lam_start"]
        lam = known["lam_end"] + known["share"] * (change - known["lam"])
        force = dynamics.reaction(known["t1"][0], known["q1"], lam)
    if s.p:
        mu = known["mu_half"] + known["share"] * (known["mu_half"] - known["mu"])
        force = force + dynamics.velocity_reaction(known["t1"][0], known["q1"], known["v1"], mu)
    if not s.constrained:
        return force
    if s.mass == "variable":
        return known["inverse_mass"] @ force
    return force if dynamics.inverse_mass is None else dynamics.inverse_mass @ force


def parabola(last: Any, h: Any, earliest: Any, start: Any, end: Any) -> Any:
    """The integral over [0, h] of the quadratic through the values at -last, 0 and h, (H25)."""
    back = -(h**3) / (6 * last * (last + h))
    ahead = h * (2 * h + 3 * last) / (6 * (h + last))
    return back * earliest + (h - back - ahead) * start + ahead * end


def levels(dynamics: Dynamics, t: Any, q: Any, v: Any) -> Any:
    """g, g_t + g_q v, then k, (2 m + p,)."""
    rows = [dynamics.constraint(t, q), dynamics.constraint_velocity(t, q, v)] if dynamics.structure.m else []
    rows += [dynamics.velocity_constraint(t, q, v)] if dynamics.structure.p else []
    return dynamics.xp.concatenate(rows)
