"""Explain wrong declarations of systems, problems and events; imported where there is one, or after an exception."""

from __future__ import annotations

import dataclasses
import inspect
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import STATE
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import DECLARABLE, SIGNATURES, Signature, accepts, declared, near_name, signature_of


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
            require_arguments(f"events[{i}]", event, STATE)


def system_as_problem(system: Any) -> TypeError:
    """Return the TypeError for a system given in the place of a problem."""
    return TypeError(
        f"a problem must be a spec or a hhtbench.Problem; got the system {type(system).__name__}. It needs a start and an "
        "interval: hb.Problem(name=..., system=..., t_span=(0.0, 1.0), q0=..., v0=...)."
    )


def without_annotation(kind: type, name: str) -> TypeError:
    """Return the error for a field of a System class that is assigned without a type annotation."""
    return TypeError(
        f"{kind.__name__}: {name} has no type annotation; write `{name}: object = hb.parameter(...)` in the class."
    )


def without_default(kind: type, name: str, first: str) -> TypeError:
    """Return the error for the field ``name`` without a default after ``first``, which has one."""
    return TypeError(
        f"{kind.__name__}: {name} has no default and comes after {first}, which has one. "
        f"Give {name} a default, hb.parameter(1.0), or declare it before {first}."
    )


def in_other_order(owner: str, name: str, wanted: Sequence[str], found: Sequence[str]) -> TypeError:
    """Return the error for a function ``name`` with the protocol's arguments in another order."""
    return TypeError(
        f"{owner}: {name} must take the arguments ({', '.join(wanted)}), in this order; "
        f"it is declared with ({', '.join(found)})."
    )


def assigned(kind: type, name: str) -> dataclasses.FrozenInstanceError:
    """Return the error for an assignment to ``name`` of a system."""
    if name in {field.name for field in dataclasses.fields(kind)}:
        mend = f"a system is not changed after it is made; make a new one: dataclasses.replace(system, {name}=...)"
    else:
        mend = f"it is no field; write `{name}: object = hb.parameter()` in the class, and {kind.__name__}({name}=...)"
    return dataclasses.FrozenInstanceError(f"{kind.__name__}: cannot assign to {name}: {mend}.")


def unknown_names(unknown: Sequence[str]) -> TypeError:
    """Return the error for keywords that a NumpySystem does not know."""
    meant = sorted({near for name in unknown if (near := near_name(name))})
    hint = f" Did you mean {' and '.join(meant)}?" if meant else ""
    return TypeError(f"NumpySystem does not know {', '.join(unknown)}; known: {', '.join(DECLARABLE)}.{hint}")
