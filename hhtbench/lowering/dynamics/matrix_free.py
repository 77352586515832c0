"""Terms of large JAX systems without dense matrices: products instead of Jacobians.

``g_q v`` is a derivative along v and ``g_q^T lam`` a vector-Jacobian product; both cost about one evaluation of g, where
the Jacobian of a chain of N links would cost N and hold N^2 numbers.  Declared Jacobians are dense and are not called.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.coloured import Coloured, OftenCalled, Pattern, by_pattern
from hhtbench.lowering.compile.compiling import compile_function
from hhtbench.lowering.dynamics.band_mass import BandInverse, Entries, entries_at
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, Wrapper
from hhtbench.lowering.dynamics.jax_dynamics import JaxDynamics
from hhtbench.lowering.dynamics.kkt_rows import kkt_residual
from hhtbench.lowering.dynamics.mass import Diagonal, Sparse, compact, mass_at
from hhtbench.lowering.dynamics.patterns import Dependencies, patterns_of
from hhtbench.lowering.dynamics.regular import ReducedDynamics
from hhtbench.lowering.scalar_compiler import NotNative, places_of
from hhtbench.protocol.system import declared

SMALL = 60  # unknowns of a step below which full matrices cost about the same; from 100 on they cost four times as much

_entries = Cache(16)  # entries of masses: tracing takes a second


class MatrixFree(Wrapper):
    """The functions of ``inner`` as products; masses are Diagonal or Sparse."""

    matrices: ClassVar[bool] = False
    inner: JaxDynamics | ReducedDynamics
    constant_mass: Diagonal | Sparse | None  #: None: the identity
    inverse_mass: Diagonal | BandInverse | None

    @property
    def structure(self) -> Structure:  # type: ignore[override] # follows from that of ``inner``
        s = self.inner.structure
        return replace(s, mass="sparse") if isinstance(self.constant_mass, Sparse) else s

    def coloured(self, function: Callable[..., Any], example: tuple[Any, ...]) -> Coloured:
        """``function(self, x, *rest)`` with its sparse derivative by x, compiled."""
        return Coloured(function, self, example=example)

    def often_called(self, function: Callable[..., Any], *static: Any, example: tuple[Any, ...]) -> OftenCalled:
        """``function(self, *static, x, *rest)`` with its sparse derivative by x, as machine code where possible."""
        return OftenCalled(function, self, *static, example=example)

    def mass(self, t: Any, q: Any) -> Any:
        return Diagonal(jnp.ones(self.structure.n)) if self.constant_mass is None else self.constant_mass

    def mass_at(self, t: float, q: Any) -> Diagonal | Sparse:
        """M at (t, q), as numbers."""
        found: Diagonal | Sparse = self.mass(t, q)
        return found

    @property
    def dependencies(self) -> Dynamics:
        patterns = patterns_of(self.inner)
        return Dependencies(self, patterns) if patterns else self

    def position_row(self, t: Any, q: Any, x: Any) -> Any:
        return jax.jvp(lambda y: self.constraint(t, y), (q,), (x,))[1]

    def position_column(self, t: Any, q: Any, x: Any) -> Any:
        return jax.vjp(lambda y: self.constraint(t, y), q)[1](x)[0]

    def constraint_velocity(self, t: Any, q: Any, v: Any) -> Any:
        if not self.structure.rheonomic:
            return self.position_row(t, q, v)
        return self.rate(self.constraint, t, q, v)

    def constraint_time_derivative(self, t: Any, q: Any) -> Any:
        return self.constraint_velocity(t, q, jnp.zeros_like(q))

    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        return self.rate(lambda s, y: self.constraint_velocity(s, y, v), t, q, v)

    def velocity_row(self, t: Any, q: Any, v: Any, x: Any) -> Any:
        return jax.jvp(lambda y: self.velocity_constraint(t, q, y), (v,), (x,))[1]

    def reaction(self, t: Any, q: Any, v: Any, lam: Any) -> Any:
        if declared(self.system, "reaction") is not None:
            return self.inner.reaction(t, q, v, lam)
        return -self.position_column(t, q, lam)

    def velocity_reaction(self, t: Any, q: Any, v: Any, mu: Any) -> Any:
        if declared(self.system, "velocity_reaction") is not None:
            return self.inner.velocity_reaction(t, q, v, mu)
        return -self.velocity_column(t, q, v, mu)

    def velocity_column(self, t: Any, q: Any, v: Any, x: Any) -> Any:
        """k_v^T x (n,)."""
        return jax.vjp(lambda w: self.velocity_constraint(t, q, w), v)[1](x)[0]


class VariableMass(MatrixFree):
    """:class:`MatrixFree` for a variable mass with few entries."""

    entries: Entries = eqx.field(kw_only=True)

    @property
    def structure(self) -> Structure:  # type: ignore[override] # likewise
        return replace(self.inner.structure, mass="sparse")

    def mass(self, t: Any, q: Any) -> Any:
        return self.entries.of(self.inner.mass(t, q), jnp)

    @property
    def dependencies(self) -> Dynamics:
        return Dependencies(self, patterns_of(self.inner) | {"mass_matrix": self.entries.pattern}, self.entries.columns)

    def mass_at(self, t: float, q: Any) -> Sparse:
        """M at (t, q), computed by compiled code."""
        values = compile_function(entries_of_mass, self)(t, q)
        return Sparse(np.reshape(values, self.entries.columns.shape), self.entries.columns)

    def over_mass(self, t: Any, q: Any, x: Any) -> Any:
        """M^-1 x (n,), NaN where M is not positive definite."""
        return self.entries.inverse(self.mass(t, q), jnp) @ x


def entries_of_mass(dynamics: VariableMass, t: Any, q: Any) -> Any:
    """Entries of M, row by row, (n k,)."""
    return dynamics.mass(t, q).values.ravel()


class Conjugate(MatrixFree):
    """:class:`MatrixFree` with reactions -g_q^T lam and -k_v^T mu, whatever is declared, as projections need."""

    def reaction(self, t: Any, q: Any, v: Any, lam: Any) -> Any:
        return -self.position_column(t, q, lam)

    def velocity_reaction(self, t: Any, q: Any, v: Any, mu: Any) -> Any:
        return -self.velocity_column(t, q, v, mu)


class ConjugateVariable(Conjugate, VariableMass):
    """:class:`Conjugate` for a variable mass with few entries."""


def conjugate(products: MatrixFree) -> Conjugate:
    """``products`` with the reactions -g_q^T lam and -k_v^T mu."""
    inner, mass, inverse = products.inner, products.constant_mass, products.inverse_mass
    if isinstance(products, VariableMass):
        return ConjugateVariable(inner, mass, inverse, entries=products.entries)
    return Conjugate(inner, mass, inverse)


def products_of(dynamics: Dynamics) -> MatrixFree | None:
    """The result of :func:`~.products.matrix_free`."""
    origin = dynamics.inner if isinstance(dynamics, ReducedDynamics) else dynamics
    if not isinstance(origin, JaxDynamics):
        return None
    own = cast("JaxDynamics | ReducedDynamics", dynamics)
    if dynamics.structure.mass == "variable":
        s = origin.structure
        if s.n + s.m + s.p < SMALL:
            return None
        entries = _entries.find(by_id(origin), lambda: _entries_of(origin))
        return None if entries is None else VariableMass(own, None, None, entries=entries)
    mass, inverse = dynamics.constant_mass, dynamics.inverse_mass
    if mass is None:
        return MatrixFree(own, None, None)
    if not isinstance(mass, Diagonal | Sparse):
        mass = compact(mass, jnp)
        inverse = mass.inverse() if isinstance(mass, Diagonal | Sparse) else None
    return None if inverse is None else MatrixFree(own, mass, inverse)


def _entries_of(dynamics: JaxDynamics) -> Entries | None:
    """Pattern of M, as declared or read from its computation."""
    n, patterns = dynamics.structure.n, patterns_of(dynamics)
    if "mass_matrix" in patterns:
        rows, columns = patterns["mass_matrix"]
        return entries_at(n, rows * n + columns)
    try:
        return entries_at(n, places_of(mass_at, dynamics, shapes=((), (n,))))
    except NotNative:
        return None


def kkt_entries(dynamics: Dynamics, pattern: Pattern, t: Any, q: Any, v: Any, x: Any) -> Any:
    """Residual of the KKT system at ``x``, then the entries of its matrix in ``pattern``, (N + entries,)."""
    return by_pattern(dynamics, pattern, kkt_residual, (), x, t, q, v)
