"""``compile_function``: the one place that compiles.  Which route a function takes is decided at its first call.

*native*: straight-line machine code, for small JAX systems; *xla*: ``jax.jit``, for large ones and for what the native route
does not know; *numpy*: plain Python calls, for NumPy systems.  Same values to roundoff.  Compiled code is shared by all
systems of one class, sizes and static options, whatever their parameter values, and kept on disk between processes.
"""

from __future__ import annotations

import sysconfig
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from hhtbench.lowering.caching import Cache, by_id
from hhtbench.protocol.errors import ProblemError

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.dynamics import Dynamics

MOST_UNKNOWNS = 80  # n + m + p: above it XLA compiles sooner, and sparse matrices take over anyway
TRACED_AS_VALUE = (
    jax.errors.ConcretizationTypeError,  # if, while, and, or, float()
    jax.errors.TracerArrayConversionError,  # a NumPy function
    jax.errors.TracerIntegerConversionError,  # range(), an index of a list
    jax.errors.NonConcreteBooleanIndexError,  # q[q > 0]
)
_LIBRARIES = tuple(sorted({str(Path(sysconfig.get_paths()[key]).resolve()) for key in ("stdlib", "purelib", "platlib")}))
_NOT_THE_USERS = "<", *_LIBRARIES, str(Path(__file__).resolve().parents[2])

_callables = Cache(512)  # finding a function's code again takes as long as a hundred calls of it


@dataclass(frozen=True)
class Route:
    """How one function is computed."""

    function: str
    route: str  #: "native", "xla" or "numpy"
    reason: str
    operations: int | None = None  #: scalar operations, of the native route


def route_of(dynamics: Dynamics) -> str:
    """What ``dynamics`` is made of: "numpy" for plain callables, "xla" for what JAX can trace, compiled by either route."""
    return "numpy" if dynamics.xp is np else "xla"


def too_large(dynamics: Dynamics) -> str | None:
    """Why the native route would not pay for a system of this size, or None."""
    s = dynamics.structure
    unknowns = s.n + s.m + s.p
    if unknowns <= MOST_UNKNOWNS or not dynamics.matrices:
        return None
    return f"n + m + p = {unknowns} is more than {MOST_UNKNOWNS}: machine code would be long"


def compile_function(
    function: Callable[..., Any], dynamics: Dynamics, *static: Any, route: str | None = None
) -> Callable[..., np.ndarray]:
    """``function(dynamics, *static, *arrays) -> array`` as a fast callable of the arrays alone.

    Parameters
    ----------
    function
        A module-level function, pure and backend-neutral; it returns one array (pack several into one: every
        array that crosses from XLA to NumPy costs about a microsecond).
    static
        Hashable options; a new value compiles anew.
    route
        "xla" for no machine code of a JAX dynamics.

    Raises
    ------
    ProblemError
        At a call: Python control flow looks at a value that JAX traces; the text says where.
    """
    if route_of(dynamics) == "numpy":
        return partial(function, dynamics, *static)
    from hhtbench.lowering.compile.compiled import Compiled  # plain callables do without the compilers

    key = (function, by_id(dynamics), static, route)
    compiled: Compiled = _callables.find(key, lambda: Compiled(function, dynamics, static, route))
    return compiled.call


def routes(dynamics: Dynamics) -> tuple[Route, ...]:
    """Of every function of ``dynamics`` that has been called so far: its route and why."""
    if route_of(dynamics) == "numpy":
        return (Route("every function", "numpy", "the functions are plain callables on NumPy arrays"),)
    return tuple(route for made in _callables.values() if made.dynamics is dynamics for route in made.routes.values())


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
