"""The functions that a system declares and their Jacobian, by differences.

All arguments travel in one vector ``z = [t, q, v, lam, mu]``, so one Jacobian holds every derivative as a block.
Nothing here uses a declared derivative: what is judged and what it is judged by stay apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.lowering import Dynamics, Structure, compile_function, route_of
from hhtbench.lowering.dynamics.differences import EPS, derivative_along
from hhtbench.lowering.dynamics.dynamics import evaluate
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.system import declared

DIFFERENCE_STEP = 2.0**-10  # of the typical size: about eps**(1/5), best for fourth order; the first that is tried
HALVINGS = 20  # of that step at most: features down to a millionth of the typical size are seen
AGREE = 1e-7, 1e-10  # of the row's largest derivative, of all its terms: differences this close need no smaller step


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
    errors: dict[str, Matrix]  #: of the differences: how far those of half and of twice the step are from them


def blocks(s: Structure) -> dict[str, slice]:
    """Where each argument lies in z."""
    bounds = np.cumsum([0, 1, s.n, s.n, s.m, s.p])
    return {name: slice(int(bounds[i]), int(bounds[i + 1])) for i, name in enumerate(("t", "q", "v", "lam", "mu"))}


def split(s: Structure, z: Any) -> dict[str, Any]:
    """The arguments by name; t as a scalar."""
    return {name: z[0] if name == "t" else z[where] for name, where in blocks(s).items()}


def _constraint_velocity(d: Dynamics, a: Any) -> Any:
    """g_t + g_q v along the motion, from g alone."""
    if d.xp is jnp:
        return jax.jvp(d.constraint, (a["t"], a["q"]), (jnp.ones_like(a["t"]), a["v"]))[1]
    return derivative_along(lambda e: d.constraint(a["t"] + e, a["q"] + e * a["v"]), a["t"], a["q"], a["v"])


PARTS: dict[str, Callable[[Dynamics, Any], Any]] = {
    name: lambda d, at, name=name: evaluate(d, name, at)
    for name in ("force", "mass_product", "constraint", "velocity_constraint", "reaction", "velocity_reaction")
} | {"constraint_velocity": _constraint_velocity}


def parts_of(s: Structure) -> tuple[str, ...]:
    """The parts that a system has."""
    names = ["force"] + (["mass_product"] if s.mass == "variable" else [])
    names += ["constraint", "constraint_velocity", "reaction"] if s.m else []
    return tuple(names + (["velocity_constraint", "velocity_reaction"] if s.p else []))


def part_rows(s: Structure, name: str) -> int:
    """Number of rows of a part."""
    return {"constraint": s.m, "constraint_velocity": s.m, "velocity_constraint": s.p}.get(name, s.n)


def packed_parts(d: Dynamics, names: tuple[str, ...], z: Any, x: Any) -> Any:
    """The parts ``names`` at z, one after another in one vector."""
    at = split(d.structure, z) | {"x": x}
    return d.xp.concatenate([PARTS[name](d, at) for name in names])


class References:
    """Evaluates :class:`Reference` for a system whose declared derivatives are all ignored."""

    def __init__(self, plain: Dynamics, scales: Vector) -> None:
        self.structure: Structure = plain.structure
        self.names = parts_of(self.structure)
        self.scales = scales  #: (size of z,) typical size of each argument
        self.from_differences = route_of(plain) == "numpy"
        self.plain = plain
        self._values = compile_function(packed_parts, plain, self.names)

    def declares(self, name: str) -> bool:
        """Whether the system declares ``name``; the empty name is never declared."""
        return bool(name) and declared(self.plain.system, name) is not None

    def at(self, state: Probe) -> Reference:
        """Values and Jacobians at ``state``."""
        value = self.values(state)
        differences, errors = (self._split(self.names, x) for x in self._differences(state))
        return Reference(value, differences, errors)

    def values(self, state: Probe) -> dict[str, Vector]:
        """The parts at ``state``; entries may be NaN on the XLA route."""
        return self._split(self.names, np.asarray(self._values(state.z, state.x)))

    def _split(self, names: tuple[str, ...], stacked: Any) -> dict[str, Any]:
        bounds = np.cumsum([part_rows(self.structure, name) for name in names])
        return dict(zip(names, np.split(stacked, bounds[:-1]), strict=True)) if names else {}

    def _differences(self, state: Probe) -> tuple[Matrix, Matrix]:
        """Fourth-order central differences, one column per entry of z, and their errors.

        The step is halved until truncation and roundoff are small together, or the best of all steps is taken.
        """
        steps = DIFFERENCE_STEP * self.scales
        steps = np.where((state.z + steps) - state.z == 0, steps, (state.z + steps) - state.z)  # exactly representable
        size = np.abs(np.asarray(self._values(state.z, state.x)))[:, None]
        wide, found, noise = self._changes(state, 2 * steps), [], []
        for halving in range(HALVINGS):
            near = self._changes(state, steps / 2**halving)
            found.append((8 * near - wide) / (12 * steps / 2**halving))
            wide = near
            noise.append(self._noise(state, size, found[0]) * self.scales / steps * 2**halving)
            if len(found) < 3:
                continue
            best, error = self._best(found, noise)
            row = np.abs(best * self.scales)
            if np.all(error <= AGREE[0] * self._widest(row) + AGREE[1] * (row.max(axis=1, keepdims=True) + size)):
                break
        return best, error / self.scales

    def _changes(self, state: Probe, steps: Vector) -> Matrix:
        """f(z + step) - f(z - step) along every entry of z."""
        sides = ((_moved(state.z, j, step), _moved(state.z, j, -step)) for j, step in enumerate(steps))
        return np.stack([np.subtract(*(self._values(z, state.x) for z in pair)) for pair in sides], axis=1)

    def _noise(self, state: Probe, size: Matrix, jacobian: Matrix) -> Matrix:
        """Roundoff of every row, (rows, 1): of its value and of z, whose digits may cancel in it, estimated by J."""
        terms = np.abs(jacobian) * np.maximum(np.abs(state.z), self.scales)
        noise = EPS * (size + np.fmax.reduce(terms, axis=1, keepdims=True))
        if self.from_differences and "constraint" in self.names:  # the velocity level is itself a difference
            parts = self._split(self.names, noise)
            np.maximum(parts["constraint_velocity"], parts["constraint"] / DIFFERENCE_STEP, out=parts["constraint_velocity"])
        return noise

    def _best(self, found: list[Matrix], noise: list[Matrix]) -> tuple[Matrix, Matrix]:
        """Of differences with ever smaller steps those whose neighbours are nearest, row by row of each block; how near."""
        with np.errstate(invalid="ignore"):
            apart = [self._widest(np.abs(b - a) * self.scales) for a, b in pairwise(found)]
        error = np.maximum([np.maximum(*near) for near in pairwise(apart)], noise[1:-1])
        error = np.where(np.isnan(error), np.inf, error)  # where the function is not defined
        best = np.argmin(error, axis=0)[None]
        return np.take_along_axis(np.array(found[1:-1]), best, axis=0)[0], np.take_along_axis(error, best, axis=0)[0]

    def _widest(self, matrix: Matrix) -> Matrix:
        """The largest entry in each row of each block, in all places of it: one small entry may be chance."""
        result = np.zeros_like(matrix)
        for where in blocks(self.structure).values():
            result[:, where] = np.max(matrix[:, where], axis=1, keepdims=True, initial=0.0)
        return result


def _moved(z: Any, j: int, step: Any) -> Any:
    moved = z.copy()
    moved[j] += step
    return moved
