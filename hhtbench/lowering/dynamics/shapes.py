"""Checks of what a system's functions return: expected against given shape, named function."""

from __future__ import annotations

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import real_values
from hhtbench.counting import preparing
from hhtbench.errors import NonFiniteValue, ProblemError
from hhtbench.lowering.dynamics.diagonal import Diagonal
from hhtbench.protocol import System

FLOAT = np.dtype(np.float64)
FEW = 36  # entries
FULL_MASS = 256  # coordinates up to which a constant diagonal mass is a full matrix: half a megabyte

ROWS = {
    "force": "one entry per coordinate",
    "mass_matrix": "(coordinates, coordinates)",
    "constraint_jacobian": "(constraints, coordinates); row i is the derivative of constraint i",
    "velocity_constraint_jacobian": "(velocity constraints, coordinates); row i is the derivative of constraint i by v",
}


def wrong_shape(function: str, expected: tuple[int, ...] | str, given: Any) -> ProblemError:
    """The error for a result of the wrong shape."""
    hint = f" = {ROWS[function]}" if function in ROWS else ""
    return ProblemError(f"{function} must return shape {expected}{hint}; got {given}. Nothing is broadcast.")


def abstract_result(system: System, function: str, *arguments: Any) -> jax.ShapeDtypeStruct:
    """Shape and type that a declared JAX function returns, found without running it.

    Raises
    ------
    TypeError
        It returns something that is not one real array.
    """
    try:
        with preparing(f"tracing {function}"):
            result = jax.eval_shape(getattr(system, function), *arguments)
    except TypeError as error:
        if "not a valid JAX type" in str(error):
            raise TypeError(f"{function} must return a real array; {error}") from error
        raise
    if not hasattr(result, "shape"):
        raise TypeError(f"{function} must return one real array; got {type(result).__name__}.")
    if result.dtype.kind not in "fiu":
        raise TypeError(f"{function} must return real numbers; got dtype {result.dtype}.")
    return result


def expect_shape(system: System, function: str, expected: tuple[int, ...], *arguments: Any) -> None:
    """Raise unless the declared JAX function returns ``expected``."""
    given = abstract_result(system, function, *arguments).shape
    if given != expected:
        raise wrong_shape(function, expected, given)


def expect_pair(function: str, value: Any, shapes: tuple[tuple[int, ...], ...]) -> Any:
    """``value``, raising unless it is a pair."""
    if not isinstance(value, (tuple, list)) or len(value) != 2:
        raise TypeError(f"{function} must return two matrices of shapes {shapes}; got {type(value).__name__}.")
    return value


def checked_pair(function: str, value: Any, shapes: tuple[tuple[int, ...], ...], t: float) -> tuple[np.ndarray | None, ...]:
    """A callback's two matrices, each checked; None stands for zero."""
    return tuple(
        None if part is None else checked_result(f"{function}[{i}]", part, shape, t)
        for i, (part, shape) in enumerate(zip(expect_pair(function, value, shapes), shapes, strict=True))
    )


def checked_result(function: str, value: Any, expected: tuple[int, ...], t: float) -> np.ndarray:
    """A callback's result as float64, itself where it is an array of them; refused when its type, shape or values are wrong.

    A scalar of the system counts as no array: ``(1,)`` is wanted where n = 1.
    """
    if type(value) is np.ndarray and value.dtype is FLOAT:
        array = value
    else:
        try:
            array = real_values(f"{function} result", value)
        except TypeError as error:
            raise TypeError(f"{function} must return an array of real numbers of shape {expected}: {error}") from error
    if array.shape != expected:
        raise wrong_shape(function, expected, array.shape)
    if array.size <= FEW and math.isfinite(sum(array.ravel().tolist())):  # a fifth of the time of NumPy's own look
        return array
    if not np.isfinite(array).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise NonFiniteValue(function, where, float(array[where]), t)
    return array


def mass_as_matrix(mass: Any, n: int, xp: Any = jnp) -> Any:
    """A declared constant mass (scalar, ``(n,)`` or ``(n, n)``) as a matrix ``(n, n)``, a large diagonal as such."""
    mass = xp.asarray(mass)
    if n > FULL_MASS and mass.shape in ((), (n,)):
        return Diagonal(xp.broadcast_to(mass, (n,)))
    if mass.ndim == 0:
        return mass * xp.eye(n)
    if mass.shape == (n,):
        return xp.diag(mass)
    if mass.shape == (n, n):
        return mass
    raise wrong_shape("mass_matrix", (n, n), mass.shape)
