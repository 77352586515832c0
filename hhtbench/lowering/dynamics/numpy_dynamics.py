"""Terms of a :class:`~hhtbench.protocol.NumpySystem`; what it does not declare comes from differences.

Callbacks get read-only copies and a plain float t; results are copied, and checked for type, shape and finiteness.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hhtbench.counting import check_clock
from hhtbench.lowering.dynamics.derived import DerivedDynamics, unless_declared
from hhtbench.lowering.dynamics.differences import derivative, derivative_along, second_derivative_along
from hhtbench.lowering.dynamics.shapes import called, checked_result, expect_pair
from hhtbench.lowering.dynamics.structure import Structure
from hhtbench.protocol import SIGNATURES, NumpySystem, declared


@dataclass(frozen=True)
class NumpyDynamics(DerivedDynamics):
    """Every term of the equations of motion on NumPy arrays."""

    system: NumpySystem
    structure: Structure
    ignored: tuple[str, ...] = ()
    constant_mass: Any = None
    inverse_mass: Any = None
    on_call: Callable[[str], None] = check_clock  #: told the name of every callback before it is called

    @property
    def xp(self) -> Any:
        return np

    @cached_property
    def _shapes(self) -> dict[str, tuple[tuple[int, ...], ...]]:
        s = self.structure
        return {name: signature.shapes(s.n, s.m, s.p) for name, signature in SIGNATURES.items()}

    def call(self, name: str, t: Any, *arguments: Any) -> Any:
        """The checked result of the callback ``name``, an array or a pair."""
        self.on_call(name)
        value, shapes = called(self.system, name, t, *arguments), self._shapes[name]
        if len(shapes) == 1:
            return checked_result(name, value, shapes[0], float(t))
        return tuple(
            None if part is None else checked_result(f"{name}[{i}]", part, shape, float(t))
            for i, (part, shape) in enumerate(zip(expect_pair(name, value, shapes), shapes, strict=True))
        )

    def jacobian(self, function: Callable[[Any], Any], x: Any, pattern: str = "", order: int = 4) -> Any:
        return derivative(function, x, order, (declared(self.system, "sparsity") or {}).get(pattern))

    def rate(self, function: Callable[[Any, Any], Any], t: Any, q: Any, v: Any) -> Any:
        return derivative_along(lambda e: function(t + e, q + e * v), float(t), q, v)

    @unless_declared
    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """g_tt + 2 g_tq v + g_qq(v, v) (m,): without a declared Jacobian the second difference of g, not one of one."""
        if self.gives("constraint_jacobian"):
            return super().constraint_acceleration(t, q, v)
        return second_derivative_along(lambda e: self.constraint(t + e, q + e * v), float(t), q, v)
