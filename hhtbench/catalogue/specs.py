"""Specs: a name or a file with keyword arguments, as one line of text.

``planar_chain(n_links=100)``, ``my_file.py:problem(k=1)``, ``hht(alpha=-1/3, reaction=midpoint)``: the same in
Python, on the command line and in run keys.  Values are Python literals, arithmetic of numbers, or bare words,
which mean strings; nothing is executed.
"""

from __future__ import annotations

import ast
import math
import operator
import re
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hhtbench.protocol.errors import ProblemError

EXAMPLES = "planar_chain(n_links=100), my_file.py:problem(k=1) or hht(alpha=-1/3, reaction=midpoint)"
MOST_BITS = 4096  # bits of a whole number: 9**9**9 must be refused, not computed
_parsing = threading.Lock()  # CPython 3.11 and 3.12 count the parser's depth over all threads: gh-106905

# Tried in this order, and not greedy: a string argument may hold ".py:word", a folder's name may hold a quote.
_TARGETS = (
    re.compile(r"(?P<path>[^'\"]+?\.py):(?P<attribute>[^\W\d]\w*)(?P<arguments>\(.*\))?$"),
    re.compile(r"(?P<name>\w[\w.-]*)(?P<arguments>\(.*\))?$"),
    re.compile(r"(?P<path>.+?\.py):(?P<attribute>[^\W\d]\w*)(?P<arguments>\(.*\))?$"),
)

_SIGNS: dict[type, Callable[[Any], Any]] = {ast.UAdd: operator.pos, ast.USub: operator.neg}
_ARITHMETIC: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv,
    ast.Mod: operator.mod,
}


@dataclass(frozen=True, kw_only=True)
class Spec:
    """A parsed spec: name or file attribute, and keyword arguments; ``str`` gives the canonical form."""

    name: str  #: registered name, or the attribute of ``path``
    path: str | None = None  #: Python file that holds the attribute; None: a registered name
    arguments: Mapping[str, Any] = field(default_factory=dict)

    @property
    def target(self) -> str:
        """The spec without its arguments."""
        return self.name if self.path is None else f"{self.path}:{self.name}"

    def __str__(self) -> str:
        if not self.arguments:
            return self.target
        return f"{self.target}({', '.join(f'{k}={_canonical(k, v)}' for k, v in sorted(self.arguments.items()))})"


def parse_spec(text: str) -> Spec:
    """Parse a spec.

    Raises
    ------
    TypeError
        ``text`` is not a string.
    ProblemError
        It cannot be read; the text shows where and gives an example.
    """
    if not isinstance(text, str):
        raise TypeError(f"a spec must be a string such as {EXAMPLES}; got {type(text).__name__}.")
    text = text.strip()
    if not text.isprintable():
        raise ProblemError(f"a spec must be one line of printable text; got {text!r}.\nFor example: {EXAMPLES}.")
    match = None
    for target in _TARGETS:
        if match := target.match(text):
            break
    if match is None or (match.groupdict().get("name") or "").endswith(".py"):
        raise _bad_target(text)
    parts = match.groupdict()
    arguments = _arguments(text, match.start("arguments")) if parts["arguments"] else {}
    return Spec(name=parts.get("name") or parts["attribute"], path=parts.get("path"), arguments=arguments)


def canonical(text: str) -> str:
    """Return the canonical form of a spec: sorted keywords, values as ``repr`` writes them."""
    return str(parse_spec(text))


def _canonical(name: str, value: Any) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, str)) or (isinstance(value, float) and math.isfinite(value)):
        return repr(value)
    if isinstance(value, (list, tuple)):
        entries = ", ".join(_canonical(name, entry) for entry in value)
        closing = ",)" if isinstance(value, tuple) and len(value) == 1 else ")"
        return f"[{entries}]" if isinstance(value, list) else f"({entries}{closing}"
    raise ProblemError(
        f"{name}={value!r} has no form in a spec; use finite numbers, strings, True, False, None, lists or tuples."
    )


def _bad_target(text: str) -> ProblemError:
    if not text:
        return ProblemError(f"a spec must not be empty; for example {EXAMPLES}.")
    file = re.match(r"(.+?\.py)(\(.*\))?$", text)
    if file:
        return ProblemError(f"{file[1]} is a file; add the name of the problem in it, for example {file[1]}:problem(k=1).")
    opening = re.match(r"(.+?\.py:)?[\w.-]*", text)
    place = opening.end() if opening else 0
    if place == 0 or not text[place:].startswith("("):
        return _unreadable(text, place, "a name or FILE.py:name was expected here")
    if ")" not in text:
        return _unreadable(text, len(text), "the closing parenthesis is missing")
    return _unreadable(text, text.rindex(")") + 1, "nothing may follow the closing parenthesis")


def _arguments(text: str, start: int) -> dict[str, Any]:
    """Parse the keyword arguments in ``text[start:]``, which runs from "(" to ")"."""
    shift = start - 1  # "f" stands for the name, so that columns differ by this
    try:
        with _parsing:
            call = ast.parse("f" + text[start:], mode="eval").body
    except SyntaxError as error:
        raise _unreadable(text, shift + max((error.offset or 1) - 1, 1), error.msg) from error
    except (RecursionError, MemoryError) as error:
        raise _unreadable(text, start, "it is nested too deeply") from error
    if not isinstance(call, ast.Call) or not isinstance(call.func, ast.Name):
        raise _unreadable(text, start, "the arguments must end with the one closing parenthesis")
    for node in call.args:
        raise _unreadable(text, shift + _column(text, start, node), "arguments are given by name, as in k=1")
    values = {}
    for keyword in call.keywords:
        if keyword.arg is None:
            raise _unreadable(text, shift + _column(text, start, keyword), "arguments are given by name, as in k=1")
        if keyword.arg in values:
            raise _unreadable(text, shift + _column(text, start, keyword), f"{keyword.arg} is given twice")
        try:
            values[keyword.arg] = _value(text, start, keyword.value)
        except RecursionError as error:
            raise _unreadable(text, shift + _column(text, start, keyword), "it has too many terms") from error
    return values


def _value(text: str, start: int, node: ast.expr) -> Any:
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, (ast.List, ast.Tuple)):
        entries = [_value(text, start, entry) for entry in node.elts]
        return entries if isinstance(node, ast.List) else tuple(entries)
    if isinstance(node, ast.Constant) and (node.value is None or isinstance(node.value, (bool, str))):
        return node.value
    number = _number(text, start, node)
    if isinstance(number, int) and number.bit_length() > MOST_BITS:
        raise _unreadable(text, start - 1 + _column(text, start, node), "a whole number is too large")
    if isinstance(number, float) and not math.isfinite(number):
        raise _unreadable(text, start - 1 + _column(text, start, node), "a number must be finite")
    return number


def _number(text: str, start: int, node: ast.expr) -> int | float:
    place = start - 1 + _column(text, start, node)
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)) and not isinstance(node.value, bool):
        return node.value
    try:
        if isinstance(node, ast.UnaryOp) and type(node.op) in _SIGNS:
            return _SIGNS[type(node.op)](_number(text, start, node.operand))
        if isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
            return _ARITHMETIC[type(node.op)](_number(text, start, node.left), _number(text, start, node.right))
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow):
            return _power(_number(text, start, node.left), _number(text, start, node.right))
    except ArithmeticError as error:
        raise _unreadable(text, place, f"this cannot be computed ({error})") from error
    raise _unreadable(
        text, place, "a value must be a number, a string, a bare word, True, False, None, or a list or tuple of these"
    )


def _power(base: int | float, exponent: int | float) -> int | float:
    if isinstance(base, int) and isinstance(exponent, int) and base.bit_length() * abs(exponent) > MOST_BITS:
        raise OverflowError("the power is too large")
    result = base**exponent
    if isinstance(result, complex):
        raise ArithmeticError("the root of a negative number is not real")
    return result


def _column(text: str, start: int, node: ast.expr | ast.keyword) -> int:
    """Return the column of ``node`` in characters; ``ast`` counts bytes of UTF-8."""
    return len(("f" + text[start:]).encode()[: node.col_offset].decode())


def _unreadable(text: str, place: int, reason: str) -> ProblemError:
    return ProblemError(f"cannot read this spec: {reason}.\n    {text}\n    {' ' * place}^\nFor example: {EXAMPLES}.")
