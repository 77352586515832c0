"""Terms of a :class:`~hhtbench.protocol.NumpySystem`; what it does not declare comes from differences.

Callbacks get read-only copies and a plain float t; results are copied, and checked for type, shape and finiteness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hhtbench.arguments import FLOAT, all_finite, real_values
from hhtbench.counting import note_callback
from hhtbench.errors import NonFiniteValue, ProblemError
from hhtbench.lowering.dynamics.differences import derivative, derivative_along, second_derivative_along
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, unless_given
from hhtbench.protocol import SIGNATURES, NumpySystem, declared, signature_of

ROWS = {
    "force": "one entry per coordinate",
    "mass_matrix": "(coordinates, coordinates)",
    "constraint_jacobian": "(constraints, coordinates); row i is the derivative of constraint i",
    "velocity_constraint_jacobian": "(velocity constraints, coordinates); row i is the derivative of constraint i by v",
}


@dataclass(frozen=True)
class NumpyDynamics(Dynamics):
    """Every term of the equations of motion on NumPy arrays."""

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

    @cached_property
    def functions(self) -> dict[str, Callable[..., Any]]:
        """The declared callbacks, for a float t and copies that are theirs; results are checked, but may change later."""
        names = (name for name in SIGNATURES if name not in self.ignored and callable(declared(self.system, name)))
        return {name: self._checked(name) for name in names}

    def gives(self, name: str) -> bool:
        """Whether the user declares the function ``name``, and it is not to be ignored."""
        return name in self.functions

    def _checked(self, name: str) -> Callable[..., Any]:
        function, tell, s = getattr(self.system, name), self.on_call, self.structure
        shapes = signature_of(self.system, name).shapes(s.n, s.m, s.p)
        one = shapes[0] if len(shapes) == 1 else None

        def evaluate(t: float, *arguments: np.ndarray) -> Any:
            tell(name)
            for argument in arguments:
                argument.setflags(False)  # type: ignore[call-arg] # by its keyword it would take twice as long
            value = function(t, *arguments)
            return checked_parts(name, value, shapes, t) if one is None else checked_result(name, value, one, t)

        return evaluate

    def call(self, name: str, t: Any, *arguments: Any) -> Any:
        """The checked result of the callback ``name``, an array or several, which nobody else holds."""
        value = self.functions[name](float(t), *[np.array(argument, dtype=np.float64) for argument in arguments])
        if isinstance(value, tuple):
            return tuple(part if part is None else part.copy() for part in value)
        return value.copy()

    def jacobian(self, function: Callable[[Any], Any], x: Any, pattern: str = "", order: int = 4) -> Any:
        return derivative(function, x, order, self.patterns.get(pattern), least=self.least)

    @cached_property
    def patterns(self) -> dict[str, Any]:
        """The patterns that are declared, and those of default reactions, which follow."""
        found = dict(declared(self.system, "sparsity") or {})
        for name, of_rows in (("reaction", "constraint_jacobian"), ("velocity_reaction", "velocity_constraint_jacobian")):
            if of_rows in found and not self.gives(name):
                rows = np.asarray(found[of_rows], dtype=np.float64)
                found.setdefault("reaction_q" if name == "reaction" else "velocity_reaction_v", rows.T @ rows > 0.0)
        return found

    def rate(self, function: Callable[[Any, Any], Any], t: Any, q: Any, v: Any) -> Any:
        return derivative_along(lambda e: function(t + e, q + e * v), float(t), q, v, least=self.least)

    @unless_given
    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """g_tt + 2 g_tq v + g_qq(v, v) (m,): without a declared Jacobian the second difference of g, not one of one."""
        if self.gives("constraint_jacobian"):
            return super().constraint_acceleration(t, q, v)
        return second_derivative_along(lambda e: self.constraint(t + e, q + e * v), float(t), q, v, least=self.least)


def checked_parts(function: str, value: Any, shapes: tuple[tuple[int, ...], ...], t: float) -> tuple[np.ndarray | None, ...]:
    """A callback's matrices, each checked; None stands for zero."""
    return tuple(
        None if part is None else checked_result(f"{function}[{i}]", part, shape, t)
        for i, (part, shape) in enumerate(zip(expect_parts(function, value, shapes), shapes, strict=True))
    )


def checked_result(function: str, value: Any, expected: tuple[int, ...], t: float) -> np.ndarray:
    """A callback's result as float64, itself where it is an array of them; refused when its type, shape or values are wrong.

    A scalar of the system counts as no array: ``(1,)`` is wanted where n = 1.
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


def wrong_shape(function: str, expected: tuple[int, ...] | str, given: Any) -> ProblemError:
    """The error for a result of the wrong shape."""
    hint = f" = {ROWS[function]}" if function in ROWS else ""
    return ProblemError(f"{function} must return shape {expected}{hint}; got {given}. Nothing is broadcast.")


def expect_parts(function: str, value: Any, shapes: tuple[tuple[int, ...], ...]) -> Any:
    """``value``, raising unless it holds as many matrices as ``shapes``."""
    if not isinstance(value, (tuple, list)) or len(value) != len(shapes):
        many, got = {2: "two", 3: "three"}[len(shapes)], type(value).__name__
        got += f" of {len(value)}" if isinstance(value, (tuple, list)) else ""
        raise TypeError(f"{function} must return {many} matrices of shapes {shapes}; got {got}.")
    return value
