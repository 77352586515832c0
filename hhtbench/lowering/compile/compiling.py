"""``compile_function``: the one place that compiles.  Which route a function takes is decided at its first call.

*native*: straight-line machine code, for small JAX systems; *xla*: ``jax.jit``, for large ones and for what the native route
does not know; *numpy*: plain Python calls, for NumPy systems.  Same values to roundoff.  Compiled code is shared by all
systems of one class, sizes and static options, whatever their parameter values, and kept on disk between processes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.counting import preparing
from hhtbench.errors import ProblemError
from hhtbench.lowering.caching import ById, Cache, use_disk_cache
from hhtbench.lowering.compile.control_flow import TRACED_AS_VALUE, explain_control_flow
from hhtbench.lowering.compile.routes import Compilable, Route, route_of, too_large, wanted_route
from hhtbench.lowering.flattening import flat_function, jitted
from hhtbench.lowering.scalar_compiler import NotNative, native, native_call
from hhtbench.lowering.scalar_compiler.lower import Shapes

SMALL = "the system is small and every operation is known"


def compile_function(
    function: Callable[..., Any], dynamics: Compilable, *static: Any, route: str | None = None
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
    wanted = wanted_route(route)
    if route_of(dynamics) == "numpy":
        return partial(function, dynamics, *static)
    key = (function, ById(dynamics), static, wanted)
    compiled: _Callable = _callables.find(key, lambda: _callable(function, dynamics, static, wanted))
    return compiled.call


def routes(dynamics: Compilable) -> tuple[Route, ...]:
    """Of every function of ``dynamics`` that has been called so far: its route and why."""
    if route_of(dynamics) == "numpy":
        return (Route("every function", "numpy", "the functions are plain callables on NumPy arrays"),)
    return tuple(route for made in _callables.values() if made.dynamics is dynamics for route in made.routes.values())


class _Callable(NamedTuple):
    dynamics: Compilable
    routes: dict[Shapes, Route]  #: taken so far, by the shapes of the arguments
    call: Callable[..., np.ndarray]


_callables = Cache(512)  # finding a function's code again takes as long as a hundred calls of it


def _callable(function: Callable[..., Any], dynamics: Compilable, static: tuple[Any, ...], route: str) -> _Callable:
    compiled = _Compiled(function, dynamics, static, route)

    def call(*arguments: Any) -> np.ndarray:
        value = compiled.last(*arguments)
        return compiled.any(*arguments) if value is None else value

    return _Callable(dynamics, compiled.routes, call)


def _nothing(*_: Any) -> None:
    return None


class _Compiled:
    """A function of one JAX dynamics, compiled for argument shapes as they come."""

    def __init__(self, function: Callable[..., Any], dynamics: Compilable, static: tuple[Any, ...], route: str) -> None:
        self._function, self._dynamics, self._static, self._route = function, dynamics, static, route
        self._flat = flat_function(function, dynamics, *static)
        self._calls: dict[Shapes, Callable[..., np.ndarray | None]] = {}  #: machine code; of None, XLA is asked
        self.last: Callable[..., np.ndarray | None] = _nothing  #: machine code that was called last
        self._xla: Callable[..., np.ndarray] | None = None
        self._xla_shapes: set[Shapes] = set()  #: of arguments it was compiled for
        self.routes: dict[Shapes, Route] = {}

    def any(self, *arguments: Any) -> np.ndarray:
        """The value at ``arguments`` of any shapes and types."""
        try:
            return self._routed(*arguments)
        except TRACED_AS_VALUE as error:
            raise explain_control_flow(error, getattr(self._dynamics, "system", self._dynamics)) from error

    def _routed(self, *arguments: Any) -> np.ndarray:
        arrays = None if self._route == "xla" else _as_floats(arguments)
        if arrays is None:
            return self._by_xla(*arguments)
        shapes = tuple(array.shape for array in arrays)
        if shapes not in self._calls:
            self._calls[shapes] = self._choose(shapes)
        value = self._calls[shapes](*arrays)
        if value is None:
            return self._by_xla(*arguments)
        self.last = self._calls[shapes]
        return value

    def _choose(self, shapes: Shapes) -> Callable[..., np.ndarray | None]:
        """Machine code where that pays and is known how, else nothing for XLA; the reason is recorded."""
        reason = too_large(self._dynamics) if self._route == "auto" else None
        if reason is None:
            try:
                code = native(self._function, self._dynamics, *self._static, shapes=shapes)
            except NotNative as error:
                if self._route == "native":
                    raise ProblemError(f"{_name(self._function)} cannot take the native route: {error.reason}.") from None
                reason = error.reason
            else:
                self.routes[shapes] = Route(_name(self._function), "native", SMALL, code.operations)
                return native_call(code, shapes)
        self.routes[shapes] = Route(_name(self._function), "xla", reason)
        return _nothing

    def _by_xla(self, *arguments: Any) -> np.ndarray:
        if self._xla is None:
            if self._route == "xla":
                self.routes[()] = Route(_name(self._function), "xla", "it was asked for")
            use_disk_cache()
            parameters, compiled = jnp.asarray(self._flat.parameters), jitted(self._flat)
            self._xla = lambda *given: np.asarray(compiled(parameters, *map(_strong, given)))
        shapes = tuple(np.shape(argument) for argument in arguments)
        if shapes in self._xla_shapes:
            return self._xla(*arguments)
        with preparing(f"compiling {_name(self._function)} by XLA"):
            value = self._xla(*arguments)
        self._xla_shapes.add(shapes)
        return value


def _name(function: Callable[..., Any]) -> str:
    return getattr(function, "__name__", type(function).__name__)


def _strong(argument: Any) -> Any:
    """A Python number as float64: of a weak type it would be traced again."""
    return np.float64(argument) if type(argument) is float else argument


def _as_floats(arguments: tuple[Any, ...]) -> list[np.ndarray] | None:
    """The arguments as float64 arrays, or None where that would change their meaning (complex) or is impossible (traced)."""
    if any(isinstance(argument, jax.core.Tracer) for argument in arguments):
        return None
    arrays = [np.asarray(argument) for argument in arguments]
    if any(array.dtype.kind not in "fiub" for array in arrays):
        return None
    return [array.astype(np.float64, copy=False) for array in arrays]
