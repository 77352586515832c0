"""Declared sparsity patterns, used in place of dependencies read from the computation.

A pattern says for every row of a function (a force, a constraint) which entries of q, or of v, it depends on; patterns of
products and of derivatives along the motion follow from it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import scipy.sparse as sp

from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, Wrapper
from hhtbench.lowering.dynamics.mass import Sparse
from hhtbench.lowering.dynamics.regular import ReducedDynamics
from hhtbench.protocol.system import PATTERNS, checked_patterns, declared

Patterns = dict[str, Any]  # by name: rows and columns (2, entries), ascending row by row
NEEDED = {
    "n": ("force_q", "force_v"),
    "m": ("constraint_jacobian",),
    "p": ("velocity_constraint_jacobian", "velocity_constraint_q"),
}


def patterns_of(dynamics: Dynamics) -> Patterns:
    """Declared patterns for the rows of ``dynamics``, and those that follow from them."""
    s, given = dynamics.structure, checked_patterns(declared(dynamics.system, "sparsity"))
    found: Any = {name: sp.csr_array(pattern, dtype=bool) for name, pattern in given.items()}
    if isinstance(dynamics, ReducedDynamics):
        kept = {"m": list(dynamics.position), "p": list(dynamics.velocity)}
        found = {
            name: matrix[kept[PATTERNS[name][0]]] if PATTERNS[name][0] in kept else matrix for name, matrix in found.items()
        }
    position, velocity, by_q = map(
        found.get, ("constraint_jacobian", "velocity_constraint_jacobian", "velocity_constraint_q")
    )
    if position is not None:
        found["position_column"] = position.T
        if declared(dynamics.system, "reaction") is None:
            found.setdefault("reaction_q", position.T @ position)
    if velocity is not None:
        found["velocity_column"] = velocity.T
        found["velocity_reaction_v"] = velocity.T @ velocity
        if by_q is not None:
            found["velocity_reaction_q"] = velocity.T @ by_q
            found["velocity_acceleration_v"] = velocity + by_q
    if s.mass == "variable" and "mass_matrix" in found:
        found["mass_matrix"] = found["mass_matrix"] + found["mass_matrix"].T
    return {name: _places(matrix) for name, matrix in found.items()}


def _places(matrix: Any) -> Any:
    rows, columns = matrix.nonzero()
    order = np.lexsort((columns, rows))
    return np.stack([rows[order], columns[order]]).astype(np.int32)


def complete(patterns: Patterns, s: Structure) -> bool:
    """True if ``patterns`` hold all dependencies of the equations of motion."""
    names = [name for letter, group in NEEDED.items() if getattr(s, letter) for name in group]
    names += ["mass_matrix", "mass_product_jacobian"] if s.mass == "variable" else []
    return set(names) <= set(patterns)


def _term(name: str, size: str, *patterns: str) -> Callable[..., Any]:
    """Function ``name`` of :class:`Dependencies` with ``size`` rows; ``patterns``: of its arguments after the time."""

    def term(self: Dependencies, t: Any, *arguments: Any) -> Any:
        by = zip(arguments, patterns, strict=True)
        return self._of(getattr(self.structure, size), getattr(self.inner, name), t, *by)

    return term


class Dependencies(Wrapper):
    """Functions with the dependencies of those of ``inner``, taken from ``patterns``; their values are meaningless."""

    matrices: ClassVar[bool] = False
    patterns: Patterns
    columns: Any = None  #: (n, k) of a mass that varies, as in :class:`~.mass.Sparse`

    def _of(self, size: int, function: Callable[..., Any], t: Any, *arguments: tuple[Any, str]) -> Any:
        """(size,) with the dependencies of ``function``; each of ``arguments`` comes with the name of its pattern.

        Where a pattern is missing, the function itself is called, with arguments of known patterns replaced by the time.
        """
        total, unknown = jnp.zeros(size), [name not in self.patterns for _, name in arguments]
        for x, name in arguments:
            if name in self.patterns:
                rows, columns = self.patterns[name]
                total = total.at[rows].add(x[columns])
        if any(unknown):
            held = (x if open_ else t + jnp.zeros_like(x) for (x, _), open_ in zip(arguments, unknown, strict=True))
            total = total + function(t, *held)
        return total

    force = _term("force", "n", "force_q", "force_v")
    constraint = _term("constraint", "m", "constraint_jacobian")
    constraint_velocity = _term("constraint_velocity", "m", "constraint_jacobian", "constraint_jacobian")
    constraint_acceleration = _term("constraint_acceleration", "m", "constraint_jacobian", "constraint_jacobian")
    position_row = _term("position_row", "m", "constraint_jacobian", "constraint_jacobian")
    position_column = _term("position_column", "n", "reaction_q", "position_column")
    velocity_constraint = _term("velocity_constraint", "p", "velocity_constraint_q", "velocity_constraint_jacobian")
    velocity_row = _term(
        "velocity_row", "p", "velocity_constraint_q", "velocity_constraint_jacobian", "velocity_constraint_jacobian"
    )
    velocity_constraint_acceleration = _term(
        "velocity_constraint_acceleration", "p", "velocity_constraint_q", "velocity_acceleration_v"
    )

    def mass(self, t: Any, q: Any) -> Any:
        return self.inner.mass(t, q) if self.columns is None else Sparse(t + jnp.ones(self.columns.shape), self.columns)

    def mass_product(self, t: Any, q: Any, x: Any) -> Any:
        if self.columns is None:
            return self.inner.mass_product(t, q, x)
        return self._of(self.structure.n, self.inner.mass_product, t, (q, "mass_product_jacobian"), (x, "mass_matrix"))

    def reaction(self, t: Any, q: Any, v: Any, lam: Any) -> Any:
        by_lam = "position_column" if declared(self.system, "reaction") is None else ""
        if self.structure.reaction_uses_v:
            by = (q, "reaction_q"), (v, "reaction_v"), (lam, by_lam)
            return self._of(self.structure.n, self.inner.reaction, t, *by)
        without = lambda t, q, lam: self.inner.reaction(t, q, v, lam)  # noqa: E731
        return self._of(self.structure.n, without, t, (q, "reaction_q"), (lam, by_lam))

    def velocity_reaction(self, t: Any, q: Any, v: Any, mu: Any) -> Any:
        plain = declared(self.system, "velocity_reaction") is None
        names = ("velocity_reaction_q", "velocity_reaction_v", "velocity_column") if plain else ("", "", "")
        by = zip((q, v, mu), names, strict=True)
        return self._of(self.structure.n, self.inner.velocity_reaction, t, *by)
