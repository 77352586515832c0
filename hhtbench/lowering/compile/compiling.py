"""``compile_function``: the one place that compiles.  Which route a function takes is decided at its first call.

*native*: straight-line machine code, for small JAX systems; *xla*: ``jax.jit``, for large ones and for what the native route
does not know; *numpy*: plain Python calls, for NumPy systems.  Same values to roundoff.  Compiled code is shared by all
systems of one class, sizes and static options, whatever their parameter values, and kept on disk between processes.
"""

from __future__ import annotations

import os
import sysconfig
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.counting import preparing
from hhtbench.errors import ProblemError
from hhtbench.lowering.caching import Cache, by_id, use_disk_cache
from hhtbench.lowering.flattening import flat_function, jitted
from hhtbench.lowering.scalar_compiler import NotNative, native, native_call
from hhtbench.lowering.scalar_compiler.lower import Shapes

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.dynamics import Dynamics

ROUTES = ("auto", "native", "xla")
VARIABLE = "HHTBENCH_ROUTE"  #: of the environment: the route where none is asked for
MOST_UNKNOWNS = 80  # n + m + p: above it XLA compiles sooner, and sparse matrices take over anyway
SMALL = "the system is small and every operation is known"
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
        "auto" (default; the environment's ``HHTBENCH_ROUTE`` changes it), "native" or "xla", of a JAX dynamics.

    Raises
    ------
    ProblemError
        There is no such route; or, at a call, "native" was asked for and does not know how, or Python control flow looks
        at a value that JAX traces: the text says why.
    """
    source, wanted = (VARIABLE, os.environ.get(VARIABLE) or "auto") if route is None else ("route", route)
    if wanted not in ROUTES:
        raise ProblemError(f"{source} must be one of {', '.join(ROUTES)}; got {wanted!r}.")
    if route_of(dynamics) == "numpy":
        return partial(function, dynamics, *static)
    key = (function, by_id(dynamics), static, wanted)
    compiled: _Compiled = _callables.find(key, lambda: _Compiled(function, dynamics, static, wanted))
    return compiled.call


def routes(dynamics: Dynamics) -> tuple[Route, ...]:
    """Of every function of ``dynamics`` that has been called so far: its route and why."""
    if route_of(dynamics) == "numpy":
        return (Route("every function", "numpy", "the functions are plain callables on NumPy arrays"),)
    return tuple(route for made in _callables.values() if made.dynamics is dynamics for route in made.routes.values())


def _nothing(*_: Any) -> None:
    return None


class _Compiled:
    """A function of one JAX dynamics, compiled for argument shapes as they come."""

    def __init__(self, function: Callable[..., Any], dynamics: Dynamics, static: tuple[Any, ...], route: str) -> None:
        self.dynamics = dynamics
        self.routes: dict[Shapes, Route] = {}  #: taken so far, by the shapes of the arguments
        self._native, self._route = partial(native, function, dynamics, *static), route
        self._flat = flat_function(function, dynamics, *static)
        self._calls: dict[Shapes, Callable[..., np.ndarray | None]] = {}  #: machine code; of None, XLA is asked
        self._last: Callable[..., np.ndarray | None] = _nothing  #: machine code that was called last
        self._xla: Callable[..., np.ndarray] | None = None
        self._xla_shapes: set[Shapes] = set()  #: of arguments it was compiled for

        def call(*arguments: Any) -> np.ndarray:  # a closure: a method costs a tenth of a microsecond more
            value = self._last(*arguments)
            return self._any(*arguments) if value is None else value

        self.call = call

    def _any(self, *arguments: Any) -> np.ndarray:
        """The value at ``arguments`` of any shapes and types."""
        try:
            value, arrays = None, None if self._route == "xla" else _as_floats(arguments)
            if arrays is not None:
                shapes = tuple(array.shape for array in arrays)
                if shapes not in self._calls:
                    self._calls[shapes] = self._choose(shapes)
                call = self._last = self._calls[shapes]  # another thread may set it for other shapes
                value = call(*arrays)
            return self._by_xla(*arguments) if value is None else value
        except TRACED_AS_VALUE as error:
            raise explain_control_flow(error, getattr(self.dynamics, "system", self.dynamics)) from error

    def _choose(self, shapes: Shapes) -> Callable[..., np.ndarray | None]:
        """Machine code where that pays and is known how, else nothing for XLA; the reason is recorded."""
        name, reason = self._flat.name, too_large(self.dynamics) if self._route == "auto" else None
        if reason is None:
            try:
                code = self._native(shapes=shapes)
            except NotNative as error:
                if self._route == "native":
                    raise ProblemError(f"{name} cannot take the native route: {error.reason}.") from None
                reason = error.reason
            else:
                self.routes[shapes] = Route(name, "native", SMALL, code.operations)
                return native_call(code, shapes)
        self.routes[shapes] = Route(name, "xla", reason)
        return _nothing

    def _by_xla(self, *arguments: Any) -> np.ndarray:
        if self._xla is None:
            if self._route == "xla":
                self.routes[()] = Route(self._flat.name, "xla", "it was asked for")
            use_disk_cache()
            parameters, compiled = jnp.asarray(self._flat.parameters), jitted(self._flat)
            self._xla = lambda *given: np.asarray(  # a Python number is of a weak type, and would be traced again
                compiled(parameters, *(np.float64(x) if type(x) is float else x for x in given))
            )
        shapes = tuple(np.shape(argument) for argument in arguments)
        if shapes in self._xla_shapes:
            return self._xla(*arguments)
        with preparing(f"compiling {self._flat.name} by XLA"):
            value = self._xla(*arguments)
        self._xla_shapes.add(shapes)
        return value


def _as_floats(arguments: tuple[Any, ...]) -> list[np.ndarray] | None:
    """The arguments as float64 arrays, or None where that would change their meaning (complex) or is impossible (traced)."""
    if any(isinstance(argument, jax.core.Tracer) for argument in arguments):
        return None
    arrays = [np.asarray(argument) for argument in arguments]
    if any(array.dtype.kind not in "fiub" for array in arrays):
        return None
    return [array.astype(np.float64, copy=False) for array in arrays]


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
