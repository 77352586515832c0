"""Which route a function takes, and why."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from hhtbench.errors import ProblemError

ROUTES = ("auto", "native", "xla")
VARIABLE = "HHTBENCH_ROUTE"  #: of the environment: the route where none is asked for
MOST_UNKNOWNS = 80  # n + m + p: above it XLA compiles sooner, and sparse matrices take over anyway


@dataclass(frozen=True)
class Route:
    """How one function is computed."""

    function: str
    route: str  #: "native", "xla" or "numpy"
    reason: str
    operations: int | None = None  #: scalar operations, of the native route


class Compilable(Protocol):
    """A pytree of functions and parameters: what this room knows of :class:`~hhtbench.lowering.Dynamics`."""

    @property
    def structure(self) -> Any:
        """Sizes n, m and p."""

    @property
    def xp(self) -> Any:
        """The array namespace of the functions: ``numpy`` or ``jax.numpy``."""


def route_of(dynamics: Compilable) -> str:
    """What ``dynamics`` is made of: "numpy" for plain callables, "xla" for what JAX can trace, compiled by either route."""
    return "numpy" if dynamics.xp is np else "xla"


def wanted_route(route: str | None) -> str:
    """The route asked for by the argument, else by the environment, else "auto".

    Raises
    ------
    ProblemError
        There is no such route.
    """
    source = "route" if route is not None else VARIABLE
    wanted = route if route is not None else os.environ.get(VARIABLE) or "auto"
    if wanted not in ROUTES:
        raise ProblemError(f"{source} must be one of {', '.join(ROUTES)}; got {wanted!r}.")
    return wanted


def too_large(dynamics: Compilable) -> str | None:
    """Why the native route would not pay for a system of this size, or None."""
    s = dynamics.structure
    unknowns = s.n + s.m + s.p
    if unknowns <= MOST_UNKNOWNS:
        return None
    return f"n + m + p = {unknowns} is more than {MOST_UNKNOWNS}: machine code without loops would be long"
