"""Find specs that mean the same although one writes out what the other leaves to its defaults."""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import Any, Literal

from hhtbench.catalogue import plugins
from hhtbench.catalogue.registry import load_solver
from hhtbench.catalogue.specs import canonical, parse_spec


def find_alike(kind: Literal["problem", "solver"], text: str, among: Iterable[str]) -> str | None:
    """Return the first of the canonical specs ``among`` that means the same as ``text``, or None.

    Only specs of one registered name are compared; then its module is imported, but no problem is made and no file
    executed.
    """
    wanted = canonical(text)
    some = list(among)
    if wanted in some:
        return wanted
    target = parse_spec(wanted).target
    return next((other for other in some if parse_spec(other).target == target and _alike(kind, wanted, other)), None)


def _alike(kind: str, one: str, other: str) -> bool:
    if parse_spec(one).path is not None:
        return False
    try:
        if kind == "solver":  # their options are compared by the solvers, whose factories may take any
            return bool(load_solver(one) == load_solver(other))
        return _arguments(one) == _arguments(other)
    except Exception:  # noqa: BLE001 - a plugin's own, or a spec it cannot take: its cells tell
        return False


def _arguments(text: str) -> dict[str, Any]:
    """Return all arguments of a problem's factory, defaults included; booleans are marked, so that True differs from 1."""
    spec = parse_spec(text)
    bound = inspect.signature(plugins.load("problem", spec.name)).bind(**spec.arguments)
    bound.apply_defaults()
    return {name: (isinstance(value, bool), value) for name, value in bound.arguments.items()}
