"""Cholesky factorisation of a band and solves with it, as primitives for machine code and XLA."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp

from hhtbench.lowering.jax_internals import Primitive, ad, batching, mlir

banded_p, factor_p = Primitive("hhtbench_banded"), Primitive("hhtbench_factor")


def factor_banded(band: Any) -> Any:
    """Cholesky factors of a symmetric positive definite band, for :func:`solve_banded`; NaN if it is not positive definite.

    ``band`` (n, w + 1): row i holds A[i, i - w], ..., A[i, i], zero where there is no such column.
    """
    return factor_p.bind(jnp.asarray(band))


def solve_banded(factors: Any, right: Any) -> Any:
    """Solve L L^T x = ``right`` for x (n,), float64.

    ``factors`` (n, w + 1): row i holds L[i, i - w], ..., L[i, i - 1], zero where there is no such column, and 1 / L[i, i].
    """
    return banded_p.bind(jnp.asarray(factors), jnp.asarray(right))


def _factored(band: Any) -> Any:
    width = band.shape[1] - 1

    def row(known: Any, entries: Any) -> tuple[Any, Any]:
        """Row i from the ``known`` rows i - w, ..., i - 1."""
        found = entries
        for j in range(width):
            rest = found[j] - found[:j] @ known[j, width - j : width]
            found = found.at[j].set(rest * known[j, width])
        found = found.at[width].set(1.0 / jnp.sqrt(found[width] - found[:width] @ found[:width]))
        return jnp.concatenate([known[1:], found[None]]) if width else known, found

    return jax.lax.scan(row, jnp.zeros((width, width + 1)), band)[1]


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


factor_p.def_impl(jax.jit(_factored))
factor_p.def_abstract_eval(lambda band: band)
mlir.register_lowering(factor_p, mlir.lower_fun(_factored, multiple_results=False))
banded_p.def_impl(jax.jit(_solved))
banded_p.def_abstract_eval(lambda factors, right: right)
mlir.register_lowering(banded_p, mlir.lower_fun(_solved, multiple_results=False))
ad.primitive_jvps[banded_p] = _differential
batching.primitive_batchers[banded_p] = _batched
