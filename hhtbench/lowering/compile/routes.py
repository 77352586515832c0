"""Routes by which functions are computed (machine code, XLA or plain Python), with reasons."""

from __future__ import annotations

import sysconfig
import traceback
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import numpy as np

from hhtbench.protocol.errors import ProblemError

MAX_UNKNOWNS = 80  # n + m + p: above it sparse matrices are faster where a function is called often
MAX_COMPILED = 200  # n + m + p: above it XLA compiles full matrices faster


TRACED_AS_VALUE = (
    jax.errors.ConcretizationTypeError,  # if, while, and, or, float()
    jax.errors.TracerArrayConversionError,  # a NumPy function
    jax.errors.TracerIntegerConversionError,  # range(), an index of a list
    jax.errors.NonConcreteBooleanIndexError,  # q[q > 0]
)


_LIBRARIES = tuple(sorted({str(Path(sysconfig.get_paths()[key]).resolve()) for key in ("stdlib", "purelib", "platlib")}))


_NOT_THE_USERS = "<", *_LIBRARIES, str(Path(__file__).resolve().parents[2])


@dataclass(frozen=True)
class Route:
    """How one function is computed."""

    function: str
    route: str  #: "native", "xla" or "numpy"
    reason: str
    operations: int | None = None  #: number of scalar operations on the native route


def route_of(dynamics: Any) -> str:
    """ "numpy" for a dynamics of plain callables, "xla" for one that JAX can trace (compiled by XLA or to machine code)."""
    return "numpy" if dynamics.xp is np else "xla"


def too_large(dynamics: Any, most: int = MAX_UNKNOWNS) -> str | None:
    """Reason why machine code would not pay for a system of more than ``most`` unknowns, or None."""
    s = dynamics.structure
    unknowns = s.n + s.m + s.p
    if unknowns <= most or not dynamics.matrices:
        return None
    return f"n + m + p = {unknowns} is more than {most}: machine code would be long"


def explain_control_flow(error: Exception, system: Any) -> ProblemError:
    """Error for a function of ``system`` whose Python code needs the value of something that JAX traces."""
    return ProblemError(
        f"{type(system).__name__}: {_line(error)} needs a value before there is one: its functions are traced by JAX once "
        "and then serve all t, q, v and parameters, so plain Python (if, while, float(), a function of numpy) cannot use "
        "those.  Write the choice as jnp.where(condition, a, b) or jax.lax.cond, use jax.numpy instead of numpy, put "
        "entries together by jnp.stack([...]) or f = f.at[0].set(x) instead of f[0] = x, make a "
        "parameter that selects a formula a static field (eqx.field(static=True)), or give the functions as they are to a "
        "NumpySystem."
    )


def _line(error: Exception) -> str:
    """``file, line n, in f: source`` of the innermost line in the user's code."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = frame.filename if frame.filename.startswith("<") else str(Path(frame.filename).resolve())
        if not file.startswith(_NOT_THE_USERS):
            return f"{frame.filename}, line {frame.lineno}, in {frame.name}: `{frame.line}`"
    return "one of its functions"
