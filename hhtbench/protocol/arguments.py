"""Check and convert arguments: private float64 arrays, or an error that says what was expected."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from jax.errors import TracerArrayConversionError
from numpy.typing import NDArray

from hhtbench.protocol.errors import ProblemError

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
LARGEST_INTEGER = 2**63 - 1  # range of the compiled loops' counters
FLOAT = np.dtype(np.float64)
MAX_SUMMED = 36  # entries of an array whose finiteness is checked by a Python sum, five times faster
LONGEST_SHOWN = 60  # characters of a value in a message


def real_array(name: str, value: Any) -> NDArray[np.float64]:
    """Return a private, read-only float64 copy of ``value``.

    Raises
    ------
    TypeError
        ``value`` is None, a string, complex, masked, ragged or of object type.
    ProblemError
        An entry is NaN or infinite.
    """
    array = real_values(name, value)
    if not all_finite(array):
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise ProblemError(f"{name} must be finite; entry {list(where)} is {array[where]}.")
    array.setflags(write=False)
    return array


def real_values(name: str, value: Any) -> NDArray[np.float64]:
    """Return a private float64 copy of ``value`` without a check for NaN and infinity (for results of callbacks, say)."""
    if type(value) is np.ndarray and value.dtype is FLOAT:
        return value.copy()
    expected = f"{name} must be real numbers"
    if value is None:
        raise TypeError(f"{expected}; got None.")
    if isinstance(value, np.ma.MaskedArray):
        raise TypeError(f"{expected}; got a masked array. Fill the masked entries first.")
    try:
        array = np.array(value, order="C")
    except TracerArrayConversionError:
        raise traced(name) from None
    except ValueError as error:
        raise TypeError(f"{expected}; got a ragged sequence ({error}).") from error
    if isinstance(value, str):
        raise TypeError(f"{expected}; got the text {shown(value)}. Write numbers without quotes.")
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{expected}; got dtype {array.dtype} ({type(value).__name__}).")
    return array.astype(np.float64, copy=False)


def all_finite(array: NDArray[np.float64]) -> bool:
    """True if no entry of ``array`` is NaN or infinite."""
    if array.size <= MAX_SUMMED:
        entries = array if array.ndim == 1 else array.ravel()
        if math.isfinite(sum(entries.tolist())):
            return True
    return bool(np.isfinite(array).all())


def real_vector(name: str, value: Any, size: int | None = None) -> Vector:
    """Return a private, read-only vector ``(size,)``; scalars, columns and rows are refused, never broadcast."""
    array = real_array(name, value)
    if array.ndim != 1 or (size is not None and array.shape != (size,)):
        wanted = f"({size},)" if size is not None else "(n,), one dimension"
        raise ProblemError(f"{name} must have shape {wanted}; got {array.shape}.")
    return array


def real_number(name: str, value: Any, *, unit: str = "") -> float:
    """Return ``value`` as a finite float; booleans, strings and arrays (also of one entry) are refused."""
    if type(value) is float and math.isfinite(value):
        return value
    if isinstance(value, (bool, str)) or value is None:
        raise TypeError(f"{name} must be a real number{unit}; got {value!r}.")
    try:
        array = np.asarray(float(value) if isinstance(value, int) else value)
    except TracerArrayConversionError:
        raise traced(name) from None
    except OverflowError:
        raise ProblemError(f"{name} must be a number that a float holds{unit}; got {shown(value)}.") from None
    if array.dtype.kind not in "fiu" or array.ndim != 0:
        raise TypeError(f"{name} must be a real number{unit}; got {value!r}.")
    number = float(array)
    if not np.isfinite(number):
        raise ProblemError(f"{name} must be finite{unit}; got {number}.")
    return number


def positive_integer(name: str, value: Any) -> int:
    """Return ``value`` as an integer from 1 to 2**63 - 1, the range of the compiled loops' counters."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)):
        raise TypeError(f"{name} must be a whole number of at least 1; got {value!r}.")
    if not 1 <= value <= LARGEST_INTEGER:
        bound = "at least 1" if value < 1 else "at most 2**63 - 1"
        raise ProblemError(f"{name} must be {bound}; got {shown(value)}.")
    return int(value)


def check_interval(name: str, t0: float, t1: float) -> None:
    """Raise unless the interval's length ``t1 - t0`` [s] is a finite float."""
    if not math.isfinite(t1 - t0):
        raise ProblemError(f"{name} from {t0:g} to {t1:g} s is longer than a float holds; take a shorter interval.")


def shown(value: Any) -> str:
    """Return ``repr(value)`` for a message, cut to ``LONGEST_SHOWN`` characters."""
    try:
        text = repr(value)
    except ValueError:  # Python writes no whole number of more than some thousand digits
        return f"a number of {value.bit_length()} bits"
    return text if len(text) <= LONGEST_SHOWN else f"{text[:LONGEST_SHOWN]}..."


def traced(name: str) -> TypeError:
    """Return the TypeError for a value that is traced by ``jax.grad``, ``jax.jit`` or ``jax.vmap``."""
    return TypeError(
        f"{name} is traced by JAX (grad, jit or vmap), and hhtbench integrates numbers: solve is not differentiable yet. "
        "Call it outside with concrete values; for a derivative take differences of solves that take the same steps "
        "(steps=solution, an earlier one)."
    )
