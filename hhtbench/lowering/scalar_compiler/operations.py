"""The operations of the scalar graph: how each is folded, and how it is written in LLVM's language.

Values as JAX's: a maximum with NaN is NaN, comparisons with NaN are false but for ``ne``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from scipy import special

LIBM = (  # one argument, by the C library; NumPy has the same names
    *("acos", "acosh", "asin", "asinh", "atan", "atanh", "cbrt", "cosh"),
    *("expm1", "log1p", "sinh", "tan", "tanh"),
)
INTRINSICS = {  # one argument, by LLVM's own names: inlined, or the C library's where it has the better code
    "abs": "fabs",
    "round_away": "round",
    "round_even": "roundeven",
    **{name: name for name in ("ceil", "cos", "exp", "exp2", "floor", "log", "sin", "sqrt", "trunc")},
}
COMPARISONS = {"eq": "oeq", "ne": "une", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge"}
ARITHMETIC = {"add": "fadd", "sub": "fsub", "mul": "fmul", "div": "fdiv", "rem": "frem"}
LOGIC = ("and", "or", "xor", "not")
COMMUTATIVE = ("eq", "ne", "max", "min")

INSTRUCTIONS = {  # in LLVM's language, of operands in order
    **{name: f"{instruction} double {{}}, {{}}" for name, instruction in ARITHMETIC.items()},
    **{name: f"fcmp {predicate} double {{}}, {{}}" for name, predicate in COMPARISONS.items()},
    **{name: f"{name} i1 {{}}, {{}}" for name in ("and", "or", "xor")},
    "neg": "fneg double {}",
    "not": "xor i1 {}, true",
    "select": "select i1 {}, double {}, double {}",
    "select_bool": "select i1 {}, i1 {}, i1 {}",
}
FUNCTIONS = {  # that are called, of numbers
    **{name: name for name in (*LIBM, "atan2", "erf", "erfc", "pow")},
    **{name: f"llvm.{intrinsic}.f64" for name, intrinsic in (INTRINSICS | {"max": "maximum", "min": "minimum"}).items()},
}


def _power(x: Any, y: Any) -> Any:
    """The C library's: NumPy takes a root for the exponent 1/2, which differs at minus infinity."""
    try:
        return np.float64(math.pow(x, y))
    except (ValueError, OverflowError):
        return np.power(x, y)


OTHER_NAMES = (  # NumPy's, where they are not JAX's
    *(("div", "divide"), ("eq", "equal"), ("ge", "greater_equal"), ("gt", "greater"), ("le", "less_equal"), ("lt", "less")),
    *(("max", "maximum"), ("min", "minimum"), ("mul", "multiply"), ("ne", "not_equal"), ("neg", "negative")),
    *(("rem", "fmod"), ("round_even", "rint"), ("sub", "subtract")),
)
SAME_NAMES = {*LIBM, *INTRINSICS, *ARITHMETIC, "atan2", "sign", "square"}.difference(dict(OTHER_NAMES), ["round_away"])
ELEMENTWISE: dict[str, Callable[..., Any]] = {  # of arrays
    **{name: getattr(np, name) for name in SAME_NAMES},
    **{name: getattr(np, other) for name, other in OTHER_NAMES},
    **{name: getattr(special, name) for name in ("erf", "erfc")},
    "clamp": lambda low, x, high: np.minimum(np.maximum(x, low), high),
    "round_away": lambda x: np.trunc(x + np.copysign(np.nextafter(0.5, 0.0), x)),
}


def _fold(function: Callable[..., Any], *values: float) -> Any:
    with np.errstate(all="ignore"):
        return function(*map(np.float64, values)).item()


FOLDS = {name: partial(_fold, function) for name, function in (ELEMENTWISE | {"pow": _power}).items()}
