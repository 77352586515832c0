"""Large NumPy systems with declared patterns, without full matrices: callbacks return entries, used as derivatives.

Formulas are traced as for any system.  A function differentiated by a step's unknowns gets its derivative from the entries
of another callback; derivatives by time, or by the state before a step, are not needed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.lowering.dynamics.augmented import AugmentedDynamics
from hhtbench.lowering.dynamics.band_mass import BandInverse, Entries, entries_at
from hhtbench.lowering.dynamics.callbacks import Callbacks
from hhtbench.lowering.dynamics.dynamics import Dynamics, arguments_of, as_declared, innermost
from hhtbench.lowering.dynamics.foreign import FUNCTIONS, SIZES, Called, foreign_p
from hhtbench.lowering.dynamics.mass import Diagonal, Sparse, compact
from hhtbench.lowering.dynamics.patterns import Dependencies, Patterns, complete, patterns_of
from hhtbench.protocol.system import declared

VALUES = (  # functions by the letter of their size
    dict.fromkeys(("force", "mass_product", "reaction", "velocity_reaction"), "n")
    | dict.fromkeys(("constraint", "constraint_velocity", "constraint_acceleration"), "m")
    | dict.fromkeys(("velocity_constraint", "velocity_constraint_acceleration"), "p")
)


class Part(NamedTuple):
    """Entries of a matrix that a function of the system returns."""

    function: str
    which: int | None  #: index in a tuple of matrices; None: it returns one
    pattern: str


PARTS = {
    "force_q": Part("force_jacobians", 0, "force_q"),
    "force_v": Part("force_jacobians", 1, "force_v"),
    "constraint_jacobian": Part("constraint_rows", None, "constraint_jacobian"),
    "constraint_velocity_q": Part("constraint_velocity_jacobian", None, "constraint_jacobian"),
    "reaction_q": Part("reaction_jacobians", 0, "reaction_q"),
    "velocity_constraint_jacobian": Part("velocity_constraint_rows", None, "velocity_constraint_jacobian"),
    "velocity_constraint_q": Part("velocity_constraint_position_jacobian", None, "velocity_constraint_q"),
    "velocity_reaction_v": Part("velocity_reaction_jacobians", 0, "velocity_reaction_v"),
    "mass_matrix": Part("mass", None, "mass_matrix"),
    "mass_product_jacobian": Part("mass_product_jacobian", None, "mass_product_jacobian"),
}
DERIVATIVES = {  # of functions: (index of the argument, part, 0 or the sign of the transposed part)
    "force": ((1, "force_q", 0), (2, "force_v", 0)),
    "mass_product": ((1, "mass_product_jacobian", 0), (2, "mass_matrix", 0)),
    "constraint": ((1, "constraint_jacobian", 0),),
    "constraint_velocity": ((1, "constraint_velocity_q", 0), (2, "constraint_jacobian", 0)),
    "reaction": ((1, "reaction_q", 0), (2, "constraint_jacobian", -1)),
    "velocity_constraint": ((1, "velocity_constraint_q", 0), (2, "velocity_constraint_jacobian", 0)),
    "velocity_reaction": ((2, "velocity_reaction_v", 0), (3, "velocity_constraint_jacobian", -1)),
}


NAMES = (*VALUES, *PARTS)


def _taken(name: str) -> tuple[str, ...]:
    """Argument names of a function that is called; these reactions have no v."""
    return FUNCTIONS[name].arguments if name in FUNCTIONS else arguments_of(name)


class ForeignProducts(Called):
    """Traceable dynamics as products with sparse matrices; needs all patterns and default reactions."""

    matrices: ClassVar[bool] = False
    patterns: Patterns
    constant_mass: Diagonal | Sparse | None = None  #: None: the identity, or it varies
    inverse_mass: Diagonal | BandInverse | None = None
    entries: Entries | None = None  #: pattern of a mass that varies

    @property
    def dependencies(self) -> Dynamics:
        return Dependencies(self, self.patterns, None if self.entries is None else self.entries.columns)

    def gives(self, name: str) -> bool:
        """True for every function that is called."""
        return name in VALUES

    def call(self, name: str, t: Any, *arguments: Any) -> Any:
        """Value of the function ``name``, with its derivative as a JAX rule."""
        size, taken = getattr(self.structure, VALUES[name]), _taken(name)

        @jax.custom_jvp
        def evaluated(addresses: Any, *floats: Any) -> Any:
            return foreign_p.bind(addresses[NAMES.index(name)], *floats, shape=(size,))

        def differential(primals: Any, tangents: Any) -> Any:
            (addresses, *floats), (_, *along) = primals, tangents
            change = jnp.zeros(size)
            for place, part, transposed in DERIVATIVES[name]:
                at = [floats[taken.index(symbol)] for symbol in _taken(PARTS[part].function)]
                entries = self.part(addresses, part, *at)
                rows, columns = self.patterns[PARTS[part].pattern]
                if transposed:
                    rows, columns, entries = columns, rows, transposed * entries
                change = change.at[rows].add(entries * along[place][columns])
            return evaluated(*primals), change

        evaluated.defjvp(differential)
        return evaluated(self.addresses, *(jnp.asarray(argument, dtype=float) for argument in (t, *arguments)))

    def part(self, addresses: Any, name: str, *arguments: Any) -> Any:
        """Entries of a matrix, in the order of its pattern."""
        size = self.patterns[PARTS[name].pattern].shape[1]
        floats = [jnp.asarray(argument, dtype=float) for argument in arguments]
        return foreign_p.bind(addresses[NAMES.index(name)], *floats, shape=(size,))

    def _product(self, name: str, size: int, x: Any, *at: Any, transposed: bool = False) -> Any:
        rows, columns = self.patterns[PARTS[name].pattern]
        rows, columns = (columns, rows) if transposed else (rows, columns)
        return jnp.zeros(size).at[rows].add(self.part(self.addresses, name, *at) * x[columns])

    def mass(self, t: Any, q: Any) -> Any:
        if self.entries is None:
            return Diagonal(jnp.ones(self.structure.n)) if self.constant_mass is None else self.constant_mass
        values = jnp.zeros(self.entries.columns.shape)
        filled = np.nonzero(self.entries.filled)
        return Sparse(values.at[filled].set(self.part(self.addresses, "mass_matrix", t, q)), self.entries.columns)

    def mass_product(self, t: Any, q: Any, x: Any) -> Any:
        if self.entries is not None:
            return self.call("mass_product", t, q, x)
        return x if self.constant_mass is None else self.constant_mass @ x

    def over_mass(self, t: Any, q: Any, x: Any) -> Any:
        return super().over_mass(t, q, x) if self.entries is None else self.entries.inverse(self.mass(t, q), jnp) @ x

    def position_row(self, t: Any, q: Any, x: Any) -> Any:
        return self._product("constraint_jacobian", self.structure.m, x, t, q)

    def position_column(self, t: Any, q: Any, x: Any) -> Any:
        return self._product("constraint_jacobian", self.structure.n, x, t, q, transposed=True)

    def velocity_row(self, t: Any, q: Any, v: Any, x: Any) -> Any:
        return self._product("velocity_constraint_jacobian", self.structure.p, x, t, q, v)


def foreign_products(dynamics: Dynamics) -> ForeignProducts | None:
    """``dynamics`` of plain callables without full matrices; None if a pattern is missing or reactions are declared.

    None also if the mass is no narrow band, as its inverse needs.
    """
    s, patterns = dynamics.structure, patterns_of(dynamics)
    if isinstance(dynamics, AugmentedDynamics):  # its mass and its force have entries that nobody declared
        return None
    if any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction")) or not complete(
        patterns, s
    ):
        return None
    mass = inverse = entries = None
    if s.mass == "variable":
        rows, columns = patterns["mass_matrix"]
        entries = entries_at(s.n, rows.astype(np.int64) * s.n + columns)
        if entries is None:
            return None
        patterns["mass_matrix"] = entries.pattern
    elif dynamics.constant_mass is not None:
        mass = compact(dynamics.constant_mass, jnp)
        inverse = mass.inverse() if isinstance(mass, Diagonal | Sparse) else None
        if inverse is None:
            return None
    sparse = s.mass == "variable" or isinstance(mass, Sparse)
    callbacks = Callbacks(dynamics.system)
    bits = np.array([_address(dynamics, name, patterns, callbacks) for name in NAMES], dtype=np.uint64).view(np.float64)
    structure = replace(s, mass="sparse") if sparse else s
    return ForeignProducts(bits, callbacks, innermost(dynamics).noise, structure, patterns, mass, inverse, entries)


def _address(dynamics: Dynamics, name: str, patterns: Patterns, callbacks: Callbacks) -> int:
    """Address of the Python function for the values or entries ``name``; 0 if the system has none."""
    s = dynamics.structure
    if name in VALUES:
        function, size, source = as_declared(dynamics, name), getattr(s, VALUES[name]), name
    elif PARTS[name].pattern in patterns:
        part = PARTS[name]
        function = partial(_entries, as_declared(dynamics, part.function), part.which, patterns[part.pattern])
        size, source = patterns[part.pattern].shape[1], part.function
    else:
        return 0
    shapes = [tuple(getattr(s, letter) for letter in SIZES[symbol]) for symbol in _taken(source)]
    return callbacks.row(function, (size,), tuple(shapes))


def _entries(function: Callable[..., Any], which: int | None, pattern: Any, *arguments: Any) -> Any:
    """Entries of the matrix that ``function`` returns; zero for None."""
    matrix = function(*arguments)
    matrix = matrix if which is None else matrix[which]
    return 0.0 if matrix is None else matrix[pattern[0], pattern[1]]
