"""Functions in Python that machine code calls by address.

Machine code fills the result with NaN before the call and the callback writes it last: after an exception it is NaN.
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
MOST_PLACES = 64  # in memory at which one function is remembered to have been called: on the stack they vary with its depth


class Callbacks:
    """Functions in Python that machine code calls by address, and what one of them has raised.

    Equal to all others, since code does not depend on them.  ``with callbacks:`` around machine code that calls them: in the
    main thread an interrupt is then noted instead of raised between two of their lines, where it would be lost.
    """

    def __init__(self, system: Any = None) -> None:
        self.system = system
        self.cause: BaseException | None = None  #: nothing is computed any more
        self.check: Callable[[], None] = lambda: None  #: before a whole function is computed; raises where no time is left
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
        """What a callback has raised since the last call."""
        cause, self.cause = self.cause, None
        return cause

    def take_nonfinite(self) -> list[NonFiniteValue]:
        """The values that were not finite since the last call, as callbacks reported them."""
        found, self.nonfinite = self.nonfinite, []
        return found

    def row(self, function: Callable[..., Any], shape: Shape, shapes: tuple[Shape, ...]) -> int:
        """Address of ``void f(const double* arguments, double* result)``, the arguments of ``shapes`` in a row."""
        cuts = [8 * cut for cut in accumulate(map(math.prod, shapes[:-1]), initial=0)]
        return self._address(function, 2, (shape, *shapes), lambda at, to: (to, *(at + cut for cut in cuts)))

    def entry(self, function: Callable[..., Any], size: int, shapes: tuple[Shape | None, ...]) -> int:
        """Address of ``void f(double* result, const double* parameters, const double* a0, ...)``, as machine code has it.

        Parameters are not checked, nor arguments whose shape is None; one of shape () is a number.
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
        """Of ``function``, called with copies of its arguments.

        ``shapes`` are those of the result and of the arguments, ``places_of(*pointers)`` their addresses.
        What it raises is noted; nor is it asked for what comes from a value that was not finite.
        """
        known: dict[tuple[int, ...], Any] = {}

        def call(*key: int) -> None:
            try:
                if self.cause is not None:
                    return
                found = known.get(key)
                if found is None:
                    if len(known) == MOST_PLACES:
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
    """The doubles at an address."""
    memory: Any = (ctypes.c_double * math.prod(shape)).from_address(place)
    return np.ndarray(shape, np.float64, memory)
