"""``compile_function``: the one place that compiles, and that knows the routes.

Routes: *xla* (``jax.jit``) for JAX systems, *numpy* (plain Python calls) for NumPy systems.  Compiled code is shared by
all systems of one class, sizes and static options, whatever their parameter values, and kept on disk between processes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jax.flatten_util import ravel_pytree

from hhtbench.lowering.augmented import AugmentedDynamics
from hhtbench.lowering.numpy_dynamics import NumpyDynamics
from hhtbench.lowering.reduced import ReducedDynamics

# Every call here waits for its result; handing it to a thread of its own costs 10 us, and far more on a busy machine.
# Takes effect unless JAX has been used before.
jax.config.update("jax_cpu_enable_async_dispatch", False)

KEPT = 64  # dynamics whose flattened parameters are remembered

_compiled: dict[Any, Any] = {}
_flattened: dict[int, _Flattened] = {}
_lock = threading.Lock()


def route_of(dynamics: Any) -> str:
    """The route that serves ``dynamics``: "xla" or "numpy"."""
    inner = dynamics
    while isinstance(inner, AugmentedDynamics | ReducedDynamics):
        inner = inner.inner
    return "numpy" if isinstance(inner, NumpyDynamics) else "xla"


def compile_function(function: Callable[..., Any], dynamics: Any, *static: Any) -> Callable[..., np.ndarray]:
    """``function(dynamics, *static, *arrays) -> array`` as a fast callable of the arrays alone.

    Parameters
    ----------
    function
        A module-level function, pure and backend-neutral; it returns one array (pack several into one: every
        array that crosses from XLA to NumPy costs about a microsecond).
    static
        Hashable options; a new value compiles anew.
    """
    if route_of(dynamics) == "numpy":
        return partial(function, dynamics, *static)
    flat, jitted = _share(function, dynamics, static)

    def call(*arguments: Any) -> np.ndarray:
        return np.asarray(jitted(flat, *arguments))

    return call


class _Flattened(NamedTuple):
    """A dynamics taken apart: parameters as one vector, and what selects its compiled code."""

    dynamics: Any  #: kept, so that its id stays its own
    flat: Any  #: one argument: forty of them would cost more than the function
    unravel: Callable[[Any], Any]
    rest: Any
    key: Any


def _flatten(dynamics: Any) -> _Flattened:
    if id(dynamics) not in _flattened:
        arrays, rest = eqx.partition(dynamics, eqx.is_inexact_array)
        flat, unravel = ravel_pytree(arrays)
        while len(_flattened) >= KEPT:
            _flattened.pop(next(iter(_flattened)))
        _flattened[id(dynamics)] = _Flattened(dynamics, flat, unravel, rest, (_signature(arrays), _signature(rest)))
    return _flattened[id(dynamics)]


def _share(function: Callable[..., Any], dynamics: Any, static: tuple[Any, ...]) -> tuple[Any, Any]:
    """The parameters (k,) and the compiled function of (parameters, *arrays)."""
    with _lock:
        parts = _flatten(dynamics)
        key = (function, static, parts.key)
        if key not in _compiled:
            _use_disk_cache()
            _compiled[key] = jax.jit(_of_parameters(function, parts, static))
        return parts.flat, _compiled[key]


def _of_parameters(function: Callable[..., Any], parts: _Flattened, static: tuple[Any, ...]) -> Callable[..., Any]:
    def flat_function(flat: Any, *arguments: Any) -> Any:
        return function(eqx.combine(parts.unravel(flat), parts.rest), *static, *arguments)

    return flat_function


class Flat(NamedTuple):
    """A function of a JAX dynamics with the dynamics' parameters as its first argument, uncompiled."""

    function: Callable[..., Any]  #: (parameters, *arrays) -> array
    parameters: Any  #: (k,)
    key: Any  #: equal for functions that differ in parameter values only


def flat_function(function: Callable[..., Any], dynamics: Any, *static: Any) -> Flat:
    """``function(dynamics, *static, *arrays)`` taken apart, for readers of computations."""
    with _lock:
        parts = _flatten(dynamics)
    return Flat(_of_parameters(function, parts, static), parts.flat, (function, static, parts.key))


def _signature(tree: Any) -> Any:
    """A hashable description of a pytree: structure and, per leaf, shape and type or the value itself."""
    leaves, structure = jax.tree.flatten(tree)
    described: list[Any] = []
    for leaf in leaves:
        if eqx.is_inexact_array(leaf):
            described.append((leaf.shape, str(leaf.dtype)))
        elif hasattr(leaf, "tobytes"):
            described.append((leaf.shape, str(leaf.dtype), np.asarray(leaf).tobytes()))
        else:
            described.append(leaf if getattr(leaf, "__hash__", None) else id(leaf))
    return structure, tuple(described)


def cache_directory() -> Path:
    """Where compiled code is kept: ``$HHTBENCH_CACHE``, else ``$XDG_CACHE_HOME/hhtbench``, else ``~/.cache/hhtbench``."""
    base = os.environ.get("HHTBENCH_CACHE")
    if base:
        return Path(base)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hhtbench"


def _use_disk_cache() -> None:
    """Point JAX's persistent cache to our folder unless the user has chosen one."""
    if getattr(jax.config, "jax_compilation_cache_dir", None) is None:
        jax.config.update("jax_compilation_cache_dir", str(cache_directory() / "xla"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", 0)
