"""Generalised forces of springs, dampers, drives and loads in any coordinates, by virtual work.

Elements with lengths or angles ``l(q)`` (j,) and tensions ``s(l, l')`` (j,) do the virtual work ``-s . dl``: their
generalised force is ``-l_q^T s``.  Source: C. Lanczos, The Variational Principles of Mechanics, chapter I.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from itertools import cycle
from typing import Any

import jax
import jax.numpy as jnp
from jax import Array


def _plain(tensions: Array) -> None:
    """Give no tensions: derivatives take those of the element itself."""


_asked: ContextVar[Callable[[Array], Array | None]] = ContextVar("asked", default=_plain)


def distances(a: Array, b: Array) -> Array:
    """Distances (j,) [m] between points ``a`` and ``b`` (j, d); not differentiable where a distance is zero."""
    return jnp.sqrt(jnp.sum((a - b) ** 2, axis=-1))


def spring_damper(stiffness: Any, damping: Any, free: Any) -> Callable[[Array, Array], Array]:
    """Return the force law ``k (l - l0) + c l'`` [N] for :func:`force_of`; numbers, or arrays (j,), one per element."""
    return lambda length, rate: jnp.asarray(stiffness) * (length - jnp.asarray(free)) + jnp.asarray(damping) * rate


def force_of(measure: Callable[[Array], Array], law: Callable[[Array, Array], Array], q: Array, v: Array) -> Array:
    """Generalised force (n,) of j elements with lengths or angles ``measure(q)`` (j,) and tensions ``law(l, l')`` (j,).

    Its derivative takes the change of ``l_q^T`` at the element's tensions, or at those of :func:`tensions_given`.
    """
    _, pull = jax.vjp(measure, q)
    tensions = law(*rates(measure, q, v))
    given = _asked.get()(tensions)
    if given is None:
        return -pull(tensions)[0]
    curved = pull(jax.lax.stop_gradient(given))[0]
    _, fixed = jax.vjp(measure, jax.lax.stop_gradient(q))
    return jax.lax.stop_gradient(curved) - curved - fixed(tensions)[0]


def tensions_of(force: Callable[[], Any]) -> tuple[Array, ...]:
    """Tensions (j,) of every call of :func:`force_of` while ``force`` is evaluated, in the order of the calls."""
    found: list[Array] = []
    asked = _asked.set(found.append)
    try:
        force()
    finally:
        _asked.reset(asked)
    return tuple(found)


def tensions_in_use() -> bool:
    """True inside of :func:`tensions_of` and :func:`tensions_given`."""
    return _asked.get() is not _plain


@contextmanager
def tensions_given(tensions: Sequence[Array]) -> Iterator[None]:
    """Context in which the calls of :func:`force_of` have these ``tensions`` in the derivative of ``l_q^T``, in turn.

    The forces keep their values.
    """
    turn = cycle(tensions)
    asked = _asked.set(lambda _: next(turn))
    try:
        yield
    finally:
        _asked.reset(asked)


def rates(measure: Callable[[Array], Array], q: Array, v: Array) -> tuple[Array, Array]:
    """Return ``measure(q)`` (j,) and its rate of change (j,) with the velocities ``v``."""
    value, rate = jax.jvp(measure, (q,), (v,))
    return value, rate


def power_lost(measure: Callable[[Array], Array], law: Callable[[Array, Array], Array], q: Array, v: Array) -> Array:
    """Power [W], at most 0, that the rate-dependent part ``s(l, l') - s(l, 0)`` of a law takes from the energy."""
    value, rate = rates(measure, q, v)
    return -jnp.sum((law(value, rate) - law(value, jnp.zeros_like(rate))) * rate)


def force_at(points: Callable[[Array], Array], force: Any, q: Array) -> Array:
    """Generalised force (n,) of the forces ``force`` (j, d) [N] at the points ``points(q)`` (j, d)."""
    _, pull = jax.vjp(points, q)
    return pull(jnp.broadcast_to(jnp.asarray(force, dtype=q.dtype), jax.eval_shape(points, q).shape))[0]
