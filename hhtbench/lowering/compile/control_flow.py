"""Python control flow on values that JAX traces: explained with the user's line and the ways out."""

from __future__ import annotations

import sysconfig
import traceback
from pathlib import Path
from typing import Any

import jax

from hhtbench.errors import ProblemError

TRACED_AS_VALUE = (
    jax.errors.ConcretizationTypeError,  # if, while, and, or, float()
    jax.errors.TracerArrayConversionError,  # a NumPy function
    jax.errors.TracerIntegerConversionError,  # range(), an index of a list
    jax.errors.NonConcreteBooleanIndexError,  # q[q > 0]
)
_LIBRARIES = tuple(sorted({str(Path(sysconfig.get_paths()[key]).resolve()) for key in ("stdlib", "purelib", "platlib")}))
_NOT_THE_USERS = "<", *_LIBRARIES, str(Path(__file__).resolve().parents[2])


def explain_control_flow(error: Exception, system: Any) -> ProblemError:
    """The error for a function of ``system`` whose Python code needs the value of something JAX traces."""
    return ProblemError(
        f"{type(system).__name__}: {_line(error)} needs a value before there is one: its functions are traced by JAX once "
        "and then serve all t, q, v and parameters, so plain Python (if, while, float(), a function of numpy) cannot look "
        "at those.  Write the choice as jnp.where(condition, a, b) or jax.lax.cond, use jax.numpy instead of numpy, make a "
        "parameter that selects a formula a static field (eqx.field(static=True)), or give the functions as they are to a "
        "NumpySystem."
    )


def _line(error: Exception) -> str:
    """``file, line n, in f: source`` of the innermost line that is the user's."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        file = frame.filename if frame.filename.startswith("<") else str(Path(frame.filename).resolve())
        if not file.startswith(_NOT_THE_USERS):
            return f"{frame.filename}, line {frame.lineno}, in {frame.name}: `{frame.line}`"
    return "one of its functions"
