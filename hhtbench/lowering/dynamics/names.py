"""Names of a System that are nearly names of the protocol, and that nothing reads: a declaration that would do nothing."""

from __future__ import annotations

from collections.abc import Iterator
from difflib import get_close_matches
from functools import lru_cache
from inspect import get_annotations
from types import CodeType, FunctionType
from typing import Any

from hhtbench.errors import ProblemError
from hhtbench.protocol import DECLARABLE, System

LIKE = 0.8  # of difflib: "constraints" is 0.95 like "constraint", "force_limit" 0.63 like "force"
WHOLE = {"mass": "mass_matrix", "jacobian": "constraint_jacobian", "gradient": "constraint_jacobian", "forces": "force"}


@lru_cache(maxsize=256)
def expect_names(kind: type) -> None:
    """Raise if the class ``kind`` of a system declares a name that nothing reads and that is near one of the protocol.

    Raises
    ------
    ProblemError
        It does; the text gives the right name.
    """
    own = [base for base in kind.__mro__ if issubclass(base, System) and base is not System]
    names = {name for base in own for name in (*vars(base), *get_annotations(base))}
    read = {name for base in own for value in vars(base).values() for name in _names_in(value)}
    for name in sorted(names - read - set(DECLARABLE) - set(dir(System))):
        near = WHOLE.get(name) or next(iter(get_close_matches(name, DECLARABLE, 1, LIKE)), None)
        if near and not name.startswith("_"):
            raise ProblemError(
                f"{kind.__name__} declares {name}, which nothing reads; the protocol's name is {near}. Rename it, or choose "
                "a name that is not so near."
            )


def _names_in(value: Any) -> Iterator[str]:
    """Names that the code of a method, property or other function refers to."""
    for function in (value, *(getattr(value, part, None) for part in ("fget", "func", "__func__", "__wrapped__", "method"))):
        if isinstance(function, FunctionType):
            yield from _names_of(function.__code__)


def _names_of(code: CodeType) -> Iterator[str]:
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names_of(constant)
