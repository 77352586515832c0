"""Terms of a :class:`~hhtbench.protocol.system.NumpySystem`; what it does not declare comes from differences.

Callbacks get read-only copies and a plain float t; results are copied, and checked for type, shape and finiteness.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from hhtbench.lowering.dynamics.declared import expect_parts, mass_as_matrix, mass_kind, rows_of, wrong_shape
from hhtbench.lowering.dynamics.differences import (
    EPS,
    MIXED_STEP,
    derivative,
    derivative_along,
    least_size,
    product,
    second_derivative,
    second_derivative_along,
)
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, unless_given
from hhtbench.lowering.dynamics.mass import inverse_of
from hhtbench.lowering.dynamics.reductions import generalised
from hhtbench.protocol.arguments import FLOAT, Vector, all_finite, real_values
from hhtbench.protocol.errors import NonFiniteValue
from hhtbench.protocol.system import (
    SIGNATURES,
    NumpySystem,
    checked_patterns,
    declared,
    full_pattern,
    reaction_takes_velocity,
    signature_of,
)
from hhtbench.solution.counting import differencing, kept_of_solve, note_callback

MOST_BYTES = 2**20  # bytes of Jacobians that one solve stores: those at the ends of steps serve their rows
FEWEST_PLACES = 6  # the start of a step, its stage and its end, each by either order
NOISE = EPS ** (2 / 3)  # relative error of reactions by differences of second order


@dataclass(frozen=True)
class NumpyDynamics(Dynamics):
    """Terms of a NumpySystem's equations of motion, on NumPy arrays."""

    system: NumpySystem
    structure: Structure
    ignored: tuple[str, ...] = ()
    constant_mass: Any = None
    inverse_mass: Any = None
    least: float = 1.0
    on_call: Callable[[str], None] = note_callback  #: told the name of every callback before it is called

    @property
    def xp(self) -> Any:
        return np

    @property
    def noise(self) -> float:  # type: ignore[override] # depends on what is declared
        s, gives = self.structure, self.gives
        position = s.m and not (gives("reaction") or gives("constraint_jacobian"))
        velocity = s.p and not (gives("velocity_reaction") or gives("velocity_constraint_jacobian"))
        return NOISE if position or velocity else 0.0

    @cached_property
    def functions(self) -> dict[str, Callable[..., Any]]:
        """The declared callbacks, taking a float t and arrays that they own; results are checked but not copied."""
        names = (name for name in SIGNATURES if name not in self.ignored and callable(declared(self.system, name)))
        return {name: self._checked(name) for name in names}

    def gives(self, name: str) -> bool:
        """True if the user declares the function ``name`` and it is not ignored."""
        return name in self.functions

    def _checked(self, name: str) -> Callable[..., Any]:
        function, tell, s = getattr(self.system, name), self.on_call, self.structure
        shapes = signature_of(self.system, name).shapes(s.n, s.m, s.p)
        one, diagonal = shapes[0] if len(shapes) == 1 else None, name == "mass_matrix"

        def evaluate(t: float, *arguments: np.ndarray) -> Any:
            tell(name)
            for argument in arguments:
                argument.setflags(False)  # type: ignore[call-arg] # by its keyword it would take twice as long
            value = function(t, *arguments)
            if diagonal and np.shape(value) == (s.n,) and not np.ma.isMaskedArray(value):
                value = np.diag(value)
            return checked_parts(name, value, shapes, t) if one is None else checked_result(name, value, one, t)

        return evaluate

    def call(self, name: str, t: Any, *arguments: Any) -> Any:
        """Checked copy of the result of the callback ``name``, an array or several."""
        value = self.functions[name](float(t), *[np.array(argument, dtype=np.float64) for argument in arguments])
        if isinstance(value, tuple):
            return tuple(part if part is None else part.copy() for part in value)
        return value.copy()

    def jacobian(self, function: Callable[[Any], Any], x: Any, pattern: str = "", order: int = 4) -> Any:
        return self._by_differences(derivative, function, x, order, self.patterns.get(pattern))

    def _by_differences(self, scheme: Callable[..., Any], *arguments: Any, **how: Any) -> Any:
        """Apply a ``scheme`` of differences, its calls counted for the derivative that a declaration would save."""
        with differencing(lambda name: bool(self.ignored) or self.gives(name)):  # a wrong one: no hint to declare it
            return scheme(*arguments, least=self.least, **how)

    @cached_property
    def patterns(self) -> dict[str, Any]:
        """Declared patterns, and those of default reactions that follow from them."""
        given = checked_patterns(declared(self.system, "sparsity"))
        found = {name: full_pattern(pattern) for name, pattern in given.items()}
        for name, of_rows in (("reaction", "constraint_jacobian"), ("velocity_reaction", "velocity_constraint_jacobian")):
            if of_rows in found and not self.gives(name):
                rows = np.asarray(found[of_rows], dtype=np.float64)
                found.setdefault("reaction_q" if name == "reaction" else "velocity_reaction_v", rows.T @ rows > 0.0)
        return found

    def rate(self, function: Callable[[Any, Any], Any], t: Any, q: Any, v: Any) -> Any:
        return self._by_differences(derivative_along, lambda e: function(t + e, q + e * v), float(t), q, v)

    def _kept(self, name: str, make: Callable[..., Any], t: Any, *place: Any) -> Any:
        """Result of ``make`` at a point, cached for the last points of the solve."""
        kept, key = kept_of_solve(), (id(self), name, float(t), *(np.asarray(x).tobytes() for x in place))
        owner, found = kept.pop(key, (None, None))
        if owner is not self:
            found = make(t, *place)
            found.setflags(write=False)
        kept[key] = self, found  # the last one asked for stands last
        if len(kept) > max(FEWEST_PLACES, MOST_BYTES // found.nbytes):
            del kept[next(iter(kept))]
        return found

    @unless_given
    def constraint_jacobian(self, t: Any, q: Any) -> Any:
        """Constraint Jacobian g_q (m, n), with an error of 1e-12 if by differences."""
        return self._kept("constraint_jacobian", super().constraint_jacobian, t, q)

    @unless_given
    def velocity_constraint_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """Velocity constraint Jacobian k_v (p, n), with an error of 1e-12 if by differences."""
        return self._kept("velocity_constraint_jacobian", super().velocity_constraint_jacobian, t, q, v)

    @unless_given
    def constraint_velocity(self, t: Any, q: Any, v: Any) -> Any:
        """g_t + g_q v (m,); without a declared Jacobian by differences along v, in four calls."""
        if self.gives("constraint_jacobian"):
            return super().constraint_velocity(t, q, v)
        along = self._by_differences(product, lambda x: self.constraint(t, x), q, v)
        return along + self.constraint_time_derivative(t, q) if self.structure.rheonomic else along

    @unless_given
    def constraint_velocity_jacobian(self, t: Any, q: Any, v: Any) -> Any:
        """(g_t + g_q v)_q (m, n): without a declared Jacobian from second differences of g, for Newton's matrix."""
        if self.gives("constraint_jacobian"):
            return super().constraint_velocity_jacobian(t, q, v)

        def velocity(x: Any) -> Any:
            return derivative_along(lambda e: self.constraint(t + e, x + e * v), float(t), q, v, 2, least=self.least)

        return self._by_differences(derivative, velocity, q, 2, self.patterns.get("constraint_jacobian"), step=MIXED_STEP)

    @unless_given
    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """g_tt + 2 g_tq v + g_qq(v, v) (m,); without a declared Jacobian by second differences of g."""
        if self.gives("constraint_jacobian"):
            return super().constraint_acceleration(t, q, v)
        curve = lambda e: self.constraint(t + e, q + e * v)  # noqa: E731
        return self._by_differences(second_derivative_along, curve, float(t), q, v)

    def constraint_rows(self, t: Any, q: Any) -> Any:
        """g_q (m, n); without a declared Jacobian with an error of 4e-11, by half the calls."""
        if self.gives("constraint_jacobian"):
            return self.constraint_jacobian(t, q)
        rows = lambda t, q: self.jacobian(lambda x: self.constraint(t, x), q, "constraint_jacobian", 2)  # noqa: E731
        return self._kept("constraint_rows", rows, t, q)

    def reaction_jacobians(self, t: Any, q: Any, v: Any, lam: Any) -> tuple[Any, Any, Any]:
        """Q_q (n, n), Q_v, None where it is zero, and Q_lam (n, m), without a declared Jacobian by second differences."""
        if any(map(self.gives, ("reaction", "reaction_jacobians", "constraint_jacobian"))):
            return super().reaction_jacobians(t, q, v, lam)
        pattern = self.patterns.get("constraint_jacobian")
        by_q = -self._by_differences(second_derivative, lambda x: self.constraint(t, x), q, lam, pattern)
        return by_q, None, self.reaction_columns(t, q, v, lam)

    def velocity_constraint_rows(self, t: Any, q: Any, v: Any) -> Any:
        """k_v (p, n) as declared, else cached and by differences of order 2, not 4, so by half the calls."""
        if self.gives("velocity_constraint_jacobian"):
            return self.velocity_constraint_jacobian(t, q, v)

        def rows(t: Any, q: Any, v: Any) -> Any:
            return self.jacobian(lambda x: self.velocity_constraint(t, q, x), v, "velocity_constraint_jacobian", 2)

        return self._kept("velocity_constraint_rows", rows, t, q, v)

    @unless_given
    def velocity_reaction_jacobians(self, t: Any, q: Any, v: Any, mu: Any) -> tuple[Any, Any]:
        """Q_k by v (n, n) and by mu (n, p), like :meth:`reaction_jacobians`."""
        if self.gives("velocity_reaction") or self.gives("velocity_constraint_jacobian"):
            return super().velocity_reaction_jacobians(t, q, v, mu)
        pattern = self.patterns.get("velocity_constraint_jacobian")
        by_v = -self._by_differences(second_derivative, lambda x: self.velocity_constraint(t, q, x), v, mu, pattern)
        return by_v, -self.velocity_constraint_rows(t, q, v).T


def checked_parts(function: str, value: Any, shapes: tuple[tuple[int, ...], ...], t: float) -> tuple[np.ndarray | None, ...]:
    """Matrices returned by a callback, each checked; None means zero."""
    return tuple(
        None if part is None else checked_result(f"{function}[{i}]", part, shape, t)
        for i, (part, shape) in enumerate(zip(expect_parts(function, value, shapes), shapes, strict=True))
    )


def checked_result(function: str, value: Any, expected: tuple[int, ...], t: float) -> np.ndarray:
    """A callback's result as float64; raises if its type, shape or values are wrong.

    Not copied if it is a float64 array.  A scalar is refused: ``(1,)`` is needed where n = 1.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT:
        array = value
    else:
        try:
            array = real_values(f"{function} result", value)
        except TypeError as error:
            raise TypeError(f"{function} must return an array of real numbers of shape {expected}: {error}") from error
    if array.shape != expected:
        raise wrong_shape(function, expected, array.shape)
    if not all_finite(array):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise NonFiniteValue(function, where, float(array[where]), t)
    return array


def structure_of(system: NumpySystem, t: float, q: Vector, v: Vector) -> Structure:
    """Structure of ``system``, whose functions are called once at the point to count its constraints."""

    def result(name: str) -> np.ndarray:
        copies = [np.array({"q": q, "v": v}[symbol], dtype=np.float64) for symbol in SIGNATURES[name].arguments[1:]]
        for copy in copies:
            copy.setflags(write=False)
        return real_values(f"{name} result", getattr(system, name)(float(t), *copies))

    m, p = rows_of(system, result)
    linear = declared(system, "reaction") is None and declared(system, "velocity_reaction") is None
    uses_v = reaction_takes_velocity(system)
    return Structure(n=np.size(q), m=m, p=p, mass=mass_kind(system), linear_reaction=linear, reaction_uses_v=uses_v)


def derive_numpy(
    system: NumpySystem,
    structure: Structure,
    t: float,
    q: Vector,
    v: Vector,
    ignored: tuple[str, ...],
    without: tuple[str, ...],
) -> NumpyDynamics:
    """The dynamics of ``system``; see :func:`~.derive.derive`."""
    mass = declared(system, "mass_matrix") if structure.mass == "constant" else None
    constant = mass_as_matrix(mass, structure.n, np)
    found = NumpyDynamics(system, generalised(structure, without), ignored, constant, inverse_of(constant, np))
    return replace(found, least=least_size(_differenced(found, t, v), q))


def _differenced(dynamics: NumpyDynamics, t: float, v: Vector) -> Iterator[Callable[[Vector], Any]]:
    """Yield the declared functions of q whose derivatives are not declared."""
    gives = dynamics.gives
    if not gives("force_jacobians"):
        yield lambda q: dynamics.force(t, q, v)
    if gives("constraint") and not (gives("constraint_jacobian") and gives("constraint_acceleration")):
        yield lambda q: dynamics.constraint(t, q)
    if gives("velocity_constraint"):  # nothing declares its derivative by q
        yield lambda q: dynamics.velocity_constraint(t, q, v)
    if gives("mass_matrix"):
        yield lambda q: dynamics.mass(t, q).ravel()
