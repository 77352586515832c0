"""Detect declarations whose name is nearly one of the protocol's and that nothing reads."""

from __future__ import annotations

import dis
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from inspect import get_annotations
from types import CodeType, FunctionType, ModuleType
from typing import Any

from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import DECLARABLE, NumpySystem, System, near_name

INSIDE = ("__wrapped__", "__func__", "fget", "func")  # where decorators keep the function that they wrap
LOADS = ("LOAD_ATTR", "LOAD_METHOD", "LOAD_SUPER_ATTR", "LOAD_GLOBAL", "LOAD_NAME")
BY_NAME = {"vars", "__dict__", "fields", "asdict", "getattr", "tree"}  # code that loads them may read any field


@lru_cache(maxsize=256)
def expect_names(kind: type) -> None:
    """Raise if the class ``kind`` of a system declares a name that nothing reads and that is near one of the protocol.

    Raises
    ------
    ProblemError
        It does; the message gives the right name.
    """
    given = {*System.__mro__, NumpySystem}
    own = [base for base in kind.__mro__ if base not in given]
    names = {name for base in own for name in (*vars(base), *get_annotations(base)) if not name.startswith("_")}
    near = {name: right for name in names - {*DECLARABLE} if (right := near_name(name))}
    made_from_formulas = (kind.__module__ or "").startswith("hhtbench.")  # and reads its fields in these
    if not near or made_from_formulas:
        return
    read = {name for base in own for member, value in vars(base).items() for name in _read(member, value)}
    if read & BY_NAME:
        return
    for name in sorted(near.keys() - read):
        raise ProblemError(
            f"{kind.__name__} declares {name}, which nothing reads; the protocol's name is {near[name]}. Rename it, or "
            "choose a name that is not so near."
        )


def _read(member: str, value: Any) -> set[str]:
    """Names that the ``member`` of a class reads, except itself, in its own code and in functions that it calls."""
    read, seen, found = set[str](), set[FunctionType](), list(_functions(value))
    while found:
        function = found.pop()
        if function not in seen:
            seen.add(function)
            names = set(_loaded(function.__code__))
            beside = [function.__globals__.get(name) for name in names] + _enclosed(function)
            beside += [getattr(x, name, None) for x in beside if isinstance(x, ModuleType) for name in names]
            package = (function.__module__ or "").partition(".")[0]
            found += [x for x in beside if isinstance(x, FunctionType) and (x.__module__ or "").partition(".")[0] == package]
            read |= names
    return read - {member}


def _functions(value: Any) -> Iterator[FunctionType]:
    """Yield the Python functions in ``value``: itself, and those that decorators wrap."""
    if isinstance(value, FunctionType):
        yield value
    for name in INSIDE:
        inner = getattr(value, name, None)
        if isinstance(inner, FunctionType):
            yield from _functions(inner)


def _enclosed(function: FunctionType) -> list[Any]:
    """Values of the closure of ``function``, as far as they are bound."""
    found = []
    for cell in function.__closure__ or ():
        with suppress(ValueError):
            found.append(cell.cell_contents)
    return found


def _loaded(code: CodeType) -> Iterator[str]:
    """Yield names that ``code`` and functions within it load; names that are only stored are not read."""
    for instruction in dis.get_instructions(code):
        if instruction.opname in LOADS:
            yield instruction.argval
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _loaded(constant)
        elif isinstance(constant, str):  # as getattr takes it
            yield constant
