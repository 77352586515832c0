"""Explain an exception of Python or NumPy by what a problem declares wrongly; imported after one was raised."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import SIGNATURES, Problem, Signature, accepts, declared, signature_of

EVENT = Signature(("t", "q", "v"), ("",))


def raise_wrong_use(problem: Problem, error: Exception) -> None:
    """Raise a TypeError on wrong arguments of a function or a ProblemError on wrong scales, if ``error`` follows from it."""
    if isinstance(error, TypeError):
        for name in SIGNATURES:
            require_arguments(name, declared(problem.system, name), signature_of(problem.system, name), error)
    for name in ("q", "v"):
        shape, wanted = np.shape(getattr(problem.scales, name)), problem.q0.shape
        if shape not in ((), wanted):
            text = f"scales.{name} must be a number or have shape {wanted}, one number per coordinate; got {shape}."
            raise ProblemError(text) from error


def require_arguments(name: str, function: Any, signature: Signature, error: Exception | None = None) -> None:
    """Raise a TypeError unless ``function``, if it is one, can be called with the arguments of ``signature``."""
    if callable(function) and not accepts(function, signature):
        wanted, found = ", ".join(signature.arguments), inspect.signature(function)
        raise TypeError(f"{name} must take the arguments ({wanted}), in this order; it is declared with {found}.") from error


def require_events(events: Callable[..., Any] | Sequence[Any]) -> None:
    """Raise a TypeError unless plain event functions, one or a list, take (t, q, v)."""
    for i, event in enumerate(events if isinstance(events, (list, tuple)) else [events]):
        if inspect.isfunction(event):
            require_arguments(f"events[{i}]", event, EVENT)


def system_as_problem(system: Any) -> TypeError:
    """Return the TypeError for a system given in the place of a problem."""
    return TypeError(
        f"a problem must be a spec or a hhtbench.Problem; got the system {type(system).__name__}. It needs a start and an "
        "interval: hb.Problem(name=..., system=..., t_span=(0.0, 1.0), q0=..., v0=...)."
    )
