"""JAX functions outside of its stable interface; pyproject.toml bounds the JAX version because of them.

The bound also holds for names and parameters of primitives in the rules of the scalar compiler.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from jax._src import source_info_util
from jax.extend.core import ClosedJaxpr, Literal, Primitive
from jax.interpreters import ad, batching, mlir, partial_eval

__all__ = ["ClosedJaxpr", "Literal", "Primitive", "ad", "batching", "line_of", "mlir", "used_inputs", "without_dead_code"]


def without_dead_code(closed: ClosedJaxpr) -> ClosedJaxpr:
    """The computation without equations that no output needs, such as values beside their derivatives; same inputs."""
    jaxpr, _ = partial_eval.dce_jaxpr(closed.jaxpr, [True] * len(closed.jaxpr.outvars), instantiate=True)
    return ClosedJaxpr(jaxpr, closed.consts)


def used_inputs(jaxpr: Any) -> Sequence[bool]:
    """For each input, whether any output depends on it (dead code removed)."""
    _, used = partial_eval.dce_jaxpr(jaxpr, [True] * len(jaxpr.outvars))
    return used


def line_of(equation: Any) -> str:
    """The user's line that made ``equation``; "" if a library made it."""
    return str(source_info_util.summarize(equation.source_info) or "")
