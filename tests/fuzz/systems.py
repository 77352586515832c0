"""A mechanism as solvers take it: a NumpySystem, or a System whose machine code serves every mechanism of its shape."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial, wraps

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from tests.fuzz import formulas
from tests.fuzz.mechanism import PARAMETERS, Mechanism, Shape

OF_FUNCTIONS = ("nan", "raise", "wrong")  # spoils; others are of numbers


class Planted(Exception):
    """What a function of a system raises on purpose."""


@dataclass(frozen=True)
class Spoil:
    """A fault of the user's."""

    kind: str  #: "nan", "raise", "wrong" of a function, "off" of the start, "units", "massless"
    where: str = ""  #: the function's name
    since: float = 0.0  #: [s] from the start on, of "nan" and "raise"; how wrong, of others


def physics(xp, shape: Shape) -> dict:
    """The functions of a system by their declared names, of its parameters and the declared arguments."""
    found = {
        "mass_matrix": lambda p, t, q: xp.diag(formulas.masses(xp, shape, p, q)),
        "force": lambda p, t, q, v: formulas.force(xp, shape, p, t, q, v),
    }
    if shape.rods:
        found["constraint"] = lambda p, t, q: formulas.constraint(xp, shape, p, t, q)
    if shape.blade:
        found["velocity_constraint"] = lambda p, t, q, v: formulas.blade(xp, shape, p, q, v)
    if shape.reaction == "friction":
        found["reaction"] = lambda p, t, q, v, lam: formulas.reaction(xp, shape, p, t, q, v, lam)
    elif shape.reaction:
        found["reaction"] = lambda p, t, q, lam: formulas.reaction(xp, shape, p, t, q, 0.0 * q, lam)
    return found


def derivatives(shape: Shape, p) -> dict:
    """What may be declared beside them, on NumPy arrays."""
    found = {"force_jacobians": partial(formulas.force_jacobians, shape, p)}
    if shape.rods:
        of_rods = {
            "jacobian": formulas.jacobian,
            "time_derivative": formulas.time_derivative,
            "acceleration": formulas.curvature,
        }
        found |= {f"constraint_{name}": partial(function, np, shape, p) for name, function in of_rods.items()}
    if shape.blade:
        found["velocity_constraint_jacobian"] = lambda t, q, v: formulas.blade_row(np, shape, p, q)
    return found


def numpy_system(made: Mechanism, *, declares: bool = True, spoil: Spoil | None = None) -> hb.NumpySystem:
    """With derivatives, or, unless it ``declares`` them, without; ``spoil`` breaks one function."""
    shape, p = made.shape, made.p
    found = {name: partial(function, p) for name, function in physics(np, shape).items()}
    if not shape.growing:
        found["mass_matrix"] = found["mass_matrix"](p.t0, p.places.ravel())
    if declares:
        found |= derivatives(shape, p)
    if spoil is not None and spoil.kind in OF_FUNCTIONS and spoil.where in found:
        found[spoil.where] = spoiled(found[spoil.where], spoil, float(p.t0))
    return hb.NumpySystem(**found)


def spoiled(function, spoil: Spoil, t0: float):
    """``function``, not finite or raising after a time, or wrong by a factor."""

    @wraps(function)
    def call(t, *rest):
        value, factor = function(t, *rest), 1.0 + spoil.since
        if spoil.kind in ("nan", "raise"):
            if abs(t - t0) < spoil.since:
                return value
            if spoil.kind == "raise":
                raise Planted(spoil.where)
            factor = np.nan
        return tuple(part * factor for part in value) if isinstance(value, tuple) else value * factor

    return call


def traced_system(made: Mechanism) -> hb.System:
    """In ``jax.numpy``, with its numbers as parameters and every derivative left to the solver."""
    return traced_class(made.shape)(**{name: getattr(made.p, name) for name in PARAMETERS})


@lru_cache
def traced_class(shape: Shape) -> type:
    """The System of all mechanisms of a shape."""
    fields = {name: hb.parameter() for name in PARAMETERS}
    body = {"__module__": __name__, "__annotations__": dict.fromkeys(fields, object), **fields, **physics(jnp, shape)}
    return type(hb.System)("Traced", (hb.System,), body)
