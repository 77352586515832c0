"""Descriptions of values that are equal in every process for equal meaning, or none."""

from __future__ import annotations

import dataclasses
import enum
import functools
import hashlib
import sys
import types
from collections import namedtuple
from pathlib import PurePath
from typing import Any

import equinox as eqx
import jax
import numpy as np

SLOTS = (types.MemberDescriptorType, types.GetSetDescriptorType, type(vars(namedtuple("_", "x"))["x"]))


class NotDescribed(Exception):
    """A part whose meaning cannot be told from outside."""


def describe(value: Any, modules: set[str], *, parameters: bool) -> Any:
    """``value`` as nested tuples of plain values; the modules its classes and functions live in go to ``modules``.

    ``parameters``: arrays of real numbers are described by their shape only.

    Raises
    ------
    NotDescribed
        A function or class made inside a function, a closure, an object of unknown kind.
    """
    again = functools.partial(describe, modules=modules, parameters=parameters)
    if value is None or (
        isinstance(value, bool | int | float | complex | str | bytes) and type(value).__module__ == "builtins"
    ):
        return type(value).__name__, repr(value)
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        array = np.asarray(value)
        content = None if parameters and eqx.is_inexact_array(value) else hashlib.sha256(array.tobytes()).hexdigest()
        return "array", array.shape, str(array.dtype), content
    if type(value) in (tuple, list):
        return type(value).__name__, tuple(again(part) for part in value)
    if type(value) is dict:
        return "dict", tuple((again(key), again(part)) for key, part in value.items())
    if type(value) in (set, frozenset):
        return "set", tuple(sorted(repr(again(part)) for part in value))
    if isinstance(value, types.ModuleType):
        modules.add(value.__name__)
        return "module", value.__name__
    if isinstance(value, PurePath):
        return "path", str(value)
    if isinstance(value, np.dtype):
        return "dtype", str(value)
    if isinstance(value, enum.Enum):
        return "enum", again(type(value)), value.name
    if isinstance(value, functools.partial):
        return "partial", again(value.func), again(value.args), again(value.keywords)
    if isinstance(value, types.BuiltinFunctionType) and value.__module__ is None:
        return "builtin", value.__qualname__
    if isinstance(value, np.ufunc):
        return "ufunc", _ufunc(value)
    if isinstance(value, type | types.FunctionType | types.BuiltinFunctionType):
        return "name", _name(value, modules)
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return "tuple", again(type(value)), tuple(again(part) for part in value)
    if dataclasses.is_dataclass(value):
        fields = tuple((f.name, again(getattr(value, f.name, None))) for f in dataclasses.fields(value))
        return "object", again(type(value)), fields
    raise NotDescribed(f"a value of type {type(value).__qualname__}")


def _ufunc(value: np.ufunc) -> str:
    """Module and name; one made of a Python function is in none of these modules."""
    for module in ("numpy", "scipy.special"):
        if getattr(sys.modules.get(module), value.__name__, None) is value:
            return f"{module}.{value.__name__}"
    raise NotDescribed(f"the ufunc {value.__name__} is not one of the libraries'")


def _name(value: Any, modules: set[str]) -> str:
    """Module and name of a class or function, which must be found there."""
    module, name = str(getattr(value, "__module__", None)), str(getattr(value, "__qualname__", "unknown"))
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    if found is not value:
        raise NotDescribed(f"{module}.{name} is not there: it was made inside a function, or replaced")
    if isinstance(value, type):
        for base in value.__mro__[1:]:
            if base is not object:
                modules.add(base.__module__)
    modules.add(module)
    return f"{module}.{name}"


def bytecode(value: Any) -> Any:
    """The code of a function with defaults and closure, or of all functions of a class and its other attributes.

    Raises
    ------
    NotDescribed
        An attribute or something enclosed whose meaning cannot be told.
    """
    if not isinstance(value, type):
        return _code_of(value)
    parts = []
    for name, member in sorted(vars(value).items()):
        code = _code_of(member)
        if code is None and not name.startswith(("__", "_abc_")) and not isinstance(member, SLOTS):
            code = describe(member, set(), parameters=False)
        parts.append((name, code))
    return tuple((name, code) for name, code in parts if code is not None)


def _code_of(value: Any) -> Any:
    for wrapper in ("__func__", "fget", "method", "__wrapped__"):
        inner = getattr(value, wrapper, None)
        if callable(inner):
            value = inner
            break
    code = getattr(value, "__code__", None)
    if not isinstance(code, types.CodeType):
        return None
    if code.co_filename == "<string>":  # written by dataclasses: the fields say the same
        return _code(code)
    given = getattr(value, "__defaults__", None), getattr(value, "__kwdefaults__", None)
    return _code(code), describe(given, set(), parameters=False), _enclosed(value)


def _enclosed(function: Any) -> Any:
    """What a function holds of the function that made it."""
    cells = [_inside(cell) for cell in getattr(function, "__closure__", None) or ()]
    return tuple(_code_of(cell) or describe(cell, set(), parameters=False) for cell in cells)


def _inside(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:
        raise NotDescribed("something enclosed has no value yet") from None


def _code(code: types.CodeType) -> Any:
    """Instructions, constants and names."""
    constants = tuple(_constant(constant) for constant in code.co_consts)
    return code.co_code, constants, code.co_names, code.co_varnames, code.co_freevars


def _constant(value: Any) -> Any:
    if isinstance(value, types.CodeType):
        return _code(value)
    if isinstance(value, tuple):
        return tuple(_constant(part) for part in value)
    if isinstance(value, frozenset):
        return tuple(sorted(repr(part) for part in value))
    return repr(value)
