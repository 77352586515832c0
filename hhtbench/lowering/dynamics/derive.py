"""``derive``: from a System to its Dynamics, cached while its parameters are unchanged."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from typing import TYPE_CHECKING, Any

import equinox as eqx
import numpy as np

from hhtbench.lowering.caching import Cache, by_id, same
from hhtbench.lowering.dynamics.declared import expect_physics
from hhtbench.lowering.dynamics.names import expect_names
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import NumpySystem, System

if TYPE_CHECKING:
    from hhtbench.lowering.dynamics.jax_dynamics import JaxDynamics
    from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics

_ways: dict[type, Callable[[Any], Hashable]] = {}  # functions that make values comparable, by type
_derived = Cache(64)  # each structure costs a trace of every function of the system


def derive(
    system: System | NumpySystem,
    t: float,
    q: Vector,
    v: Vector,
    *,
    ignored: tuple[str, ...] = (),
    without: tuple[str, ...] = (),
) -> JaxDynamics | NumpyDynamics:
    """Derive the Dynamics of ``system``: all its terms, uncompiled.

    Parameters
    ----------
    t, q, v
        A point, for the sizes: (n,) arrays.
    ignored
        Declared derivatives that are not used but derived.
    without
        Names of ``REDUCTIONS`` to switch off.

    Raises
    ------
    ProblemError
        A declared function returns the wrong shape; the message names it and both shapes.  Or Python control flow uses a
        value that JAX traces; the message names the line.
    TypeError
        A declared function returns something that is not a real array, or no ``force`` is declared.
    """
    expect_names(type(system))  # type: ignore[arg-type] # classes are hashable
    if issubclass(type(system), System):  # isinstance is slow: it asks equinox
        key = by_id(system), parameters_of(system), np.shape(q), ignored, without
        found: JaxDynamics = _derived.find(key, lambda: _derive_jax(system, t, q, v, ignored, without))
        return found
    if isinstance(system, NumpySystem):
        return _of_numpy(system, t, q, v, ignored, without)
    raise TypeError(f"expected a System or a NumpySystem; got {type(system).__name__}.")


def _derive_jax(*of: Any) -> JaxDynamics:
    from hhtbench.lowering.dynamics.derive_jax import derive_jax  # plain callables do without it

    return derive_jax(*of)


def _of_numpy(system: NumpySystem, t: float, q: Vector, v: Vector, *how: tuple[str, ...]) -> NumpyDynamics:
    from hhtbench.lowering.dynamics import differences, numpy_dynamics  # what JAX traces does without them

    expect_physics(system)
    structure = numpy_dynamics.structure_of(system, t, q, v)
    key = by_id(system), parameters_of(system), structure, *how, differences.uncommon_decade(q)
    found: NumpyDynamics = _derived.find(key, lambda: numpy_dynamics.derive_numpy(system, structure, t, q, v, *how))
    return found


def parameters_of(value: Any) -> Hashable:
    """Parameters of a system in comparable form: mutable arrays by their bytes, all else by identity.

    Values that a function or another object in a field refers to are not included.
    """
    return _ways.get(type(value), _found_way)(value)


def _found_way(value: Any) -> Hashable:
    """:func:`parameters_of` for the first value of its type; remembers the function for that type."""
    kind = type(value)  # isinstance(value, ...) and attributes would ask equinox
    way = _ways[kind] = next((way for kinds, way in COMPARED if issubclass(kind, kinds)), by_id if value is None else same)
    return way(value)


def _of_values(values: Iterable[Any]) -> Hashable:
    return tuple([_ways.get(type(value), _found_way)(value) for value in values])


COMPARED: tuple[tuple[Any, Callable[[Any], Hashable]], ...] = (
    (np.ndarray, lambda x: (x.shape, x.dtype.str, x.tobytes())),
    ((eqx.Module, NumpySystem), lambda x: parameters_of(object.__getattribute__(x, "__dict__"))),
    (dict, lambda x: (tuple(x), _of_values(x.values()))),
    ((tuple, list), _of_values),
)
