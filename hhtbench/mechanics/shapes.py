"""Check the shapes of the arguments of bodies and joints."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jax import Array


def expect_rows(name: str, value: Any, bodies: Array, *size: int) -> Array:
    """Return ``value`` as an array (j, *size): one row for each of the bodies (j,), or one row that serves all.

    Raises
    ------
    ValueError
        The shape is another; the text names the argument.
    """
    found = jnp.asarray(value)
    if found.shape[1:] != size or found.shape[0] not in (1, bodies.size):
        wanted = f"({', '.join(map(str, (bodies.size, *size)))})"
        hint = f" One body needs a list of one row: {name}=[[...]]." if found.shape == size else ""
        raise ValueError(f"{name} must have the shape {wanted}, one row per body named; got {found.shape}.{hint}")
    return jnp.broadcast_to(found, (bodies.size, *size))


def expect_pairs(first: Any, second: Any) -> tuple[Array, Array]:
    """Return the body numbers ``first`` (j,) and ``second`` (j,) of j joints as arrays; raise if their lengths differ."""
    one, other = jnp.asarray(first), jnp.asarray(second)
    if one.ndim != 1 or one.shape != other.shape:
        raise ValueError(f"first and second must be lists of as many bodies; got shapes {one.shape} and {other.shape}.")
    return one, other
