"""A function of a JAX system compiled to machine code or by XLA, for each shape of its arguments."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.lowering.compile.routes import MAX_COMPILED, TRACED_AS_VALUE, Route, explain_control_flow, too_large
from hhtbench.lowering.flattening import flat_function, jitted
from hhtbench.lowering.scalar_compiler import NotNative, native, native_call
from hhtbench.lowering.scalar_compiler.lower import Shapes
from hhtbench.runtime.disk_cache import use_disk_cache
from hhtbench.solution.counting import preparing

SMALL = "the system is small and every operation is known"


def _nothing(*_: Any) -> None:
    return None


class Compiled:
    """A function of one JAX dynamics, compiled on demand for each shape of its arguments."""

    def __init__(self, function: Callable[..., Any], dynamics: Any, static: tuple[Any, ...], route: str | None) -> None:
        self.dynamics = dynamics
        self.routes: dict[Shapes, Route] = {}  #: routes taken so far, by the shapes of the arguments
        self._native, self._route = partial(native, function, dynamics, *static), route
        self._flat = flat_function(function, dynamics, *static)
        self._calls: dict[Shapes, Callable[..., np.ndarray | None]] = {}  #: machine code; one that returns None: use XLA
        self._last: Callable[..., np.ndarray | None] = _nothing  #: machine code that was called last
        self._xla: Callable[..., np.ndarray] | None = None
        self._xla_shapes: set[Shapes] = set()  #: shapes of arguments it was compiled for

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
        """Machine code where it pays and is possible, else a function that returns None for XLA; records the route."""
        name, reason = self._flat.name, too_large(self.dynamics, MAX_COMPILED)
        if reason is None:
            try:
                code = self._native(shapes=shapes)
            except NotNative as error:
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
    """Arguments as float64 arrays; None if that would change their meaning (complex) or is impossible (traced)."""
    if any(isinstance(argument, jax.core.Tracer) for argument in arguments):
        return None
    arrays = [np.asarray(argument) for argument in arguments]
    if any(array.dtype.kind not in "fiub" for array in arrays):
        return None
    return [array.astype(np.float64, copy=False) for array in arrays]
