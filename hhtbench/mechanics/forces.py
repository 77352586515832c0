"""Forces of springs, dampers, drives and loads, for any coordinates: by virtual work, from what they are attached to.

A measure ``l(q)`` (j,), lengths or angles, with the force ``s(l, l')`` (j,) that pulls it shorter does the virtual work
``-s . dl``: its generalised force is ``-l_q^T s``.  Source: C. Lanczos, The Variational Principles of Mechanics, chapter I.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array


def distances(a: Array, b: Array) -> Array:
    """(j,) [m] between points ``a`` and ``b`` (j, d); never zero, or it has no derivative."""
    return jnp.sqrt(jnp.sum((a - b) ** 2, axis=-1))


def spring_damper(stiffness: Any, damping: Any, free: Any) -> Callable[[Array, Array], Array]:
    """The law ``k (l - l0) + c l'`` [N] for :func:`force_of`; numbers, or (j,), one for each element."""
    return lambda length, rate: jnp.asarray(stiffness) * (length - jnp.asarray(free)) + jnp.asarray(damping) * rate


def force_of(measure: Callable[[Array], Array], law: Callable[[Array, Array], Array], q: Array, v: Array) -> Array:
    """Generalised force (n,) of elements whose measures (j,) ``measure(q)`` gives, by ``law(l, l')`` (j,)."""
    value, pull = jax.vjp(measure, q)
    _, rate = jax.jvp(measure, (q,), (v,))
    return -pull(law(value, rate))[0]


def force_at(points: Callable[[Array], Array], force: Any, q: Array) -> Array:
    """Generalised force (n,) of ``force`` (j, d) [N] at the points (j, d) that ``points(q)`` gives."""
    _, pull = jax.vjp(points, q)
    return pull(jnp.broadcast_to(jnp.asarray(force, dtype=q.dtype), jax.eval_shape(points, q).shape))[0]
