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
from itertools import pairwise
from types import TracebackType
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import ShapedArray

from hhtbench.errors import NonFiniteValue
from hhtbench.lowering.dynamics.diagonal import full
from hhtbench.lowering.dynamics.dynamics import Dynamics, EquationsOfMotion
from hhtbench.lowering.dynamics.structure import Structure
from hhtbench.lowering.jax_internals import Primitive
from hhtbench.protocol import declared

foreign_p = Primitive("hhtbench_foreign")
foreign_p.def_abstract_eval(lambda address, *arguments, shape: ShapedArray(shape, np.dtype(np.float64)))
_POINTER = ctypes.c_void_p

FUNCTIONS = {  # sizes of the result, and of the arguments: "1" the time, n coordinates, m and p multipliers
    "force": ("n", "1nn"),
    "force_jacobians": ("2nn", "1nn"),
    "mass": ("nn", "1n"),
    "mass_product_jacobian": ("nn", "1nn"),
    "constraint": ("m", "1n"),
    "constraint_jacobian": ("mn", "1n"),
    "constraint_time_derivative": ("m", "1n"),
    "constraint_velocity_jacobian": ("mn", "1nn"),
    "constraint_acceleration": ("m", "1nn"),
    "velocity_constraint": ("p", "1nn"),
    "velocity_constraint_jacobian": ("pn", "1nn"),
    "velocity_constraint_position_jacobian": ("pn", "1nn"),
    "velocity_constraint_acceleration": ("p", "1nn"),
    "reaction": ("n", "1nm"),
    "reaction_jacobians": ("n(n+m)", "1nm"),
    "velocity_reaction": ("n", "1nnp"),
    "velocity_reaction_jacobians": ("n(n+p)", "1nnp"),
}


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
        handler = signal.getsignal(signal.SIGINT)
        known = handler is signal.default_int_handler or isinstance(getattr(handler, "__self__", None), Callbacks)
        if threading.current_thread() is threading.main_thread() and known and self._before is None:
            self._before = signal.signal(signal.SIGINT, self._interrupted)

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)
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

    def row(self, function: Callable[..., Any], size: int, sizes: tuple[int, ...]) -> int:
        """Address of ``void f(const double* arguments, double* result)``, the arguments in a row, the time first."""
        cuts = np.cumsum([0, *sizes]).tolist()
        parts = [slice(start, stop) for start, stop in pairwise(cuts[1:])]
        given = ctypes.c_double * cuts[-1]

        def compute(at: int) -> Any:
            values = np.array(given.from_address(at))
            return None if self._is_nan(values) else function(float(values[0]), *[values[part] for part in parts])

        call = self._noting(compute, size)
        return self._kept_address(ctypes.CFUNCTYPE(None, _POINTER, _POINTER), lambda at, to: call(to, at))

    def entry(self, function: Callable[..., Any], size: int, shapes: tuple[tuple[int, ...] | None, ...]) -> int:
        """Address of ``void f(double* result, const double* parameters, const double* a0, ...)``, as machine code has it.

        Parameters are not looked at, nor arguments whose shape is None; one of shape () is a number.
        """
        kinds = [None if shape is None else ctypes.c_double * math.prod(shape) for shape in shapes]

        def compute(*places: int) -> Any:
            self.check()
            arguments = []
            for place, kind, shape in zip(places[1:], kinds, shapes, strict=True):
                if kind is not None and shape is not None:
                    values = np.array(kind.from_address(place))
                    if self._is_nan(values):
                        return None
                    arguments.append(values.reshape(shape) if shape else float(values[0]))
            return function(*arguments)

        kind = ctypes.CFUNCTYPE(None, *[_POINTER] * (2 + len(shapes)))
        return self._kept_address(kind, self._noting(compute, size))

    def _is_nan(self, values: Any) -> bool:
        """Whether what a function is asked for comes from a value that was not finite: then it is not asked."""
        return bool(self.nonfinite) and not np.isfinite(values).all()

    def _noting(self, compute: Callable[..., Any], size: int) -> Callable[..., None]:
        """``call(to, *places)`` that writes what is computed, last of all, and notes what is raised."""
        result = ctypes.c_double * size

        def call(to: int, *places: int) -> None:
            try:
                if self.cause is not None:
                    return
                value = compute(*places)
                if value is not None:
                    out: Any = result.from_address(to)
                    np.frombuffer(out)[:] = value
            except NonFiniteValue as error:
                self.nonfinite.append(error)
            except BaseException as error:  # noqa: BLE001 - ctypes would print and forget it
                self.cause = error

        return call

    def _kept_address(self, kind: Any, function: Callable[..., None]) -> int:
        callback = kind(function)
        self._kept.append(callback)
        return int(ctypes.cast(callback, ctypes.c_void_p).value or 0)


class ForeignDynamics(eqx.Module, EquationsOfMotion):
    """The functions of a dynamics of plain callables, to be traced; see :class:`~.jax_dynamics.JaxDynamics`."""

    addresses: Any  #: (functions,) float64 with the bits of their addresses
    structure: Structure = eqx.field(static=True)
    callbacks: Callbacks = eqx.field(static=True)
    own_reactions: tuple[bool, bool] = eqx.field(static=True)  #: whether those of position and velocity rows are declared
    constant_mass: Any = None  #: (n, n) when the mass is a constant
    inverse_mass: Any = None  #: (n, n) its inverse, likewise

    @property
    def system(self) -> Any:
        """The NumpySystem."""
        return self.callbacks.system

    @property
    def xp(self) -> Any:
        """The array namespace of this dynamics."""
        return jnp

    def __getattr__(self, name: str) -> Any:
        if name not in FUNCTIONS:
            raise AttributeError(name)
        return lambda *arguments: self._call(name, *arguments)

    def _call(self, name: str, *arguments: Any) -> Any:
        address = self.addresses[list(FUNCTIONS).index(name)]
        floats = (jnp.asarray(argument, dtype=float) for argument in arguments)
        return foreign_p.bind(address, *floats, shape=_shape(FUNCTIONS[name][0], self.structure))

    def mass(self, t: Any, q: Any) -> Any:
        """M (n, n)."""
        if self.structure.mass == "variable":
            return self._call("mass", t, q)
        return jnp.eye(self.structure.n) if self.constant_mass is None else full(self.constant_mass, jnp)

    def force_jacobians(self, t: Any, q: Any, v: Any) -> tuple[Any, Any]:
        """(F_q, F_v), each (n, n)."""
        both = self._call("force_jacobians", t, q, v)
        return both[0], both[1]

    def constraint_velocity(self, t: Any, q: Any, v: Any) -> Any:
        """g_t + g_q v (m,)."""
        return self.constraint_jacobian(t, q) @ v + self.constraint_time_derivative(t, q)

    def reaction(self, t: Any, q: Any, lam: Any) -> Any:
        """Q (n,) of the position constraints."""
        return self._call("reaction", t, q, lam) if self.own_reactions[0] else -(lam @ self.constraint_jacobian(t, q))

    def reaction_jacobians(self, t: Any, q: Any, lam: Any) -> tuple[Any, Any]:
        """(Q_q (n, n), Q_lam (n, m))."""
        return _split(self._call("reaction_jacobians", t, q, lam), self.structure.n)

    def velocity_reaction(self, t: Any, q: Any, v: Any, mu: Any) -> Any:
        """Q (n,) of the velocity constraints."""
        if self.own_reactions[1]:
            return self._call("velocity_reaction", t, q, v, mu)
        return -(mu @ self.velocity_constraint_jacobian(t, q, v))

    def velocity_reaction_jacobians(self, t: Any, q: Any, v: Any, mu: Any) -> tuple[Any, Any]:
        """(derivative by v (n, n), derivative by mu (n, p)) of the velocity reaction."""
        return _split(self._call("velocity_reaction_jacobians", t, q, v, mu), self.structure.n)


def foreign(dynamics: Dynamics) -> ForeignDynamics:
    """``dynamics`` of plain callables on NumPy arrays as one that can be traced."""
    s, callbacks = dynamics.structure, Callbacks(dynamics.system)
    addresses = []
    for name, (result, arguments) in FUNCTIONS.items():
        shape = _shape(result, s)
        sizes = tuple(_shape(letter, s)[0] for letter in arguments)
        addresses.append(callbacks.row(_flat(getattr(dynamics, name), name, s.n), int(np.prod(shape)), sizes))
    masses = (None if mass is None else np.asarray(mass) for mass in (dynamics.constant_mass, dynamics.inverse_mass))
    own = tuple(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction"))
    bits = np.array(addresses, dtype=np.uint64).view(np.float64)
    return ForeignDynamics(bits, s, callbacks, own, *masses)  # type: ignore[arg-type]


def _flat(function: Callable[..., Any], name: str, n: int) -> Callable[..., Any]:
    """``function`` with its result in a row; of a pair of matrices, None stands for zero."""
    if name == "force_jacobians":
        return lambda *arguments: np.stack([np.zeros((n, n)) if x is None else x for x in function(*arguments)]).ravel()
    if name.endswith("reaction_jacobians"):

        def both(*arguments: Any) -> Any:
            first, second = function(*arguments)
            return np.concatenate([np.zeros((n, n)) if first is None else first, second], axis=1).ravel()

        return both
    return lambda *arguments: function(*arguments).ravel()


def _split(both: Any, n: int) -> tuple[Any, Any]:
    return both[:, :n], both[:, n:]


def _shape(letters: str, s: Structure) -> tuple[int, ...]:
    sizes = {"n": s.n, "m": s.m, "p": s.p, "1": 1, "2": 2}
    if letters.startswith("n("):
        return s.n, s.n + sizes[letters[-2]]
    return tuple(sizes[letter] for letter in letters)
