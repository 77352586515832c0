"""Unknowns of a step, and its known values: Newmark weights, where reactions are evaluated, a0 for another step size."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, Structure
from solvers._finite import inverse_mass_at
from solvers.hht.equations.coefficients import Method
from solvers.kernel.memory import GIVEN, HEAD


@dataclass(frozen=True)
class Layout:
    """Unknowns of a step; hashable, selects the compiled code.

    The reaction of a stage is eliminated where it is an explicit function of the other unknowns; otherwise its
    acceleration ``R`` is an unknown with a row ``M R - Q = 0``.
    """

    structure: Structure
    moving: bool  #: True if the end reaction is evaluated at a q that depends on q1
    end_unknown: bool  #: True if R1 is an unknown: it acts on q1 and depends on q1 or v1, or M^-1 is unknown or full
    inverse_places: tuple[int, ...] | None = None  #: flat indices where M^-1 can differ from zero; None: all
    multipliers: tuple[str, ...] = ("lam0", "lam1")  #: names of the position constraints' multipliers
    extrapolated: bool = False  #: True if the reaction of extrapolated multipliers is an applied force, (H55)
    unknowns: dict[str, int] = field(init=False, compare=False)  #: names and sizes, in order; none of undeclared constraints
    size: int = field(init=False, compare=False)  #: number of unknowns

    def __post_init__(self) -> None:
        s = self.structure
        unknowns = {"a": s.n}
        if s.m:
            unknowns |= {"R0": s.n} if self.start_unknown else {}
            unknowns |= {"R1": s.n} if self.end_unknown else {}
            unknowns |= dict.fromkeys(self.multipliers, s.m)
        if s.p:
            unknowns |= {"Rk": s.n, "mu": s.p}
        object.__setattr__(self, "unknowns", unknowns)
        object.__setattr__(self, "size", sum(unknowns.values()))

    @property
    def start_unknown(self) -> bool:
        """True if R0 is an unknown, as M^-1 is full."""
        return self.structure.mass == "sparse"

    def sparse_inverse(self, inverse: Any, xp: Any) -> Any:
        """M^-1 (n, n) from its entries (n*n,), with known zeros set to the constant 0, so that they cost no products."""
        if self.inverse_places is not None:
            there = np.zeros(self.structure.n**2, dtype=bool)
            there[list(self.inverse_places)] = True
            inverse = xp.where(there, inverse, 0.0)
        return inverse.reshape(self.structure.n, -1)

    def split(self, vector: Any) -> dict[str, Any]:
        """Split ``vector`` (size,) into the unknowns by name."""
        return named(self.unknowns, vector)


def named(sizes: Mapping[str, int], vector: Any) -> dict[str, Any]:
    """Split ``vector`` into consecutive parts by name."""
    ends = np.cumsum(list(sizes.values()))
    return {name: vector[end - size : end] for (name, size), end in zip(sizes.items(), ends, strict=True)}


def known_values(dynamics: Dynamics, method: Method, layout: Layout, given: Any) -> dict[str, Any]:
    """Weights and known values of a step, as :func:`weighted`, from the vector ``given``."""
    start = started(dynamics, method, layout, given)
    values = weighted(method, layout, lambda t, q: inverse_mass_at(dynamics, t, q), start)
    if layout.structure.mass == "sparse":
        values["mass_diagonal"] = dynamics.mass(start["t"], start["q"]).diagonal
    return values


def start_of(layout: Layout, given: Any, xp: Any) -> dict[str, Any]:
    """Split ``given`` into the step and the state before it: GIVEN, HEAD, q, v, a, f, lam, mu, vdot, (H55), M^-1."""
    s, numbers = layout.structure, (*GIVEN, *HEAD)
    start: dict[str, Any] = dict(zip(numbers, given[: len(numbers)], strict=True))
    sizes = {"q": s.n, "v": s.n, "a": s.n, "f": s.n, "lam": s.m, "mu": s.p, "vdot": s.n}
    sizes |= dict.fromkeys(("lam_before", "lam_applied", "lam_ahead"), s.m) if layout.extrapolated else {}
    start |= named(sizes, given[len(numbers) :])
    moved = start["of_f"] * start["f"] + start["of_a"] * (start["a"] - start["f"])
    start["a0"] = xp.where(start["of_a"] == 1.0, start["a"], moved)
    at = len(numbers) + sum(sizes.values())
    inverse = given[at : at + s.n * s.n]
    start["inverse_mass"] = layout.sparse_inverse(inverse, xp) if s.mass == "variable" else None
    return start


def started(dynamics: Dynamics, method: Method, layout: Layout, given: Any) -> dict[str, Any]:
    """:func:`start_of`, with a0 corrected for the change of extrapolated multipliers in this step, (H56)."""
    start = start_of(layout, given, dynamics.xp)
    if layout.extrapolated:
        now, inverse = start["lam_applied"], start["inverse_mass"]
        change = start["lam_ahead"] - now - start["of_a"] * (now - start["lam_before"])
        force = dynamics.reaction(start["t"], start["q"], start["v"], change)
        rate = dynamics.over_mass(start["t"], start["q"], force) if inverse is None else inverse @ force
        start["a0"] = start["a0"] + method.coefficients.alpha * rate  # (H56)
    return start


def weighted(method: Method, layout: Layout, inverse_mass: Callable[..., Any], start: Mapping[str, Any]) -> dict[str, Any]:
    """Weights and known values of one step by name; pure array code.

    ``start``: t, h, t1 [s], ``from_end``, q, v, f, a0 (n,) and the inverse mass.
    """
    c, h, t1, from_end, a0 = method.coefficients, start["h"], start["t1"], start["from_end"], start["a0"]
    q, v = start["q"], start["v"]
    half = 0.5 * h * h
    values: dict[str, Any] = {
        "h": h,
        "t1": t1,
        "q_a": half * (2.0 * c.beta + (1.0 - 2.0 * c.beta) * from_end),
        "v_a": h * (c.gamma + (1.0 - c.gamma) * from_end),
        "q_known": q + h * v + half * (1.0 - 2.0 * c.beta) * a0,
        "v0": v,
        "v_known": v + h * (1.0 - c.gamma) * a0,
        "rate_a": 1.0 - c.alpha_m,
        "rate_known": (c.alpha - c.alpha_m) * start["f"],  # (H6)
        "end": 1.0 + c.alpha - c.alpha_m,
        "inverse_mass": start["inverse_mass"],
    }
    if c.alpha_m != 0.0:
        values["rate_known"] = values["rate_known"] + c.alpha_m * a0  # (H45)
    if layout.structure.m:
        values |= _reaction_values(method.reaction, c.b, start["t"], q, v, h, t1)
        if layout.structure.reaction_uses_v:
            share = 0.5 if method.reaction.startswith("midpoint") else 1.0
            values |= {"v_stage": (1.0 - share) * v, "theta_v": share}  # (H50)
        if layout.structure.mass == "variable" and not layout.end_unknown:
            values["inverse_mass_stage"] = inverse_mass(values["t_stage"], values["q_stage"])
    if layout.extrapolated:
        ahead, midpoint = start["lam_ahead"], method.reaction.startswith("midpoint")
        at_stage = 0.5 * (start["lam_applied"] + ahead) if midpoint else ahead
        values |= {"applied": ahead, "applied_lam1": at_stage}  # (H55)
    if layout.structure.p:
        values |= {"t_half": start["t"] + 0.5 * h, "q_half": q + 0.5 * h * v}  # (H10)
    return values


def _reaction_values(reaction: str, b: float, t: Any, q: Any, v: Any, h: Any, t1: Any) -> dict[str, Any]:
    """Weights of the two stage reactions, and where they are evaluated, (H8) with the predictor (H9)."""
    half, predicted = 0.5 * h * h, q + h * v  # (H9)
    values = {"t0": t, "q0": q, "q_R0": half * (1.0 - b), "q_R1": half * b, "v_R0": 0.5 * h, "v_R1": 0.5 * h}
    if reaction == "implicit":
        return values | {"t_stage": t1, "q_stage": 0.0 * q, "theta": 1.0}
    if reaction == "predictor":
        return values | {"t_stage": t1, "q_stage": predicted, "theta": 0.0}
    values |= {"v_R0": 0.0, "v_R1": h, "t_stage": t + 0.5 * h}
    if reaction == "midpoint":
        return values | {"q_stage": 0.5 * q, "theta": 0.5}
    return values | {"q_stage": 0.5 * (q + predicted), "theta": 0.0}
