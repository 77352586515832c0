"""``inverse``: the inverse of a matrix as one primitive for every route.

``jnp.linalg.inv`` is traced to dozens of operations with integer permutations inside, whose meaning the native route could
only guess.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp

from hhtbench.lowering.jax_internals import Primitive, ad, batching, mlir

inverse_p = Primitive("hhtbench_inverse")


def inverse(x: Any) -> Any:
    """Inverse of ``x`` (..., n, n), float64; not finite where it is singular."""
    return inverse_p.bind(jnp.asarray(x))


def _differential(primals: Any, tangents: Any) -> Any:
    (x,), (x_dot,) = primals, tangents
    y = inverse(x)
    return y, -(y @ ad.instantiate_zeros(x_dot) @ y)


def _batched(arguments: Any, axes: Any) -> Any:
    (x,), (axis,) = arguments, axes
    return inverse(jnp.moveaxis(x, axis, 0)), 0


inverse_p.def_impl(jnp.linalg.inv)
inverse_p.def_abstract_eval(lambda x: x)
mlir.register_lowering(inverse_p, mlir.lower_fun(jnp.linalg.inv, multiple_results=False))
ad.primitive_jvps[inverse_p] = _differential
batching.primitive_batchers[inverse_p] = _batched
