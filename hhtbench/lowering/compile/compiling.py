"""``compile_function``: compiles a function of a dynamics; its route is chosen at its first call.

*native*: straight-line machine code, for small JAX systems; *xla*: ``jax.jit``, for large ones and for operations that the
native route does not know; *numpy*: plain Python calls, for NumPy systems.  Values agree to roundoff.  Compiled code is
shared by all systems of one class, sizes and static options, whatever their parameter values, and kept on disk.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.compile.routes import Route, route_of

_callables = Cache(512)  # finding a function's code again takes as long as a hundred calls of it


def compile_function(
    function: Callable[..., Any], dynamics: Any, *static: Any, route: str | None = None
) -> Callable[..., np.ndarray]:
    """Compile ``function(dynamics, *static, *arrays) -> array`` to a fast callable of the arrays alone.

    Parameters
    ----------
    function
        A module-level function, pure and backend-neutral; it returns one array (pack several into one: every
        array that crosses from XLA to NumPy costs about a microsecond).
    static
        Hashable options; a new value compiles anew.
    route
        "xla": compile a JAX dynamics by XLA, not to machine code.

    Raises
    ------
    ProblemError
        At a call: Python control flow uses a value that JAX traces; the message says where.
    """
    if route_of(dynamics) == "numpy":
        return partial(function, dynamics, *static)
    from hhtbench.lowering.compile.compiled import Compiled  # plain callables do without the compilers

    key = (function, by_id(dynamics), static, route)
    compiled: Compiled = _callables.find(key, lambda: Compiled(function, dynamics, static, route))
    return compiled.call


def routes(dynamics: Any) -> tuple[Route, ...]:
    """Route of every function of ``dynamics`` called so far, with reasons."""
    if route_of(dynamics) == "numpy":
        return (Route("every function", "numpy", "the functions are plain callables on NumPy arrays"),)
    return tuple(route for made in _callables.values() if made.dynamics is dynamics for route in made.routes.values())
