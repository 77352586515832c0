"""The functions of a NumPy system as operations of machine code: calls back into Python by address.

The formulas are traced as for any system; what the system itself computes is one operation each, ``foreign_p``, which
machine code carries out as a call.  The addresses are parameters, so that code is shared by all systems of one structure.
Machine code fills the result with NaN before the call and the callback writes it last: after an exception it is NaN.
"""

from __future__ import annotations

import ctypes
import math
import signal
import threading
from collections.abc import Callable
from functools import partial
from itertools import accumulate
from types import TracebackType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray

from hhtbench.errors import NonFiniteValue
from hhtbench.lowering import cpython_internals
from hhtbench.lowering.dynamics.dynamics import Dynamics, Structure, arguments_of, as_declared, innermost
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics
from hhtbench.lowering.jax_internals import Primitive
from hhtbench.protocol import SIGNATURES, WITH_VELOCITY, Signature, declared

Shape = tuple[int, ...]
foreign_p = Primitive("hhtbench_foreign")
foreign_p.def_abstract_eval(lambda address, *arguments, shape: ShapedArray(shape, np.dtype(np.float64)))
SIGINT = int(signal.SIGINT)
MOST_PLACES = 64  # in memory at which one function is remembered to have been called: on the stack they vary with its depth

UNDECLARED = {  # sizes of the results of what no user declares
    "constraint_rows": ("mn",),
    "constraint_velocity": ("m",),
    "velocity_constraint_rows": ("pn",),
    "mass_product_jacobian": ("nn",),
    "constraint_velocity_jacobian": ("mn",),
    "velocity_constraint_position_jacobian": ("pn",),
    "velocity_constraint_acceleration": ("p",),
    "velocity_reaction_jacobians": ("nn", "np"),
}
FUNCTIONS = {"mass": SIGNATURES["mass_matrix"]} | {
    name: SIGNATURES[name] if name in SIGNATURES else Signature(arguments_of(name), UNDECLARED[name])
    for name in (*SIGNATURES, *UNDECLARED)
    if hasattr(Dynamics, name)
}


def functions_of(s: Structure) -> dict[str, Signature]:
    """``FUNCTIONS``, those of reactions as a system of this structure has them."""
    return FUNCTIONS | WITH_VELOCITY if s.reaction_uses_v else FUNCTIONS


BY_ROWS = {  # what follows from Jacobians, where these are declared
    "constraint_rows": "constraint_jacobian",
    "constraint_velocity": "constraint_jacobian",
    "velocity_constraint_rows": "velocity_constraint_jacobian",
}
SIZES = {"t": "", "q": "n", "v": "n", "x": "n", "lam": "m", "mu": "p"}  #: of arguments, by letter


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
        """The values that were not finite since the last call, where callbacks told of them."""
        found, self.nonfinite = self.nonfinite, []
        return found

    def row(self, function: Callable[..., Any], shape: Shape, shapes: tuple[Shape, ...]) -> int:
        """Address of ``void f(const double* arguments, double* result)``, the arguments of ``shapes`` in a row."""
        cuts = [8 * cut for cut in accumulate(map(math.prod, shapes[:-1]), initial=0)]
        return self._address(function, 2, (shape, *shapes), lambda at, to: (to, *(at + cut for cut in cuts)))

    def entry(self, function: Callable[..., Any], size: int, shapes: tuple[Shape | None, ...]) -> int:
        """Address of ``void f(double* result, const double* parameters, const double* a0, ...)``, as machine code has it.

        Parameters are not looked at, nor arguments whose shape is None; one of shape () is a number.
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


class Called(eqx.Module, Dynamics):
    """The functions of a dynamics of plain callables, to be traced."""

    addresses: Any  #: (functions,) float64 with the bits of their addresses
    callbacks: Callbacks = eqx.field(static=True)
    noise: float = eqx.field(static=True)  # type: ignore[misc] # of the dynamics
    structure: Structure = eqx.field(static=True)

    @property
    def system(self) -> Any:
        """The NumpySystem."""
        return self.callbacks.system

    @property
    def xp(self) -> Any:
        """The array namespace of this dynamics."""
        return jnp


class ForeignDynamics(Called):
    """By full matrices; see :class:`~.jax_dynamics.JaxDynamics`."""

    own: tuple[str, ...] = eqx.field(static=True)  #: the functions that are called; the rest are derived from them
    constant_mass: Any = None  #: (n, n) when the mass is a constant
    inverse_mass: Any = None  #: (n, n) its inverse, likewise

    def gives(self, name: str) -> bool:
        """Whether ``name`` is called."""
        return name in self.own

    def call(self, name: str, t: Any, *arguments: Any) -> Any:
        """The result of the function ``name``, an array or several."""
        results = functions_of(self.structure)[name].results
        address, shape = self.addresses[list(FUNCTIONS).index(name)], _shape(results, self.structure)
        floats = (jnp.asarray(argument, dtype=float) for argument in (t, *arguments))
        value = foreign_p.bind(address, *floats, shape=shape)
        if len(results) == 1:
            return value
        ends = list(accumulate(getattr(self.structure, letters[1]) for letters in results))
        return tuple(value[:, first:end] for first, end in zip([0, *ends], ends, strict=False))


def foreign(dynamics: Dynamics) -> ForeignDynamics:
    """``dynamics`` of plain callables on NumPy arrays as one that can be traced."""
    s, callbacks = dynamics.structure, Callbacks(dynamics.system)
    users = dynamics.functions if isinstance(dynamics, NumpyDynamics) else {}  # of copies already, and to be copied from
    addresses = []
    for name, (arguments, results) in functions_of(s).items():
        function = users.get("mass_matrix" if name == "mass" else name) or as_declared(dynamics, name)
        if len(results) > 1:
            function = partial(_joined, function, s.n)
        addresses.append(
            callbacks.row(function, _shape(results, s), tuple(_shape((SIZES[symbol],), s) for symbol in arguments))
        )
    masses = (None if mass is None else np.asarray(mass) for mass in (dynamics.constant_mass, dynamics.inverse_mass))
    derived = {name for name in ("reaction", "velocity_reaction") if declared(dynamics.system, name) is None}
    inner = innermost(dynamics)
    derived |= {name for name, rows in BY_ROWS.items() if inner.gives(rows)}
    bits = np.array(addresses, dtype=np.uint64).view(np.float64)
    own = tuple(name for name in FUNCTIONS if name not in derived and (name != "mass" or s.mass == "variable"))
    return ForeignDynamics(bits, callbacks, inner.noise, s, own, *masses)


def _joined(function: Callable[..., Any], n: int, *arguments: Any) -> Any:
    """The matrices that ``function`` gives, side by side; None stands for zero."""
    return np.concatenate([np.zeros((n, n)) if part is None else part for part in function(*arguments)], axis=1)


def _shape(sizes: tuple[str, ...], s: Structure) -> Shape:
    """Of an array whose sizes are known by letter, or of matrices side by side."""
    first, *others = (tuple(getattr(s, letter) for letter in letters) for letters in sizes)
    return (first[0], first[1] + sum(other[1] for other in others)) if others else first
