"""Check the shapes of the arguments of bodies and joints."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np
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


def expect_pairs(first: Any, second: Any, count: int) -> tuple[Array, Array]:
    """Return the body numbers ``first`` (j,) and ``second`` (j,) of j joints as arrays; raise if their lengths differ."""
    one, other = expect_bodies("first", first, count), expect_bodies("second", second, count)
    if one.shape != other.shape:
        raise ValueError(f"first and second must be lists of as many bodies; got shapes {one.shape} and {other.shape}.")
    return one, other


def expect_bodies(name: str, bodies: Any, count: int) -> Array:
    """Numbers (j,) of bodies, of which there are ``count``; JAX would take the last one for a number beyond it."""
    found = jnp.asarray(bodies)
    if found.ndim != 1:
        raise ValueError(f"{name} must be a list of numbers of bodies; got shape {found.shape}.")
    if isinstance(bodies, list | tuple | np.ndarray):
        for body in np.asarray(bodies).tolist():
            if not -count <= body < count:
                raise ValueError(f"{name} names body {body}; there are bodies 0 to {count - 2}, and the ground is -1.")
    return found


def expect_split(name: str, value: Array, size: int) -> Array:
    """``value`` (k size,) as (k, size), a row for each body."""
    if value.ndim != 1 or value.size % size:
        raise ValueError(f"{name} must hold {size} numbers for each body; got shape {value.shape}.")
    return value.reshape(-1, size)
