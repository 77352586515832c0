"""The functions that a system declares and their Jacobian, from differences and from the complex step.

All arguments travel in one vector ``z = [t, q, v, lam, mu]``, so one Jacobian holds every derivative as a block.
Nothing here uses a declared derivative: what is judged and what it is judged by stay apart.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.check.rows import attempt
from hhtbench.lowering import Structure, compile_function, route_of
from hhtbench.lowering.differences import derivative_along
from hhtbench.protocol import declared

DIFFERENCE_STEP = 2.0**-10  # of the typical size: about eps**(1/5), best for fourth order
COMPLEX_STEP = 1e-20  # of the typical size: there is no cancellation to fear


@dataclass(frozen=True)
class State:
    """A point at which derivatives are compared."""

    z: Vector  #: (1 + 2n + m + p,) t, q, v, lam, mu
    x: Vector  #: (n,) the vector that the mass is multiplied with


@dataclass(frozen=True)
class Reference:
    """Values and Jacobian of all declared functions at one state."""

    value: dict[str, Vector]  #: part -> (rows,)
    differences: dict[str, Matrix]  #: part -> (rows, size of z)
    complex_step: dict[str, Matrix]  #: the same, for the parts that accept complex numbers


def blocks(s: Structure) -> dict[str, slice]:
    """Where each argument lies in z."""
    bounds = np.cumsum([0, 1, s.n, s.n, s.m, s.p])
    return {name: slice(int(bounds[i]), int(bounds[i + 1])) for i, name in enumerate(("t", "q", "v", "lam", "mu"))}


def split(s: Structure, z: Any) -> dict[str, Any]:
    """The arguments by name; t as a scalar."""
    return {name: z[0] if name == "t" else z[where] for name, where in blocks(s).items()}


def _force(d: Any, a: Any, x: Any) -> Any:
    return d.force(a["t"], a["q"], a["v"])


def _mass_product(d: Any, a: Any, x: Any) -> Any:
    return d.mass(a["t"], a["q"]) @ x


def _constraint(d: Any, a: Any, x: Any) -> Any:
    return d.constraint(a["t"], a["q"])


def _constraint_velocity(d: Any, a: Any, x: Any) -> Any:
    """g_t + g_q v along the motion, from g alone."""
    if d.xp is jnp:
        return jax.jvp(d.constraint, (a["t"], a["q"]), (jnp.ones_like(a["t"]), a["v"]))[1]
    return derivative_along(lambda e: d.constraint(a["t"] + e, a["q"] + e * a["v"]), a["t"], a["q"], a["v"])


def _velocity_constraint(d: Any, a: Any, x: Any) -> Any:
    return d.velocity_constraint(a["t"], a["q"], a["v"])


def _reaction(d: Any, a: Any, x: Any) -> Any:
    if d.xp is not jnp or declared(d.system, "reaction") is not None:
        return d.reaction(a["t"], a["q"], a["lam"])
    return -_transposed_product(lambda q: d.constraint(a["t"], q), a["q"], a["lam"])


def _velocity_reaction(d: Any, a: Any, x: Any) -> Any:
    if d.xp is not jnp or declared(d.system, "velocity_reaction") is not None:
        return d.velocity_reaction(a["t"], a["q"], a["v"], a["mu"])
    return -_transposed_product(lambda v: d.velocity_constraint(a["t"], a["q"], v), a["v"], a["mu"])


def _transposed_product(function: Callable[[Any], Any], x: Any, weights: Any) -> Any:
    """J^T weights for J = d function/dx; holds for complex numbers too, where jax.jacfwd refuses."""
    return jax.vjp(lambda y: function(y).astype(x.dtype), x)[1](weights)[0]


PARTS: dict[str, Callable[[Any, Any, Any], Any]] = {
    "force": _force,
    "mass_product": _mass_product,
    "constraint": _constraint,
    "constraint_velocity": _constraint_velocity,
    "velocity_constraint": _velocity_constraint,
    "reaction": _reaction,
    "velocity_reaction": _velocity_reaction,
}


def parts_of(s: Structure) -> tuple[str, ...]:
    """The parts that a system has."""
    names = ["force"] + (["mass_product"] if s.mass == "variable" else [])
    names += ["constraint", "constraint_velocity", "reaction"] if s.m else []
    return tuple(names + (["velocity_constraint", "velocity_reaction"] if s.p else []))


def part_rows(s: Structure, name: str) -> int:
    """Number of rows of a part."""
    return {"constraint": s.m, "constraint_velocity": s.m, "velocity_constraint": s.p}.get(name, s.n)


def packed_parts(d: Any, names: tuple[str, ...], z: Any, x: Any) -> Any:
    """The parts ``names`` at z, one after another in one vector."""
    arguments = split(d.structure, z)
    return d.xp.concatenate([PARTS[name](d, arguments, x) for name in names])


class References:
    """Evaluates :class:`Reference` for a system whose declared derivatives are all ignored."""

    def __init__(self, plain: Any, scales: Vector) -> None:
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

    def at(self, state: State) -> Reference:
        """Values and Jacobians at ``state``."""
        value = self.values(state)
        differences = self._split(self.names, self._central(state))
        found = self._split(self._complex_names, self._complex_step(state)) if self._complex else {}
        return Reference(value, differences, found)

    def values(self, state: State) -> dict[str, Vector]:
        """The parts at ``state``; entries may be NaN on the XLA route."""
        return self._split(self.names, np.asarray(self._values(state.z, state.x)))

    def _split(self, names: tuple[str, ...], stacked: Any) -> dict[str, Any]:
        bounds = np.cumsum([part_rows(self.structure, name) for name in names])
        return dict(zip(names, np.split(stacked, bounds[:-1]), strict=True)) if names else {}

    def _central(self, state: State) -> Matrix:
        """Fourth-order central differences, one column per entry of z."""
        columns = []
        for j, z_j in enumerate(state.z):
            step = DIFFERENCE_STEP * self.scales[j]
            step = (z_j + step) - z_j or step  # exactly representable
            change = [np.asarray(self._values(_moved(state.z, j, i * step), state.x)) for i in (1, -1, 2, -2)]
            columns.append((8 * (change[0] - change[1]) - (change[2] - change[3])) / (12 * step))
        return np.stack(columns, axis=1)

    def _complex_step(self, state: State) -> Matrix:
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
