"""Terms of a step's local error, (H23) to (H25), (H59); :mod:`~solvers.hht.control.estimate` filters it."""

from __future__ import annotations

from typing import Any

from hhtbench.lowering import Dynamics
from solvers.hht.equations.applied import applied_force
from solvers.hht.equations.coefficients import Method
from solvers.hht.equations.discretise import scaled_rows
from solvers.hht.equations.known import Layout, named, start_of, started
from solvers.kernel.memory import CONTROL_NUMBERS

REMEMBERED = ("earlier", "acceleration", "reaction_k")  # vectors (n,): f + r at -last and at 0, R_k


def raw_errors(dynamics: Dynamics, method: Method, layout: Layout, x: Any, given: Any, remembered: Any, end: Any) -> Any:
    """Unfiltered errors: imbalances that cause the errors of q1 and of v1, then f + r at the end of the step, (3n,).

    Parameters
    ----------
    x
        The unknowns of the step (size,).
    given
        The step and the state before it, as :func:`~solvers.hht.equations.known.start_of` takes them.
    remembered
        CONTROL, then REMEMBERED.
    end
        :func:`~solvers.hht.equations.corrections.state_after`, and M^-1 there where it varies.
    """
    s, xp = dynamics.structure, dynamics.xp
    before, after = started(dynamics, method, layout, given), layout.split(x)
    memory = dict(zip(CONTROL_NUMBERS, remembered, strict=False))
    memory |= named(dict.fromkeys(REMEMBERED, s.n), remembered[len(CONTROL_NUMBERS) :])
    after |= _ended(layout, end)
    force = after["f1"] + _reaction(dynamics, method, layout, before, after)
    h, last = before["h"], memory["last"]
    raw_v = after["v1"] - before["v"] - parabola(last, h, memory["earlier"], memory["acceleration"], force)  # (H25)
    return xp.concatenate([_position(dynamics, method, before, after, memory), raw_v, force])


def _ended(layout: Layout, end: Any) -> dict[str, Any]:
    """Split ``end`` into the quantities at the end of the step by name."""
    s = layout.structure
    names = {"q1": s.n, "v1": s.n, "a1": s.n, "f1": s.n, "lam1": s.m, "mu": s.p, "rate": s.n}
    names |= dict.fromkeys(("R0", "R1"), s.n) if s.m else {}
    return named(names | ({"inverse_mass": s.n * s.n} if s.mass == "variable" else {}), end)


def answer(dynamics: Dynamics, method: Method, layout: Layout, error: Any, given: Any, end: Any) -> Any:
    """Change of the force rows (n,) due to an ``error`` of q1 (n,), (H59).

    ``given`` and ``end`` as in :func:`raw_errors`.
    """
    before, after = start_of(layout, given, dynamics.xp), _ended(layout, end)
    applied = {"applied": before["lam_ahead"]} if layout.extrapolated else {}
    moved = applied_force(dynamics, applied, before["t1"], after["q1"] + error, after["v1"])
    change = _over_mass(dynamics, layout, after, before["t1"], moved) - after["f1"]
    return -(1 + method.coefficients.alpha) * change


def _position(dynamics: Dynamics, method: Method, before: Any, after: Any, memory: Any) -> Any:
    """Return the local error of q1 over h^2, before its projection P1 onto the constraints (n,) [m/s^2], (H23)."""
    c, h, xp = method.coefficients, before["h"], dynamics.xp
    raw = (1 + 3 * c.alpha**2) / 12 * (after["a1"] - (before["a0"] + before["from_end"] * after["a"]))
    if dynamics.structure.m:
        twice = 2.0 if method.reaction.startswith("midpoint") else 1.0
        raw = raw + twice * (3 * c.b - 1) / 6 * (after["R1"] - after["R0"])
    if dynamics.structure.p:
        weight = xp.where(memory["has_reaction_k"] > 0.0, h / (6 * (h + memory["last"])), 0.0)
        raw = raw + weight * (after["Rk"] - memory["reaction_k"])
    return raw


def _reaction(dynamics: Dynamics, method: Method, layout: Layout, before: Any, after: Any) -> Any:
    """Acceleration r (n,) by the reactions at the end of the step, with multipliers of second order, (H24)."""
    s, xp, force, h, t1 = dynamics.structure, dynamics.xp, 0.0, before["h"], before["t1"]
    share = xp.where(before["last"] == 0.0, 1.0, h / (h + before["last"]))  # share of the change of r that is still to come
    if s.m:
        first = after["lam0"] + before["lam_applied"] if layout.extrapolated else after["lam0"]
        change = after["lam1"] if method.reaction.startswith("midpoint") else first
        lam = after["lam1"] + share * (change - before["lam"])
        lam = lam - before["lam_ahead"] if layout.extrapolated else lam  # f holds the others, (H55)
        force = dynamics.reaction(t1, after["q1"], after["v1"], lam)
    if s.p:
        mu = after["mu"] + share * (after["mu"] - before["mu"])
        force = force + dynamics.velocity_reaction(t1, after["q1"], after["v1"], mu)
    return _over_mass(dynamics, layout, after, t1, force) if s.constrained else force


def _over_mass(dynamics: Dynamics, layout: Layout, after: Any, t1: Any, x: Any) -> Any:
    """M^-1 x (n,) at the end of the step."""
    if dynamics.structure.mass == "variable":
        return layout.sparse_inverse(after["inverse_mass"], dynamics.xp) @ x
    return dynamics.over_mass(t1, after["q1"], x)


def scaled_inertia(dynamics: Dynamics, layout: Layout, x: Any, given: Any) -> Any:
    """Force rows of the accelerations ``x`` (n,) in a step whose mass is sparse; ``given``: the step."""
    start = start_of(layout, given, dynamics.xp)
    mass = dynamics.mass(start["t"], start["q"])
    return scaled_rows(dynamics, {"mass_diagonal": mass.diagonal}, mass @ x)


def parabola(last: Any, h: Any, earliest: Any, start: Any, end: Any) -> Any:
    """Integral over [0, h] of the quadratic through the values at -last, 0 and h, (H25)."""
    back = -(h**3) / (6 * last * (last + h))
    ahead = h * (2 * h + 3 * last) / (6 * (h + last))
    return back * earliest + (h - back - ahead) * start + ahead * end
