"""Evaluate the functions that a system declares and their Jacobian by differences.

All arguments are packed into one vector ``z = [t, q, v, lam, mu]``, so one Jacobian holds every derivative as a block.
Nothing here uses a declared derivative, so that the reference is independent of what it checks.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.differentiate import jacobian

from hhtbench.lowering import Dynamics, Structure, compile_function, route_of
from hhtbench.lowering.dynamics.differences import EPS, STEP, derivative_along
from hhtbench.lowering.dynamics.dynamics import evaluate
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.system import declared

FIRST_STEP = 2.0**-8  # first difference step over the typical size
HALVINGS = 20  # most halvings of that step: resolves features of a millionth of the typical size
AGREE = 1e-9, 1e-11  # relative, and of the row: differences this close need no smaller step


@dataclass(frozen=True)
class Probe:
    """A point at which derivatives are compared."""

    z: Vector  #: (1 + 2n + m + p,) t, q, v, lam, mu
    x: Vector  #: (n,) the vector that the mass is multiplied with


@dataclass(frozen=True)
class Reference:
    """Values and Jacobian of all declared functions at one state."""

    value: dict[str, Vector]  #: part -> (rows,)
    differences: dict[str, Matrix]  #: part -> (rows, size of z)
    errors: dict[str, Matrix]  #: distance of the differences from those of twice the step


def blocks(s: Structure) -> dict[str, slice]:
    """Return the slice of each argument in z."""
    bounds = np.cumsum([0, 1, s.n, s.n, s.m, s.p])
    return {name: slice(int(bounds[i]), int(bounds[i + 1])) for i, name in enumerate(("t", "q", "v", "lam", "mu"))}


def split(s: Structure, z: Any) -> dict[str, Any]:
    """Split z into the arguments by name; t is a scalar."""
    return {name: z[0] if name == "t" else z[where] for name, where in blocks(s).items()}


def _constraint_velocity(d: Dynamics, a: Any) -> Any:
    """Return g_t + g_q v along the motion, from g alone."""
    if d.xp is jnp:
        return jax.jvp(d.constraint, (a["t"], a["q"]), (jnp.ones_like(a["t"]), a["v"]))[1]
    return derivative_along(lambda e: d.constraint(a["t"] + e, a["q"] + e * a["v"]), a["t"], a["q"], a["v"])


PARTS: dict[str, Callable[[Dynamics, Any], Any]] = {
    name: lambda d, at, name=name: evaluate(d, name, at)
    for name in ("force", "mass_product", "constraint", "velocity_constraint", "reaction", "velocity_reaction")
} | {"constraint_velocity": _constraint_velocity}


def parts_of(s: Structure) -> tuple[str, ...]:
    """Return the names of the functions (parts) that a system of this structure has."""
    names = ["force"] + (["mass_product"] if s.mass == "variable" else [])
    names += ["constraint", "constraint_velocity", "reaction"] if s.m else []
    return tuple(names + (["velocity_constraint", "velocity_reaction"] if s.p else []))


def part_rows(s: Structure, name: str) -> int:
    """Return the number of rows of a part."""
    return {"constraint": s.m, "constraint_velocity": s.m, "velocity_constraint": s.p}.get(name, s.n)


def packed_parts(d: Dynamics, names: tuple[str, ...], z: Any, x: Any) -> Any:
    """Evaluate the parts ``names`` at z and concatenate them in one vector."""
    at = split(d.structure, z) | {"x": x}
    return d.xp.concatenate([PARTS[name](d, at) for name in names])


class References:
    """Evaluate :class:`Reference` for a system whose declared derivatives are all ignored."""

    def __init__(self, plain: Dynamics, scales: Vector) -> None:
        self.structure: Structure = plain.structure
        self.names = parts_of(self.structure)
        self.scales = scales  #: (size of z,) typical size of each argument
        self.from_differences = route_of(plain) == "numpy"
        self.plain = plain
        self._values = compile_function(packed_parts, plain, self.names)

    def declares(self, name: str) -> bool:
        """True if the system declares ``name``; the empty name is never declared."""
        return bool(name) and declared(self.plain.system, name) is not None

    def at(self, state: Probe) -> Reference:
        """Return values and difference Jacobians at ``state``."""
        value = self.values(state)
        differences, errors = (self._split(self.names, x) for x in self._differences(state))
        return Reference(value, differences, errors)

    def values(self, state: Probe) -> dict[str, Vector]:
        """Evaluate the parts at ``state``; entries may be NaN on the XLA route."""
        return self._split(self.names, np.asarray(self._values(state.z, state.x)))

    def _split(self, names: tuple[str, ...], stacked: Any) -> dict[str, Any]:
        bounds = np.cumsum([part_rows(self.structure, name) for name in names])
        return dict(zip(names, np.split(stacked, bounds[:-1]), strict=True)) if names else {}

    def _differences(self, state: Probe) -> tuple[Matrix, Matrix]:
        """Return central differences, one column per entry of z, and their errors.

        Steps are halved until they stay where the functions are finite, then until the differences agree.
        """

        def values(x: Any) -> Any:  # where z has moved by x (size, ...), in typical sizes
            points = (state.z[:, None] + self.scales[:, None] * x.reshape(len(x), -1)).T
            found = [np.asarray(self._values(point.copy(), state.x)) for point in points]
            return np.stack(found, axis=-1).reshape(-1, *x.shape[1:])

        steps = np.full(state.z.size, FIRST_STEP)
        for _ in range(HALVINGS):
            move = np.diag(steps)
            forward, backward, at = np.split(
                values(np.hstack([move, -move, 0.0 * move[:, :1]])), [len(move), 2 * len(move)], axis=1
            )
            left = np.any(np.isfinite(at) & ~np.isfinite(forward + backward), axis=0)
            if not left.any():
                break
            steps[left] /= 2.0
        slope = np.abs(forward - backward) / (2.0 * steps)
        size = np.abs(at) + np.fmax.reduce(slope, axis=1, keepdims=True)
        size = np.where(np.isfinite(size) & (size > 0.0), size, 1.0)
        options: Any = {"initial_step": steps, "maxiter": HALVINGS, "tolerances": {"rtol": AGREE[0], "atol": AGREE[1]}}
        with np.errstate(all="ignore"):
            found = jacobian(lambda x: values(x) / size.reshape(-1, *[1] * (x.ndim - 1)), 0.0 * state.z, order=4, **options)
            error = np.maximum(found.error * size, self._noise(state, at, slope) / steps * 2.0**found.nit)
        unit = 1.0 / self.scales
        return found.df * size * unit, np.where(np.isfinite(error), error, np.inf) * unit  # inf: it is not defined there

    def _noise(self, state: Probe, value: Matrix, slope: Matrix) -> Matrix:
        """Return the roundoff of every row, (rows, 1), from its ``value`` and from z, whose digits may cancel in it."""
        terms = slope * np.maximum(np.abs(state.z) / self.scales, 1.0)
        noise = EPS * (np.abs(value) + np.fmax.reduce(terms, axis=1, keepdims=True))
        if self.from_differences and "constraint" in self.names:  # the velocity level is itself a difference
            parts = self._split(self.names, noise)
            np.maximum(parts["constraint_velocity"], parts["constraint"] / STEP[4], out=parts["constraint_velocity"])
        return noise
