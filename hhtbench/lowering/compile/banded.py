"""``solve_banded``: a solve with the Cholesky factors of a band as one operation that machine code and XLA carry out."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from hhtbench.lowering.jax_internals import Primitive, ad, batching, mlir

banded_p = Primitive("hhtbench_banded")


def solve_banded(factors: Any, right: Any) -> Any:
    """The solution x (n,) of L L^T x = ``right``, float64.

    ``factors`` (n, w + 1): row i holds L[i, i - w], ..., L[i, i - 1], zero where there is no such column, and 1 / L[i, i].
    """
    return banded_p.bind(jnp.asarray(factors), jnp.asarray(right))


def _solved(factors: Any, right: Any) -> Any:
    width = factors.shape[1] - 1

    def forward(known: Any, given: Any) -> tuple[Any, Any]:
        row, value = given
        found = (value - row[:width] @ known) * row[width]
        return jnp.append(known, found)[1:], found

    def backward(pending: Any, given: Any) -> tuple[Any, Any]:
        row, value = given
        found = (value - pending[width]) * row[width]
        return jnp.append(0.0, pending[:width] + row[:width] * found), found

    _, between = jax.lax.scan(forward, jnp.zeros(width), (factors, right))
    return jax.lax.scan(backward, jnp.zeros(width + 1), (factors, between), reverse=True)[1]


def _differential(primals: Any, tangents: Any) -> Any:
    (factors, right), (of_factors, of_right) = primals, tangents
    if not isinstance(of_factors, ad.Zero):
        raise NotImplementedError("the derivative of a solve with a band by the band.")
    return solve_banded(factors, right), solve_banded(factors, ad.instantiate_zeros(of_right))


def _batched(arguments: Any, axes: Any) -> Any:
    return jax.vmap(_solved, axes)(*arguments), 0


banded_p.def_impl(jax.jit(_solved))
banded_p.def_abstract_eval(lambda factors, right: right)
mlir.register_lowering(banded_p, mlir.lower_fun(_solved, multiple_results=False))
ad.primitive_jvps[banded_p] = _differential
batching.primitive_batchers[banded_p] = _batched
