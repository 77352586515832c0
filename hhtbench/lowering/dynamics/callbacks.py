"""Python functions that machine code calls by address.

Machine code fills the result with NaN before the call, and the callback writes it last: after an exception it is NaN.
"""

from __future__ import annotations

import ctypes
import math
import signal
import threading
from collections.abc import Callable
from itertools import accumulate
from types import TracebackType
from typing import Any

import numpy as np

from hhtbench.lowering import cpython_internals
from hhtbench.protocol.errors import NonFiniteValue

Shape = tuple[int, ...]
SIGINT = int(signal.SIGINT)
MAX_KNOWN = 64  # argument addresses whose arrays are cached per function; addresses on the stack vary


class Callbacks:
    """Python functions that machine code calls by address, and the exceptions raised in them.

    All are equal, since code does not depend on them.  Use ``with callbacks:`` around machine code that calls them: in the
    main thread an interrupt is then noted instead of raised inside a callback, where it would be lost.
    """

    def __init__(self, system: Any = None) -> None:
        self.system = system
        self.cause: BaseException | None = None  #: exception raised; nothing is computed after it
        self.check: Callable[[], None] = lambda: None  #: called before each function; raises when no time is left
        self.nonfinite: list[NonFiniteValue] = []  #: values that were not finite; the loops go on with NaN
        self._kept: list[Any] = []
        self._before: Any = None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Callbacks)

    def __hash__(self) -> int:
        return 0

    def __enter__(self) -> None:
        if self._before is not None or threading.current_thread() is not threading.main_thread():
            return
        handler = cpython_internals.getsignal(SIGINT)
        if handler is signal.default_int_handler or isinstance(getattr(handler, "__self__", None), Callbacks):
            self._before = cpython_internals.signal(SIGINT, self._interrupted)

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._before is not None:
            cpython_internals.signal(SIGINT, self._before)
            self._before = None

    def _interrupted(self, *_: Any) -> None:
        self.cause = KeyboardInterrupt()

    def take_cause(self) -> BaseException | None:
        """Return and clear the exception raised since the last call."""
        cause, self.cause = self.cause, None
        return cause

    def take_nonfinite(self) -> list[NonFiniteValue]:
        """Return and clear the values that were not finite since the last call."""
        found, self.nonfinite = self.nonfinite, []
        return found

    def row(self, function: Callable[..., Any], shape: Shape, shapes: tuple[Shape, ...]) -> int:
        """Address of ``void f(const double* arguments, double* result)``, arguments of ``shapes`` one after the other."""
        cuts = [8 * cut for cut in accumulate(map(math.prod, shapes[:-1]), initial=0)]
        return self._address(function, 2, (shape, *shapes), lambda at, to: (to, *(at + cut for cut in cuts)))

    def entry(self, function: Callable[..., Any], size: int, shapes: tuple[Shape | None, ...]) -> int:
        """Address of ``void f(double* result, const double* parameters, const double* a0, ...)``, as machine code calls it.

        Parameters and arguments of shape None are not read; one of shape () is a number.
        """

        def in_time(*arguments: Any) -> Any:
            self.check()
            return function(*arguments)

        return self._address(in_time, 2 + len(shapes), ((size,), None, *shapes), lambda *places: places)

    def _address(
        self,
        function: Callable[..., Any],
        pointers: int,
        shapes: tuple[Shape | None, ...],
        places_of: Callable[..., tuple[int, ...]],
    ) -> int:
        """Address of ``function``, called with copies of its arguments.

        ``shapes``: of the result and the arguments; ``places_of(*pointers)``: their addresses.  Exceptions are noted, and
        the function is not called for arguments that follow from a value that was not finite.
        """
        known: dict[tuple[int, ...], Any] = {}

        def call(*key: int) -> None:
            try:
                if self.cause is not None:
                    return
                found = known.get(key)
                if found is None:
                    if len(known) == MAX_KNOWN:
                        known.clear()
                    places = zip(places_of(*key), shapes, strict=True)
                    result, *arguments = [_at(place, shape) for place, shape in places if shape is not None]
                    found = known[key] = result, arguments, [x.copy if x.ndim else x.item for x in arguments]
                result, arguments, copies = found
                if self.nonfinite and not all(np.isfinite(x).all() for x in arguments):
                    return
                result[...] = function(*[copy() for copy in copies])
            except NonFiniteValue as error:
                self.nonfinite.append(error)
            except BaseException as error:  # noqa: BLE001 - ctypes would print and forget it
                self.cause = error

        callback = ctypes.CFUNCTYPE(None, *[ctypes.c_size_t] * pointers)(call)
        self._kept.append(callback)
        return int(ctypes.cast(callback, ctypes.c_void_p).value or 0)


def _at(place: int, shape: Shape) -> np.ndarray:
    """Array of the doubles at an address."""
    memory: Any = (ctypes.c_double * math.prod(shape)).from_address(place)
    return np.ndarray(shape, np.float64, memory)
