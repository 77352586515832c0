"""The interface between systems and solvers: every term of the equations of motion as a function.

    M vdot = F + Q + Q_k,    0 = g,    0 = k

``JaxDynamics`` derives what is not declared by automatic differentiation, ``NumpyDynamics`` by differences.  Wrapped around
these are ``ReducedDynamics`` (redundant rows left out), ``AugmentedDynamics`` (a regular mass), ``MatrixFree`` (products
instead of matrices) and ``ForeignDynamics`` (callbacks of machine code).  Symbols, shapes and units are those of the table
in :mod:`hhtbench.protocol.system`.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import equinox as eqx

from hhtbench.lowering.dynamics.mass import full
from hhtbench.protocol.system import WITH_VELOCITY, declared

plain_attributes = object.__getattribute__  # equinox looks at every attribute in Python, in case a method goes to ``jit``
Array = Any  # array of the namespace ``xp``: NumPy's, JAX's, or a tracer


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Sizes and dependencies of one system; hashable, so compiled code is shared between equal ones."""

    n: int  #: coordinates
    m: int  #: position constraints
    p: int  #: velocity constraints
    #: "identity", "constant", "variable"; in MatrixFree also "sparse": M has few entries, M^-1 many
    mass: str
    force_uses_q: bool = True  #: False: F_q is zero and not computed
    force_uses_v: bool = True  #: False: F_v is zero and not computed
    rheonomic: bool = True  #: False: g does not depend on t, g_t is zero and not computed
    linear_reaction: bool = True  #: True: Q is linear in lam, one solve gives the multipliers
    reaction_uses_v: bool = False  #: True: Q is declared as a function of v too
    velocity_jacobian_uses_v: bool = True  #: False: k is linear in v
    velocity_reaction_uses_v: bool = True  #: False: the velocity reaction's derivative by v is zero
    known_entries: bool = True  #: False: zero and constant entries of a step's matrix are computed like the others

    @property
    def constrained(self) -> bool:
        """True if there is any constraint."""
        return self.m + self.p > 0


def unless_given(derive: Callable[..., Any]) -> Callable[..., Any]:
    """Decorator: call the declared or subclass function of that name if there is one, else ``derive`` it."""

    @functools.wraps(derive)
    def term(self: Dynamics, *arguments: Array) -> Any:
        return self.call(derive.__name__, *arguments) if self.gives(derive.__name__) else derive(self, *arguments)

    return term


class Dynamics:
    """The terms of one system's equations of motion; pure functions apart from counting callbacks.

    A subclass gives some by ``call``; the others are derivatives of these by its ``jacobian`` and ``rate``.  Terms of
    constraints that are not declared have zero rows and are not called.  Differences are of first order where a
    derivative only enters Newton's matrix.
    """

    wraps: ClassVar[bool] = False  #: True for a :class:`Wrapper`; ``isinstance`` is slow for equinox classes
    system: Any  #: the ``System`` or ``NumpySystem``, with what its user declared
    structure: Structure  #: sizes n, m, p and what depends on what
    xp: Any  #: the array namespace: ``numpy`` or ``jax.numpy``
    constant_mass: Any  #: M (n, n) [kg, kg m^2] where it is constant, or a ``Diagonal``; None: identity or variable
    inverse_mass: Any  #: M^-1 (n, n) [1/kg, 1/(kg m^2)], likewise; None also where a constant M is singular
    matrices: ClassVar[bool] = True  #: True if its functions return full matrices
    noise: ClassVar[float] = 0.0  #: relative error of reactions computed by differences
    entries: Any = None  #: pattern of a variable mass, in MatrixFree
    least: float = 1.0  #: smallest size of coordinates when points near a state are chosen
    gives: Callable[[str], bool]  #: True if the function of that name is called, not derived
    call: Callable[..., Any]  #: (name, *arguments): value of a function that ``gives`` names
    jacobian: Callable[..., Array]  #: (function, x, pattern, order): derivative (rows, k) of a function (rows,) at x (k,)
    rate: Callable[..., Array]  #: (function, t, q, v): d/de of function(t + e, q + e v) at e = 0

    @property
    def dependencies(self) -> Dynamics:
        """The dynamics on which sparsity of derivatives is detected: itself, or a stand-in made of known patterns."""
        return self

    @unless_given
    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force F (n,) [N, N m]."""

    @unless_given
    def force_jacobians(self, t: Array, q: Array, v: Array) -> tuple[Array, Array]:
        """F_q (n, n) [N/m] and F_v (n, n) [N s/m]; None for one that is zero."""
        s = self.structure
        by_q = self.jacobian(lambda x: self.force(t, x, v), q, "force_q", 1) if s.force_uses_q else None
        return by_q, self.jacobian(lambda x: self.force(t, q, x), v, "force_v", 1) if s.force_uses_v else None

    @unless_given
    def mass(self, t: Array, q: Array) -> Array:
        """Mass matrix M (n, n) [kg, kg m^2]."""
        if self.structure.mass == "variable" and callable(declared(self.system, "mass_matrix")):
            return square(self.call("mass_matrix", t, q), self.xp)
        return self.xp.eye(self.structure.n) if self.constant_mass is None else full(self.constant_mass, self.xp)

    def mass_product(self, t: Array, q: Array, x: Array) -> Array:
        """M x (n,), x itself where M is the identity."""
        return x if self.structure.mass == "identity" else self.mass(t, q) @ x

    def over_mass(self, t: Array, q: Array, x: Array) -> Array:
        """M^-1 x (n,), x itself where M is the identity."""
        if self.structure.mass == "variable":
            return self.xp.linalg.solve(self.mass(t, q), x)
        return x if self.inverse_mass is None else self.inverse_mass @ x

    @unless_given
    def mass_product_jacobian(self, t: Array, q: Array, x: Array) -> Array:
        """Derivative of M x by q, (n, n), with x held."""
        return self.jacobian(lambda y: self.mass(t, y) @ x, q, "mass_product_jacobian", 1)

    @unless_given
    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints g (m,) [m, rad]."""

    @unless_given
    def constraint_jacobian(self, t: Array, q: Array) -> Array:
        """Constraint Jacobian g_q (m, n)."""
        return self.jacobian(lambda x: self.constraint(t, x), q, "constraint_jacobian")

    @unless_given
    def constraint_rows(self, t: Array, q: Array) -> Array:
        """g_q (m, n) in the accuracy that forces, accelerations and Newton's matrix need."""
        return self.constraint_jacobian(t, q)

    def position_row(self, t: Array, q: Array, x: Array) -> Array:
        """Product g_q x (m,)."""
        return self.constraint_jacobian(t, q) @ x

    def position_column(self, t: Array, q: Array, x: Array) -> Array:
        """Product g_q^T x (n,)."""
        return x @ self.constraint_jacobian(t, q)

    @unless_given
    def constraint_time_derivative(self, t: Array, q: Array) -> Array:
        """g_t (m,) [m/s, rad/s]."""
        return self.rate(lambda s, _: self.constraint(s, q), t, q, 0.0 * q)

    @unless_given
    def constraint_velocity(self, t: Array, q: Array, v: Array) -> Array:
        """dg/dt along the motion: g_t + g_q v (m,) [m/s, rad/s]."""
        along = self.constraint_jacobian(t, q) @ v
        return along + self.constraint_time_derivative(t, q) if self.structure.rheonomic else along

    @unless_given
    def constraint_velocity_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        """Derivative of g_t + g_q v by q, (m, n)."""
        return self.jacobian(lambda x: self.constraint_velocity(t, x, v), q, "constraint_jacobian", 1)

    @unless_given
    def constraint_acceleration(self, t: Array, q: Array, v: Array) -> Array:
        """g_tt + 2 g_tq v + g_qq(v, v) (m,) [m/s^2, rad/s^2]: d2g/dt2 is g_q vdot + this."""
        return self.rate(lambda s, x: self.constraint_velocity(s, x, v), t, q, v)

    @unless_given
    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        """Velocity constraints k (p,) [m/s, rad/s]."""

    @unless_given
    def velocity_constraint_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        """Velocity constraint Jacobian k_v (p, n)."""
        return self.jacobian(lambda x: self.velocity_constraint(t, q, x), v, "velocity_constraint_jacobian")

    @unless_given
    def velocity_constraint_rows(self, t: Array, q: Array, v: Array) -> Array:
        """k_v (p, n) in the accuracy that forces, accelerations and Newton's matrix need."""
        return self.velocity_constraint_jacobian(t, q, v)

    def velocity_row(self, t: Array, q: Array, v: Array, x: Array) -> Array:
        """Product k_v x (p,)."""
        return self.velocity_constraint_jacobian(t, q, v) @ x

    @unless_given
    def velocity_constraint_position_jacobian(self, t: Array, q: Array, v: Array) -> Array:
        """Derivative k_q of the velocity constraints by q, (p, n)."""
        return self.jacobian(lambda x: self.velocity_constraint(t, x, v), q, "velocity_constraint_q", 1)

    @unless_given
    def velocity_constraint_acceleration(self, t: Array, q: Array, v: Array) -> Array:
        """k_t + k_q v (p,) [m/s^2, rad/s^2]: dk/dt is k_v vdot + this."""
        return self.rate(lambda s, x: self.velocity_constraint(s, x, v), t, q, v)

    def reaction(self, t: Array, q: Array, v: Array, lam: Array) -> Array:
        """Reaction Q (n,) [N, N m] of the position constraints, -g_q^T lam unless declared."""
        if not self.gives("reaction"):
            return -(lam @ self.constraint_rows(t, q))
        return self.call("reaction", t, q, v, lam) if self.structure.reaction_uses_v else self.call("reaction", t, q, lam)

    def reaction_jacobians(self, t: Array, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array]:
        """Derivatives Q_q (n, n), Q_v (n, n) (None where it is zero) and Q_lam (n, m) of the reaction."""
        if self.gives("reaction_jacobians"):
            return self._declared_reaction_jacobians(t, q, v, lam)
        by_v, by_q = None, self.jacobian(lambda x: self.reaction(t, x, v, lam), q, "reaction_q", 1)
        if not self.gives("reaction"):
            return by_q, by_v, self.reaction_columns(t, q, v, lam)
        if self.structure.reaction_uses_v:
            by_v = self.jacobian(lambda x: self.reaction(t, q, x, lam), v, "reaction_v", 1)
        return by_q, by_v, self.jacobian(lambda x: self.reaction(t, q, v, x), lam, order=1)

    def _declared_reaction_jacobians(self, t: Array, q: Array, v: Array, lam: Array) -> tuple[Array, Array, Array]:
        if self.structure.reaction_uses_v:
            return self.call("reaction_jacobians", t, q, v, lam)
        by_q, by_lam = self.call("reaction_jacobians", t, q, lam)
        return by_q, None, by_lam

    def reaction_columns(self, t: Array, q: Array, v: Array, lam: Array) -> Array:
        """Derivative Q_lam of the reaction by lam, (n, m)."""
        if self.gives("reaction"):
            return self.reaction_jacobians(t, q, v, lam)[2]
        return -self.constraint_rows(t, q).T

    @unless_given
    def velocity_reaction(self, t: Array, q: Array, v: Array, mu: Array) -> Array:
        """Reaction Q_k (n,) [N, N m] of the velocity constraints, -k_v^T mu unless declared."""
        return -(mu @ self.velocity_constraint_rows(t, q, v))

    @unless_given
    def velocity_reaction_jacobians(self, t: Array, q: Array, v: Array, mu: Array) -> tuple[Array, Array]:
        """Derivatives of Q_k by v (n, n), None where it is zero, and by mu (n, p)."""
        by_v = None
        if self.structure.velocity_reaction_uses_v:
            by_v = self.jacobian(lambda x: self.velocity_reaction(t, q, x, mu), v, "velocity_reaction_v", 1)
        if not self.gives("velocity_reaction"):
            return by_v, -self.velocity_constraint_rows(t, q, v).T
        return by_v, self.jacobian(lambda x: self.velocity_reaction(t, q, v, x), mu, order=1)

    def residual(self, t: Array, q: Array, v: Array, inertia: Array, lam: Array, mu: Array) -> Array:
        """Imbalance of forces, M vdot - F - Q - Q_k (n,) [N, N m].

        ``inertia`` is M vdot (n,), computed by the caller; 0.0 gives minus the forces.
        """
        balance = inertia - self.force(t, q, v)
        if self.structure.m:
            balance = balance - self.reaction(t, q, v, lam)
        if self.structure.p:
            balance = balance - self.velocity_reaction(t, q, v, mu)
        return balance

    def acceleration_level(self, t: Array, q: Array, v: Array) -> tuple[Array, Array]:
        """C = [g_q; k_v] (m + p, n) and c (m + p,) [m/s^2, rad/s^2] of the differentiated constraints C vdot + c = 0."""
        rows, rest = [self.xp.zeros((0, self.structure.n))], [self.xp.zeros(0)]
        if self.structure.m:
            rows.append(self.constraint_rows(t, q))
            rest.append(self.constraint_acceleration(t, q, v))
        if self.structure.p:
            rows.append(self.velocity_constraint_rows(t, q, v))
            rest.append(self.velocity_constraint_acceleration(t, q, v))
        return self.xp.concatenate(rows), self.xp.concatenate(rest)


class Wrapper(eqx.Module, Dynamics):
    """A dynamics that changes some functions of ``inner`` and passes on the rest."""

    __getattribute__ = plain_attributes
    wraps: ClassVar[bool] = True
    inner: Dynamics

    def __getattr__(self, name: str) -> Any:
        if name == "inner" or name.startswith("__"):
            raise AttributeError(name)
        return getattr(self.inner, name)

    def gives(self, name: str) -> bool:
        """True for every function, as ``inner`` computes what is not changed."""
        return True

    def call(self, name: str, *arguments: Any) -> Any:
        """The function ``name`` of the inner dynamics."""
        return getattr(self.inner, name)(*arguments)

    def reaction(self, t: Any, q: Any, v: Any, lam: Any) -> Any:
        """Reaction of the inner dynamics."""
        return self.call("reaction", t, q, v, lam)

    def reaction_jacobians(self, t: Any, q: Any, v: Any, lam: Any) -> tuple[Any, Any, Any]:
        """Reaction Jacobians of the inner dynamics."""
        return self.call("reaction_jacobians", t, q, v, lam)

    def reaction_columns(self, t: Any, q: Any, v: Any, lam: Any) -> Any:
        """Q_lam of the inner dynamics."""
        return self.call("reaction_columns", t, q, v, lam)


def innermost(dynamics: Any) -> Any:
    """The dynamics inside all wrappers."""
    while type(dynamics).wraps:
        dynamics = dynamics.inner
    return dynamics


def as_declared(dynamics: Dynamics, name: str) -> Callable[..., Any]:
    """The function ``name`` of ``dynamics`` with the signature a user declares it with: no v where the reaction has none."""
    function: Callable[..., Any] = getattr(dynamics, name)
    if name not in WITH_VELOCITY or dynamics.structure.reaction_uses_v:
        return function
    if name == "reaction":
        return lambda t, q, lam: function(t, q, None, lam)
    return lambda t, q, lam: function(t, q, None, lam)[::2]


@functools.cache
def arguments_of(member: str) -> tuple[str, ...]:
    """Argument names of a function of :class:`Dynamics`, such as ("t", "q", "lam")."""
    return tuple(inspect.signature(getattr(Dynamics, member)).parameters)[1:]


def evaluate(dynamics: Dynamics, member: str, at: Mapping[str, Any]) -> Any:
    """Call the function ``member`` of ``dynamics`` with arguments taken by name from ``at``."""
    return getattr(dynamics, member)(*(at[name] for name in arguments_of(member)))


def square(mass: Any, xp: Any) -> Any:
    """Mass (n, n) from a declared one that may be given as its diagonal (n,)."""
    return xp.diag(mass) if mass.ndim == 1 else mass
