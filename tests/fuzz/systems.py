"""A mechanism as solvers take it: a NumpySystem, or a System whose machine code serves every mechanism of its shape."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache, partial

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.protocol import PHYSICS, WITH_VELOCITY, accepts
from tests.fuzz import formulas
from tests.fuzz.formulas import Numbers
from tests.fuzz.mechanism import Mechanism, Shape

OF_FUNCTIONS = ("nan", "raise", "wrong", "noise")  # spoils; others are of numbers


class Planted(Exception):
    """What a function of a system raises on purpose."""


@dataclass(frozen=True)
class Spoil:
    """A fault of the user's."""

    kind: str  #: "nan", "raise", "wrong" or "noise" of a function, "off" of the start, "units", "massless"
    where: str = ""  #: the function's name
    since: float = 0.0  #: [s] from the start on, of "nan" and "raise"; how wrong, of others


def functions_of(made: Mechanism) -> dict:
    """Every function of the mechanism on NumPy arrays, by its declared name."""
    shape, p = made.shape, Numbers(made)
    bind = lambda function: partial(function, np, shape, p)  # noqa: E731
    found = {
        "force": bind(formulas.force),
        "force_jacobians": partial(formulas.force_jacobians, shape, p),
        "mass_matrix": np.diag(formulas.masses(np, shape, p, np.zeros(shape.n))),
    }
    if shape.growing:
        found["mass_matrix"] = lambda t, q: np.diag(formulas.masses(np, shape, p, q))
    if shape.rods:
        found |= {
            "constraint": bind(formulas.constraint),
            "constraint_jacobian": bind(formulas.jacobian),
            "constraint_time_derivative": bind(formulas.time_derivative),
            "constraint_acceleration": bind(formulas.curvature),
        }
    if shape.blade:
        found["velocity_constraint"] = lambda t, q, v: formulas.blade(np, shape, p, q, v)
        found["velocity_constraint_jacobian"] = lambda t, q, v: formulas.blade_row(np, shape, p, q)
    if shape.reaction == "friction":
        found["reaction"] = lambda t, q, v, lam: formulas.reaction(np, shape, p, t, q, v, lam)
    elif shape.reaction:
        found["reaction"] = lambda t, q, lam: formulas.reaction(np, shape, p, t, q, 0.0 * q, lam)
    return found


def numpy_system(made: Mechanism, *, declares: bool = True, spoil: Spoil | None = None) -> hb.NumpySystem:
    """With derivatives, or, unless it ``declares`` them, without; ``spoil`` breaks one function."""
    found = functions_of(made)
    if not declares:
        found = {name: value for name, value in found.items() if name in PHYSICS}
    if spoil is not None and spoil.kind in OF_FUNCTIONS and spoil.where in found:
        found[spoil.where] = spoiled(found[spoil.where], spoil, made.t0)
    return hb.NumpySystem(**found)


def spoiled(function, spoil: Spoil, t0: float):
    """``function``, not finite or raising after a time, wrong by a factor, or with noise."""
    if not callable(function):
        return function
    random = np.random.default_rng(0)

    def call(t, *rest):
        value = function(t, *rest)
        if spoil.kind in ("nan", "raise"):
            if abs(t - t0) < spoil.since:
                return value
            if spoil.kind == "raise":
                raise Planted(spoil.where)
            factor = np.nan
        else:
            factor = 1.0 + spoil.since if spoil.kind == "wrong" else 1.0 + spoil.since * random.standard_normal()
        return tuple(part * factor for part in value) if isinstance(value, tuple) else value * factor

    if spoil.where == "reaction":  # its arguments tell whether it takes v
        return (lambda t, q, v, lam: call(t, q, v, lam)) if accepts(function, TAKES_V) else _without_v(call)
    return call


TAKES_V = WITH_VELOCITY["reaction"]


def _without_v(call):
    return lambda t, q, lam: call(t, q, lam)


def traced_system(made: Mechanism) -> hb.System:
    """In ``jax.numpy``, with its numbers as parameters and every derivative left to the solver."""
    return traced_class(made.shape)(**Numbers(made).values())


@lru_cache
def traced_class(shape: Shape) -> type:
    """The System of all mechanisms of a shape."""

    class Traced(hb.System):
        mass: object = hb.parameter()
        anchor: object = hb.parameter()
        gravity: object = hb.parameter()
        swing: object = hb.parameter()
        frequency: object = hb.parameter()
        drag: object = hb.parameter()
        growth: object = hb.parameter()
        scale: object = hb.parameter()
        stiffness: object = hb.parameter()
        natural: object = hb.parameter()
        damper: object = hb.parameter()
        length: object = hb.parameter()
        along: object = hb.parameter()
        turn: object = hb.parameter()
        speed: object = hb.parameter()
        blade_scale: object = hb.parameter()
        friction: object = hb.parameter()
        creep: object = hb.parameter()

        def mass_matrix(self, t, q):
            return jnp.diag(formulas.masses(jnp, shape, self, q))

        def force(self, t, q, v):
            return formulas.force(jnp, shape, self, t, q, v)

        if shape.rods:

            def constraint(self, t, q):
                return formulas.constraint(jnp, shape, self, t, q)

        if shape.blade:

            def velocity_constraint(self, t, q, v):
                return formulas.blade(jnp, shape, self, q, v)

        if shape.reaction == "friction":

            def reaction(self, t, q, v, lam):
                return formulas.reaction(jnp, shape, self, t, q, v, lam)

        elif shape.reaction:

            def reaction(self, t, q, lam):
                return formulas.reaction(jnp, shape, self, t, q, 0.0 * q, lam)

    return Traced
