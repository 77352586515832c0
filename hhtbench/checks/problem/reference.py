"""The functions that a system declares and their Jacobian, from differences and from the complex step.

All arguments travel in one vector ``z = [t, q, v, lam, mu]``, so one Jacobian holds every derivative as a block.
Nothing here uses a declared derivative: what is judged and what it is judged by stay apart.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.checks.problem.rows import attempt
from hhtbench.lowering import Dynamics, Structure, compile_function, route_of
from hhtbench.lowering.dynamics.differences import EPS, derivative_along
from hhtbench.lowering.dynamics.dynamics import evaluate
from hhtbench.protocol import declared

DIFFERENCE_STEP = 2.0**-10  # of the typical size: about eps**(1/5), best for fourth order; the first that is tried
HALVINGS = 20  # of that step at most: features down to a millionth of the typical size are seen
AGREE = 1e-7, 1e-10  # of the row's largest derivative, of all its terms: differences this close need no smaller step
COMPLEX_STEP = 1e-20  # of the typical size: there is no cancellation to fear


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
    complex_step: dict[str, Matrix]  #: the same, for the parts that accept complex numbers


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


def _reaction(d: Dynamics, a: Any) -> Any:
    if d.xp is not jnp or declared(d.system, "reaction") is not None:
        return d.reaction(a["t"], a["q"], a["v"], a["lam"])
    return -_transposed_product(lambda q: d.constraint(a["t"], q), a["q"], a["lam"])


def _velocity_reaction(d: Dynamics, a: Any) -> Any:
    if d.xp is not jnp or declared(d.system, "velocity_reaction") is not None:
        return d.velocity_reaction(a["t"], a["q"], a["v"], a["mu"])
    return -_transposed_product(lambda v: d.velocity_constraint(a["t"], a["q"], v), a["v"], a["mu"])


def _transposed_product(function: Callable[[Any], Any], x: Any, weights: Any) -> Any:
    """J^T weights for J = d function/dx; holds for complex numbers too, where jax.jacfwd refuses."""
    return jax.vjp(lambda y: function(y).astype(x.dtype), x)[1](weights)[0]


PARTS: dict[str, Callable[[Dynamics, Any], Any]] = {
    name: lambda d, at, name=name: evaluate(d, name, at)
    for name in ("force", "mass_product", "constraint", "velocity_constraint")
} | {"constraint_velocity": _constraint_velocity, "reaction": _reaction, "velocity_reaction": _velocity_reaction}


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
        self._plain = plain
        self._values = compile_function(packed_parts, plain, self.names)
        self.no_complex_step: dict[str, str] = {}  #: part -> reason
        self._complex_names = self._find_complex_parts()
        self._complex = compile_function(packed_parts, plain, self._complex_names) if self._complex_names else None

    def declares(self, name: str) -> bool:
        """Whether the system declares ``name``."""
        return declared(self._plain.system, name) is not None

    def at(self, state: Probe) -> Reference:
        """Values and Jacobians at ``state``."""
        value = self.values(state)
        differences, errors = (self._split(self.names, x) for x in self._differences(state))
        found = self._split(self._complex_names, self._complex_step(state)) if self._complex else {}
        return Reference(value, differences, errors, found)

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
        """Roundoff of every row, (rows, 1): of its value and of z, whose digits may cancel in it, as far as J tells."""
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

    def _complex_step(self, state: Probe) -> Matrix:
        """Imaginary parts along every entry of z: the derivative without cancellation."""
        assert self._complex is not None  # noqa: S101 - for the type checker
        columns = []
        for j, scale in enumerate(self.scales):
            step = COMPLEX_STEP * scale
            z = _moved(state.z.astype(complex), j, 1j * step)
            columns.append(np.imag(self._complex(z, state.x.astype(complex))) / step)
        return np.stack(columns, axis=1)

    def _find_complex_parts(self) -> tuple[str, ...]:
        """Parts that can be traced with complex arguments; for the others the reason is kept."""
        if self.from_differences:
            self.no_complex_step = dict.fromkeys(self.names, "callbacks on NumPy arrays are called with real numbers only")
            return ()
        z = jax.ShapeDtypeStruct(self.scales.shape, complex)
        x = jax.ShapeDtypeStruct((self.structure.n,), complex)
        accepted = []
        for name in self.names:
            with warnings.catch_warnings(record=True) as seen:
                warnings.simplefilter("always")
                part = partial(packed_parts, self._plain, (name,))
                trace = attempt(lambda part=part: jax.eval_shape(part, z, x))  # type: ignore[misc]
            if trace.fault:
                self.no_complex_step[name] = f"it refuses complex numbers ({trace.fault})"
            elif any(issubclass(warning.category, np.exceptions.ComplexWarning) for warning in seen):
                self.no_complex_step[name] = "it casts complex numbers to real ones"
            else:
                accepted.append(name)
        return tuple(accepted)


def _moved(z: Any, j: int, step: Any) -> Any:
    moved = z.copy()
    moved[j] += step
    return moved
