"""Problems with first-order states and held inputs, on extended coordinates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hhtbench.protocol.arguments import real_vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event, make_events
from hhtbench.protocol.extended import Layout, extended, states_and_inputs
from hhtbench.protocol.sampled import Sampled, sampling_events
from hhtbench.protocol.scales import Scales, Unscaled
from hhtbench.protocol.system import declared

if TYPE_CHECKING:
    from hhtbench.protocol.problem import Problem


def extended_fields(problem: Problem) -> dict[str, Any]:
    """Fields of the problem on extended coordinates; what is extended already stays.

    Raises
    ------
    ProblemError, TypeError
        States or inputs do not fit the system.
    """
    inputs = tuple(problem.inputs) if isinstance(problem.inputs, (list, tuple)) else (problem.inputs,)
    for i, one in enumerate(inputs):
        if not isinstance(one, Sampled):
            raise TypeError(f"inputs[{i}] must be a hhtbench.Sampled; got {type(one).__name__}.")
    if inputs and problem.t_span[1] < problem.t_span[0]:
        raise ProblemError("sampled inputs have no motion backward in time: t_span must end after it starts.")
    known, inner = declared(problem.system, "layout"), getattr(problem.system, "inner", problem.system)
    x0 = np.zeros(0) if problem.x0 is None else real_vector("x0", problem.x0)
    if known is None and (declared(inner, "state_rate") is None) != (x0.size == 0):
        raise ProblemError("first-order states need state_rate(t, q, v, x) of the system, and x0= of the problem.")
    starts = [np.ravel(one.start) for one in inputs]
    waiting = [start for one, start in zip(inputs, starts, strict=True) for _ in range(one.waiting)]
    n = problem.q0.size if known is None or problem.q0.size != known.size else known.n
    layout = Layout(n, x0.size, sum(map(np.size, starts)), sum(map(np.size, waiting)))
    if known not in (None, layout):
        raise ProblemError("the states or inputs have other sizes or delays than before; make a new Problem of the system.")
    q0, v0 = problem.q0, problem.v0
    if q0.size == n:
        q0 = np.concatenate([q0, np.zeros_like(x0), *starts, *waiting])
    found: dict[str, Any] = {"x0": x0 if x0.size else None, "inputs": inputs, "scales": _scales(problem, layout)}
    found |= {"q0": real_vector("q0", q0), "v0": real_vector("v0", np.concatenate([v0[:n], x0, np.zeros(sum(layout[2:]))]))}
    if known is not None:
        return found
    given = [name for name in ("exact", "reference", "minimal") if getattr(problem, name) is not None]
    if given:
        raise ProblemError(f"a problem with states or sampled inputs takes no {given[0]}.")
    sketch = problem.sketch
    found["observables"] = {name: _own(function, n) for name, function in problem.observables.items()}
    found["sketch"] = None if sketch is None else lambda q: sketch(q[:n])
    return found | {"system": extended(problem.system, layout)}


def restart(problem: Problem, q0: Any, v0: Any) -> dict[str, Any]:
    """Fields of a start of an extended problem: ``q0``, ``v0`` (or None) of own or of extended size."""
    layout, found = problem.system.layout, {}  # type: ignore[union-attr]
    for name, given in (("q0", q0), ("v0", v0)):
        vector = real_vector(name, getattr(problem, name) if given is None else given)
        if vector.size not in (layout.n, layout.size):
            raise ProblemError(
                f"{name} must have shape ({layout.n},), or ({layout.size},) with states and inputs; got {vector.shape}."
            )
        whole = vector.size == layout.size
        found[name] = vector if whole else np.concatenate([vector, getattr(problem, name)[layout.n :]])
    return found | {"x0": layout.x(found["v0"]) if layout.states else None}


def _own(function: Callable[..., Any], n: int) -> Callable[..., Any]:
    return lambda t, q, v, lam: function(t, q[:n], v[:n], lam)


def _scales(problem: Problem, layout: Layout) -> Scales:
    """Scales of extended coordinates; that of the integral of a state is its own times the interval."""
    if isinstance(problem.scales, Unscaled) or np.shape(problem.scales.q) == (layout.size,) != (layout.n,):
        return problem.scales
    n, states, inputs, waiting = layout
    parts = []
    for name, size in (("q", n), ("v", n), ("x", states), ("u", inputs)):
        value = np.asarray(getattr(problem.scales, name), float)
        if value.shape not in ((), (size,)):
            raise ProblemError(f"scales.{name} must be a number or have shape ({size},); got {value.shape}.")
        parts.append(np.broadcast_to(value, size))
    q, v, x, u = parts
    span, most = abs(problem.t_span[1] - problem.t_span[0]), np.full(waiting, np.max(u, initial=0.0))
    return replace(
        problem.scales, q=np.concatenate([q, x * span, u, most]), v=np.concatenate([v, x, np.ones(inputs + waiting)])
    )


def samples_of(problem: Problem) -> tuple[Event, ...]:
    """Periodic events by which the inputs of an extended problem are sampled."""
    return sampling_events(problem.inputs, problem.system.layout)  # type: ignore[union-attr]


def extended_events(given: Any, layout: Layout) -> tuple[Event, ...]:
    """Events of own coordinates on extended ones; their functions may also take ``x`` and ``u``.

    A change returns (q, v), or (q, v, x).
    """
    return tuple(
        replace(
            event,
            function=_event_function(event, layout),
            change=None if event.change is None else _change(event, layout),
        )
        for event in make_events(given)
    )


def _event_function(event: Event, layout: Layout) -> Callable[..., Any]:
    function, n = event.function, layout.n
    if event.takes_multipliers:
        return lambda t, q, v, lam, mu: function(t, q[:n], v[:n], lam, mu)
    names = states_and_inputs(function, 3)
    if not names:
        return lambda t, q, v: function(t, q[:n], v[:n])
    return lambda t, q, v: function(t, q[:n], v[:n], **layout.given(names, q, v))


def _change(event: Event, layout: Layout) -> Callable[..., Any]:
    change: Any = event.change
    n, names = layout.n, states_and_inputs(change, 3)

    def changed(t: float, q: Any, v: Any) -> Any:
        found = change(t, q[:n], v[:n], **layout.given(names, q, v))
        if not isinstance(found, (tuple, list)) or len(found) not in (2, 3):
            return found
        x = layout.x(v) if len(found) == 2 else found[2]
        return np.concatenate([found[0], q[n:]]), np.concatenate([found[1], x, v[n + layout.states :]])

    return changed
