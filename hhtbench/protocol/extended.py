"""Systems with first-order states and held inputs, on coordinates and velocities that every solver takes.

A state ``x' = w(t, q, v, x, u)`` is the velocity of one more coordinate ``y`` of unit mass: ``y' = x, x' = w``.  An input
that is held between samples is a coordinate that no force moves and that events change.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hhtbench.protocol.arguments import real_vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event
from hhtbench.protocol.sampled import Sampled, sampling_events
from hhtbench.protocol.scales import Scales, Unscaled
from hhtbench.protocol.system import (
    DECLARABLE,
    PATTERNS,
    SIGNATURES,
    WITH_VELOCITY,
    NumpySystem,
    Signature,
    System,
    declared,
    full_pattern,
)

if TYPE_CHECKING:
    from hhtbench.protocol.problem import Problem

STATES, INPUTS = "x", "u"  # names of the further arguments
TAKE_BOTH = ("force", "state_rate", "reaction", "velocity_reaction", "energy", "power", "invariants")
MEASURED = ("energy", "power", "invariants")
STATE_RATE = Signature(("t", "q", "v"), ("k",))


class Layout(NamedTuple):
    """Numbers of coordinates q, states x, inputs u and entries of waiting samples.

    Extended coordinates are (q, y, u, waiting samples), extended velocities (v, x, 0, 0).
    """

    n: int
    states: int
    inputs: int
    waiting: int

    def x(self, v: Any) -> Any:
        """States (..., k) in extended velocities."""
        return v[..., self.n : self.n + self.states]

    def u(self, q: Any) -> Any:
        """Inputs (..., l) in extended coordinates."""
        return q[..., self.n + self.states : self.n + self.states + self.inputs]


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
    """
    for name in SIGNATURES:
        further = _further(declared(inner, name))
        refused = [one for one in further if name not in TAKE_BOTH and (one, name) != (INPUTS, "velocity_constraint")]
        if refused:
            raise TypeError(f"{name} cannot depend on {refused[0]}; these can: {', '.join(TAKE_BOTH)}.")
    return NumpyExtended(inner, layout) if isinstance(inner, NumpySystem) else Extended(inner, layout)


def extended_fields(problem: Problem) -> dict[str, Any]:
    """Fields of the problem on extended coordinates.

    Raises
    ------
    ProblemError, TypeError
        States or inputs do not fit the system.
    """
    inputs = tuple(problem.inputs) if isinstance(problem.inputs, (list, tuple)) else (problem.inputs,)
    for i, one in enumerate(inputs):
        if not isinstance(one, Sampled):
            raise TypeError(f"inputs[{i}] must be a hhtbench.Sampled; got {type(one).__name__}.")
    x0 = np.zeros(0) if problem.x0 is None else real_vector("x0", problem.x0)
    if (declared(problem.system, "state_rate") is None) != (x0.size == 0):
        raise ProblemError(
            "first-order states need state_rate(t, q, v, x) of the system and x0=, their start, of the problem."
        )
    if inputs and problem.t_span[1] < problem.t_span[0]:
        raise ProblemError("sampled inputs have no motion backward in time: t_span must end after it starts.")
    starts = [np.ravel(one.start) for one in inputs]
    waiting = [start for one, start in zip(inputs, starts, strict=True) for _ in range(one.waiting)]
    layout = Layout(problem.q0.size, x0.size, sum(map(np.size, starts)), sum(map(np.size, waiting)))
    none = np.zeros(sum(layout[2:]))
    return {
        "system": extended(problem.system, layout),
        "q0": real_vector("q0", np.concatenate([problem.q0, np.zeros_like(x0), *starts, *waiting])),
        "v0": real_vector("v0", np.concatenate([problem.v0, x0, none])),
        "inputs": inputs,
        "scales": _scales(problem, layout),
    }


def _scales(problem: Problem, layout: Layout) -> Scales:
    """Scales of extended coordinates; that of the integral of a state is its own times the interval."""
    if isinstance(problem.scales, Unscaled):
        return problem.scales
    n, states, inputs, waiting = layout
    of = {name: getattr(problem.scales, name) for name in ("q", "v", "x", "u")}
    q, v, x, u = (np.broadcast_to(of[name], size) for name, size in zip(of, (n, n, states, inputs), strict=True))
    most = np.full(waiting, np.max(u, initial=0.0))
    span = abs(problem.t_span[1] - problem.t_span[0])
    return replace(
        problem.scales, q=np.concatenate([q, x * span, u, most]), v=np.concatenate([v, x, np.ones(inputs + waiting)])
    )


def samples_of(problem: Problem) -> tuple[Event, ...]:
    """Periodic events by which the inputs of an extended problem are sampled."""
    return sampling_events(problem.inputs, problem.system.layout)  # type: ignore[union-attr]


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
    given = _arguments(name, value)
    results = (WITH_VELOCITY if "v" in given and name in WITH_VELOCITY else SIGNATURES)[name].results
    called = _called(value, given, layout)
    rates = (
        _called(declared(inner, "state_rate"), STATE_RATE.arguments, layout) if name == "force" and layout.states else None
    )
    # A reaction that takes states takes velocities, too: states are among them.
    wanted = WITH_VELOCITY[name].arguments if name in WITH_VELOCITY and STATES in _further(value) else given

    def function(*arguments: Any) -> Any:
        named = dict(zip(wanted, arguments, strict=True))
        found = called(named)
        if name in MEASURED:
            return found
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


def _further(function: Any) -> list[str]:
    """Which of states and inputs the function takes."""
    if not callable(function):
        return []
    try:
        parameters = inspect.signature(function).parameters
    except ValueError:  # a function of C
        return []
    return [name for name in (STATES, INPUTS) if name in parameters]


def _arguments(name: str, function: Any) -> tuple[str, ...]:
    """The protocol's arguments of the function before states and inputs."""
    options = [signatures[name].arguments for signatures in (SIGNATURES, WITH_VELOCITY) if name in signatures]
    try:
        count = len(inspect.signature(function).parameters) - len(_further(function))
    except ValueError:
        count = len(options[0])
    return next((one for one in options if len(one) == count), options[0])


def _called(function: Callable[..., Any], given: tuple[str, ...], layout: Layout) -> Callable[[dict[str, Any]], Any]:
    """The function of extended arguments by name."""
    further = _further(function)

    def call(named: dict[str, Any]) -> Any:
        own = [named[one][: layout.n] if one in ("q", "v") else named[one] for one in given]
        more = {STATES: layout.x(named["v"])} if STATES in further else {}
        more |= {INPUTS: layout.u(named["q"])} if INPUTS in further else {}
        return function(*own, **more)

    return call


def _padded(value: Any, letters: str, more: int, xp: Any) -> Any:
    """``value`` with zeros behind every axis of coordinates; None stays None."""
    return None if value is None else xp.pad(xp.asarray(value), [(0, more if one == "n" else 0) for one in letters])


def _with_ones(mass: Any, n: int, more: int, xp: Any) -> Any:
    """The mass matrix with unit masses of the further coordinates."""
    mass = xp.asarray(mass)
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
