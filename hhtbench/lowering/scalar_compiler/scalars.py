"""The operations of the scalar graph: how each is folded, and how it is written in LLVM's language.

Values as JAX's: a maximum with NaN is NaN, comparisons with NaN are false but for ``ne``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import special


def _folded(function: Callable[..., Any]) -> Callable[..., Any]:
    def fold(*values: float) -> Any:
        with np.errstate(all="ignore"):
            return function(*(np.float64(value) for value in values)).item()

    return fold


LIBM = (  # one argument, by the C library
    *("acos", "acosh", "asin", "asinh", "atan", "atanh", "cbrt", "cosh"),
    *("erf", "erfc", "expm1", "log1p", "sinh", "tan", "tanh"),
)
INTRINSICS = {  # one argument, by LLVM's own names: inlined, or the C library's where it has the better code
    "abs": "fabs",
    "ceil": "ceil",
    "cos": "cos",
    "exp": "exp",
    "exp2": "exp2",
    "floor": "floor",
    "log": "log",
    "round_away": "round",
    "round_even": "roundeven",
    "sin": "sin",
    "sqrt": "sqrt",
    "trunc": "trunc",
}
COMPARISONS = {"eq": "oeq", "ne": "une", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge"}
ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "rem": "frem"}
LOGIC = ("and", "or", "xor", "not")
COMMUTATIVE = ("eq", "ne")


def _power(x: Any, y: Any) -> Any:
    """The C library's: NumPy takes a root for the exponent 1/2, which differs at minus infinity."""
    try:
        return np.float64(math.pow(x, y))
    except (ValueError, OverflowError):
        return np.power(x, y)


ELEMENTWISE: dict[str, Callable[..., Any]] = {  # of arrays
    "abs": np.abs,
    "acos": np.arccos,
    "acosh": np.arccosh,
    "add": np.add,
    "asin": np.arcsin,
    "asinh": np.arcsinh,
    "atan": np.arctan,
    "atan2": np.arctan2,
    "atanh": np.arctanh,
    "cbrt": np.cbrt,
    "ceil": np.ceil,
    "cos": np.cos,
    "cosh": np.cosh,
    "div": np.divide,
    "erf": special.erf,
    "erfc": special.erfc,
    "exp": np.exp,
    "exp2": np.exp2,
    "expm1": np.expm1,
    "floor": np.floor,
    "log": np.log,
    "log1p": np.log1p,
    "max": np.maximum,
    "min": np.minimum,
    "mul": np.multiply,
    "neg": np.negative,
    "rem": np.fmod,
    "round_away": lambda x: np.trunc(x + np.copysign(np.nextafter(0.5, 0.0), x)),
    "round_even": np.rint,
    "sign": np.sign,
    "sin": np.sin,
    "sinh": np.sinh,
    "sqrt": np.sqrt,
    "square": np.square,
    "sub": np.subtract,
    "tan": np.tan,
    "tanh": np.tanh,
    "trunc": np.trunc,
    "eq": np.equal,
    "ne": np.not_equal,
    "lt": np.less,
    "le": np.less_equal,
    "gt": np.greater,
    "ge": np.greater_equal,
}
FOLDS = {name: _folded(function) for name, function in (ELEMENTWISE | {"pow": _power}).items()}
