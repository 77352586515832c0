"""What a system declares and depends on: read once, so that what is absent is never computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np

from hhtbench.arguments import traced
from hhtbench.counting import preparing
from hhtbench.errors import ProblemError
from hhtbench.lowering.jax_internals import used_inputs

ROWS = {
    "force": "one entry per coordinate",
    "mass_matrix": "(coordinates, coordinates)",
    "constraint_jacobian": "(constraints, coordinates); row i is the derivative of constraint i",
    "velocity_constraint_jacobian": "(velocity constraints, coordinates); row i is the derivative of constraint i by v",
}


@dataclass(frozen=True, kw_only=True)
class Structure:
    """Sizes and dependencies of one system; hashable, so compiled code is shared between equal ones."""

    n: int  #: coordinates
    m: int  #: position constraints
    p: int  #: velocity constraints
    mass: str  #: "identity", "constant" or "variable"
    force_uses_q: bool = True  #: False: F_q is zero and not computed
    force_uses_v: bool = True  #: False: F_v is zero and not computed
    rheonomic: bool = True  #: False: g does not depend on t, g_t is zero and not computed
    linear_reaction: bool = True  #: True: Q is linear in lam, one solve gives the multipliers
    velocity_jacobian_uses_v: bool = True  #: False: k is linear in v
    velocity_reaction_uses_v: bool = True  #: False: the velocity reaction's derivative by v is zero

    @property
    def constrained(self) -> bool:
        """True when there is any constraint."""
        return self.m + self.p > 0


def used_arguments(function: Callable[..., Any], *arguments: Any) -> tuple[bool, ...]:
    """For each argument, whether any output of ``function`` depends on it (dead code removed from its jaxpr)."""
    with preparing(f"tracing {getattr(function, '__name__', 'a derivative')}"):
        closed = jax.make_jaxpr(function)(*arguments)
    if any(isinstance(value, jax.core.Tracer) for value in closed.consts):
        raise traced("a value outside of the system that its functions use")
    used = used_inputs(closed.jaxpr)
    sizes = [len(jax.tree.leaves(argument)) for argument in arguments]
    bounds = np.cumsum([0, *sizes])
    return tuple(any(used[bounds[i] : bounds[i + 1]]) for i in range(len(arguments)))


def wrong_shape(function: str, expected: tuple[int, ...] | str, given: Any) -> ProblemError:
    """The error for a result of the wrong shape."""
    hint = f" = {ROWS[function]}" if function in ROWS else ""
    return ProblemError(f"{function} must return shape {expected}{hint}; got {given}. Nothing is broadcast.")


def expect_pair(function: str, value: Any, shapes: tuple[tuple[int, ...], ...]) -> Any:
    """``value``, raising unless it is a pair."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise TypeError(f"{function} must return two matrices of shapes {shapes}; got {type(value).__name__}.")
    return value
