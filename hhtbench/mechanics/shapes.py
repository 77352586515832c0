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
    """Return body numbers ``first`` (j,) and ``second`` (j,) of j joints; raise if lengths differ and none is 1."""
    one, other = expect_bodies("first", first, count), expect_bodies("second", second, count)
    if one.size != other.size and 1 not in (one.size, other.size):
        raise ValueError(f"first and second must be lists of as many bodies; got shapes {one.shape} and {other.shape}.")
    return tuple(jnp.broadcast_arrays(one, other))  # type: ignore[return-value]


def expect_bodies(name: str, bodies: Any, count: int, *, ground: bool = True) -> Array:
    """Return the numbers (j,) of bodies; of ``count`` the last is the ground, -1, unless there is none.

    JAX itself would take the last body for a number beyond it.
    """
    found = jnp.asarray(bodies)
    if found.ndim != 1:
        raise ValueError(f"{name} must be a list of numbers of bodies; got shape {found.shape}.")
    if isinstance(bodies, list | tuple | np.ndarray):
        for body in np.asarray(bodies).tolist():
            if not (0 <= body < count or (ground and body == -1)):
                end = f", and the ground is -1 or {count - 1}" if ground else ""
                raise ValueError(f"{name} names body {body}; there are bodies 0 to {count - 1 - ground}{end}.")
    return found


def expect_split(name: str, value: Array, size: int) -> Array:
    """``value`` (k size,) as (k, size), a row for each body."""
    if value.ndim != 1 or value.size % size:
        raise ValueError(f"{name} must hold {size} numbers for each body; got shape {value.shape}.")
    return value.reshape(-1, size)
