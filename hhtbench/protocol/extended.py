"""Systems with first-order states and held inputs, on coordinates and velocities that every solver takes.

A state ``x' = w(t, q, v, x, u)`` is the velocity of one more coordinate ``y`` of unit mass: ``y' = x, x' = w``.  An input
that is held between samples is a coordinate that no force moves and that events change.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import (
    DECLARABLE,
    PATTERNS,
    SIGNATURES,
    WITH_VELOCITY,
    NumpySystem,
    System,
    declared,
    full_pattern,
)

STATES, INPUTS = "x", "u"  # arguments of functions that take first-order states or held inputs, too
TAKE_BOTH = ("force", "state_rate", "reaction", "velocity_reaction", "energy", "power", "invariants")
MEASURED = ("energy", "power", "invariants")
STATE_RATE = ("t", "q", "v")


class Layout(NamedTuple):
    """Numbers of coordinates q, states x, inputs u and entries of waiting samples.

    Extended coordinates are (q, y, u, waiting samples), extended velocities (v, x, 0, 0).
    """

    n: int
    states: int
    inputs: int
    waiting: int

    @property
    def size(self) -> int:
        """Number of extended coordinates."""
        return sum(self)

    def x(self, v: Any) -> Any:
        """States (..., k) in extended velocities."""
        return v[..., self.n : self.n + self.states]

    def u(self, q: Any) -> Any:
        """Inputs (..., l) in extended coordinates."""
        return q[..., self.n + self.states : self.n + self.states + self.inputs]

    def given(self, names: tuple[str, ...], q: Any, v: Any) -> dict[str, Any]:
        """States and inputs by those of their argument names that are in ``names``."""
        parts = {STATES: lambda: self.x(v), INPUTS: lambda: self.u(q)}
        return {name: parts[name]() for name in names}


class Extended(System):
    """``inner``, whose functions may take states and inputs, as a system of extended coordinates."""

    inner: System
    layout: Layout = eqx.field(static=True)

    def __getattr__(self, name: str) -> Any:
        if name not in DECLARABLE:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return on_extended(self.inner, self.layout, name, jnp)


class NumpyExtended(NumpySystem):
    """The same of a NumpySystem."""

    def __init__(self, inner: NumpySystem, layout: Layout) -> None:
        super().__init__(**{name: on_extended(inner, layout, name, np) for name in DECLARABLE})
        object.__setattr__(self, "inner", inner)
        object.__setattr__(self, "layout", layout)


def extended(inner: System | NumpySystem, layout: Layout) -> Extended | NumpyExtended:
    """``inner`` as a system of extended coordinates.

    Raises
    ------
    TypeError
        A function takes states or inputs that it must not depend on.
    ProblemError
        There are inputs, and no function takes them.
    """
    taken = [_further(declared(inner, name), name) for name in (*SIGNATURES, "state_rate")]
    if layout.inputs and not any(INPUTS in one for one in taken):
        raise ProblemError(f"the problem has sampled inputs, and no function takes u: write force(t, q, v, {INPUTS}).")
    for name, further in zip(SIGNATURES, taken, strict=False):
        refused = [one for one in further if name not in TAKE_BOTH and (one, name) != (INPUTS, "velocity_constraint")]
        if refused:
            raise TypeError(f"{name} cannot depend on {refused[0]}; these can: {', '.join(TAKE_BOTH)}.")
    return NumpyExtended(inner, layout) if isinstance(inner, NumpySystem) else Extended(inner, layout)


def on_extended(inner: System | NumpySystem, layout: Layout, name: str, xp: Any) -> Any:
    """The function or value ``name`` of ``inner`` on extended coordinates, for ``xp`` NumPy or ``jax.numpy``.

    None if it is not declared, is part of the force, or is to be derived: declared Jacobians lack derivatives by states and
    inputs.
    """
    value, more = declared(inner, name), sum(layout[1:])
    if name == "mass_matrix" and value is not None:
        if callable(value):
            return lambda t, q: _with_ones(value(t, q[: layout.n]), layout.n, more, xp)
        return _with_ones(value, layout.n, more, xp)
    if value is None or name in ("state_rate", "force_jacobians", "reaction_jacobians"):
        return None
    if name == "sparsity":
        return {key: _pattern(key, full_pattern(one), layout) for key, one in value.items()}
    if not callable(value):
        return value
    given = arguments_of(name, value)
    results = (WITH_VELOCITY if "v" in given and name in WITH_VELOCITY else SIGNATURES)[name].results
    called = _called(value, given, layout, name)
    law = declared(inner, "state_rate") if name == "force" else None
    rates = None if law is None else _called(law, STATE_RATE, layout)
    # A reaction that takes states takes velocities, too: states are among them.
    wanted = WITH_VELOCITY[name].arguments if name in WITH_VELOCITY and STATES in _further(value, name) else given

    def function(*arguments: Any) -> Any:
        named = dict(zip(wanted, arguments, strict=True))
        found = called(named)
        if name in MEASURED:
            return found
        if name == "force" and np.shape(found) != (layout.n,):
            raise ProblemError(f"force must return shape ({layout.n},), one entry per coordinate; got {np.shape(found)}.")
        if rates is not None:
            rate = xp.asarray(rates(named))
            if rate.shape != (layout.states,):
                raise ProblemError(f"state_rate must return shape ({layout.states},), as x0; got {rate.shape}.")
            found = xp.concatenate([xp.asarray(found), rate])
            return _padded(found, "n", layout.inputs + layout.waiting, xp)
        if len(results) == 1:
            return _padded(found, results[0], more, xp)
        return tuple(_padded(part, letters, more, xp) for part, letters in zip(found, results, strict=True))

    parameters = [inspect.Parameter(one, inspect.Parameter.POSITIONAL_OR_KEYWORD) for one in wanted]
    function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    return function


def states_and_inputs(function: Any, count: int) -> tuple[str, ...]:
    """Names among ``STATES`` and ``INPUTS`` of the arguments that ``function`` takes behind its first ``count``."""
    try:
        parameters = list(inspect.signature(function).parameters)[count:] if callable(function) else []
    except ValueError:  # a function of C
        parameters = []
    return tuple(name for name in (STATES, INPUTS) if name in parameters)


def _further(function: Any, name: str) -> tuple[str, ...]:
    """Names of the states and inputs that the function ``name`` takes behind its other arguments.

    Raises
    ------
    TypeError
        One stands before ``lam``.
    """
    further = states_and_inputs(function, len(STATE_RATE if name == "state_rate" else SIGNATURES[name].arguments))
    parameters = list(inspect.signature(function).parameters) if name in WITH_VELOCITY and callable(function) else []
    if "q" in parameters and "lam" in parameters and {STATES, INPUTS} & {*parameters[: parameters.index("lam")]}:
        raise TypeError(f"{name} takes states and inputs behind lam; it is declared with ({', '.join(parameters)}).")
    return further


def arguments_of(name: str, function: Any) -> tuple[str, ...]:
    """The protocol's arguments of the function ``name`` before states and inputs."""
    options = [signatures[name].arguments for signatures in (SIGNATURES, WITH_VELOCITY) if name in signatures]
    try:
        count = len(inspect.signature(function).parameters) - len(_further(function, name))
    except ValueError:
        count = len(options[0])
    return next((one for one in options if len(one) == count), options[0])


def _called(
    function: Callable[..., Any], given: tuple[str, ...], layout: Layout, name: str = "state_rate"
) -> Callable[[dict[str, Any]], Any]:
    """The function ``name`` of extended arguments by name."""
    further = _further(function, name)

    def call(named: dict[str, Any]) -> Any:
        own = [named[one][: layout.n] if one in ("q", "v") else named[one] for one in given]
        return function(*own, **layout.given(further, named["q"], named.get("v")))

    return call


def _padded(value: Any, letters: str, more: int, xp: Any) -> Any:
    """``value`` with zeros behind every axis of coordinates; None stays None."""
    return None if value is None else xp.pad(xp.asarray(value), [(0, more if one == "n" else 0) for one in letters])


def _with_ones(mass: Any, n: int, more: int, xp: Any) -> Any:
    """The mass matrix with unit masses of the further coordinates."""
    mass = xp.asarray(mass)
    if mass.shape not in ((), (n,), (n, n)):
        raise ProblemError(f"mass_matrix must be a number, ({n},) or ({n}, {n}); got {mass.shape}.")
    if mass.ndim < 2:
        return xp.concatenate([xp.broadcast_to(mass, (n,)), xp.ones(more)])
    return xp.pad(mass, [(0, more)] * 2) + xp.diag(xp.concatenate([xp.zeros(n), xp.ones(more)]))


def _pattern(key: str, pattern: Any, layout: Layout) -> Any:
    """A pattern of nonzeros on extended coordinates: forces may depend on all states and inputs."""
    n, states, inputs, _ = layout
    found = np.pad(pattern, [(0, sum(layout[1:]) if one == "n" else 0) for one in PATTERNS[key]])
    if key == "mass_matrix":
        found[n:, n:] |= np.eye(sum(layout[1:]), dtype=bool)
    elif key in ("force_q", "reaction_q"):
        found[: n + states, n + states : n + states + inputs] = True
    elif key in ("force_v", "reaction_v"):
        found[: n + states, n : n + states] = True
    if key in ("force_q", "force_v"):
        found[n : n + states, :n] = True
    if key == "velocity_constraint_q":
        found[:, n + states : n + states + inputs] = True
    return found
