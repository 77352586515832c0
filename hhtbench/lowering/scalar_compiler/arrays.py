"""Simplification rules for arrays of nodes (k,); the same as those of :class:`~.graph.Graph` for single nodes."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hhtbench.lowering.scalar_compiler.operations import COMMUTATIVE, FOLDS, LOGIC
from hhtbench.lowering.scalar_compiler.store import BOOLEAN, CODES, FALSE, FEW, TRUE, ZERO, Ids

AT_ONCE = 2**18  # entries of an array that are worked on together: what lies between takes a hundred bytes each

Graph = Any  # this module is a part of it
Case = tuple[Any, Callable[[Ids], Ids]]


def entrywise(graph: Graph, name: str, *operands: Ids) -> Ids:
    """``graph.apply`` for every entry, by array rules where possible."""
    rule, count = RULES.get(name), operands[0].size
    if rule is None or count <= FEW:
        return alone(graph, name, *operands)
    parts = [slice(first, first + AT_ONCE) for first in range(0, count, AT_ONCE)]
    return np.concatenate([rule(graph, *(x[part] for x in operands)) for part in parts])


def alone(graph: Graph, name: str, *operands: Ids) -> Ids:
    """``graph.apply`` for every entry, one after the other."""
    apply = partial(graph.apply, name)
    return np.fromiter(map(apply, *(x.tolist() for x in operands)), dtype=np.int32, count=operands[0].size)


def _folded(graph: Graph, name: str, *operands: Ids) -> Ids:
    """Fold an operation on constants, few of which are distinct."""
    entries, which = np.unique(np.stack(operands), axis=1, return_inverse=True)
    return alone(graph, name, *entries)[which]


class _Seen(NamedTuple):
    """Properties of operands that rules test."""

    known: np.ndarray  #: they are constants
    value: np.ndarray  #: value of known nodes; else NaN
    negative: np.ndarray  #: they are the negative ...
    inner: Ids  #: ... of these


def _seen(graph: Graph, x: Ids) -> _Seen:
    code, inner = graph.column("code")[x], graph.column("x")[x]
    known, value = code == CODES["constant"], np.full(x.size, np.nan)
    value[known] = graph.column("values")[inner[known]]
    return _Seen(known, value, code == CODES["neg"], inner)


def _by_cases(count: int, *cases: Case) -> Ids:
    """(count,) nodes; each entry by the first case that holds, called with the indices of its entries."""
    result, left = np.empty(count, dtype=np.int32), np.ones(count, dtype=bool)
    for holds, give in cases:
        places = np.flatnonzero(left & holds)
        if places.size:
            result[places] = give(places)
            left[places] = False
    return result


def _made(graph: Graph, name: str, *operands: Ids) -> Ids:
    """Nodes of an operation that no rule simplifies."""
    if name in ("add", "mul", *COMMUTATIVE):
        operands = np.minimum(*operands), np.maximum(*operands)
    return np.asarray(graph.each(name, *operands))


def _neg(graph: Graph, x: Ids) -> Ids:
    a = _seen(graph, x)
    return _by_cases(
        x.size,
        (a.known, lambda i: _folded(graph, "neg", x[i])),
        (a.negative, lambda i: a.inner[i]),
        (True, lambda i: _made(graph, "neg", x[i])),
    )


def _add(graph: Graph, x: Ids, y: Ids) -> Ids:
    a, b = _seen(graph, x), _seen(graph, y)
    return _by_cases(
        x.size,
        (a.value == 0.0, lambda i: y[i]),
        (b.value == 0.0, lambda i: x[i]),
        (a.known & b.known, lambda i: _folded(graph, "add", x[i], y[i])),
        (b.negative, lambda i: _sub(graph, x[i], b.inner[i])),
        (a.negative, lambda i: _sub(graph, y[i], a.inner[i])),
        (True, lambda i: _made(graph, "add", x[i], y[i])),
    )


def _sub(graph: Graph, x: Ids, y: Ids) -> Ids:
    a, b = _seen(graph, x), _seen(graph, y)
    return _by_cases(
        x.size,
        (a.known & b.known, lambda i: _folded(graph, "sub", x[i], y[i])),
        (a.value == 0.0, lambda i: _neg(graph, y[i])),
        (b.value == 0.0, lambda i: x[i]),
        (b.negative, lambda i: _add(graph, x[i], b.inner[i])),
        (True, lambda i: _made(graph, "sub", x[i], y[i])),
    )


def _mul(graph: Graph, x: Ids, y: Ids) -> Ids:
    a, b = _seen(graph, x), _seen(graph, y)
    return _by_cases(
        x.size,
        (a.known & b.known, lambda i: _folded(graph, "mul", x[i], y[i])),
        ((a.value == 0.0) | (b.value == 0.0), lambda i: np.full(i.size, ZERO)),
        (a.value == 1.0, lambda i: y[i]),
        (b.value == 1.0, lambda i: x[i]),
        (a.value == -1.0, lambda i: _neg(graph, y[i])),
        (b.value == -1.0, lambda i: _neg(graph, x[i])),
        (a.negative & b.negative, lambda i: _mul(graph, a.inner[i], b.inner[i])),
        (a.negative, lambda i: _neg(graph, _mul(graph, a.inner[i], y[i]))),
        (b.negative, lambda i: _neg(graph, _mul(graph, x[i], b.inner[i]))),
        (True, lambda i: _made(graph, "mul", x[i], y[i])),
    )


def _div(graph: Graph, x: Ids, y: Ids) -> Ids:
    a, b = _seen(graph, x), _seen(graph, y)
    mantissa, exponent = np.frexp(b.value)
    binary = (np.abs(mantissa) == 0.5) & (np.abs(exponent) < 1000)
    return _by_cases(
        x.size,
        (a.known & b.known, lambda i: _folded(graph, "div", x[i], y[i])),
        (binary, lambda i: _mul(graph, x[i], graph.constants(1.0 / b.value[i]))),
        (a.value == 0.0, lambda i: np.full(i.size, ZERO)),
        (a.negative, lambda i: _neg(graph, _div(graph, a.inner[i], y[i]))),
        (True, lambda i: _made(graph, "div", x[i], y[i])),
    )


def _select(graph: Graph, predicate: Ids, yes: Ids, no: Ids) -> Ids:
    code = graph.column("code")
    ruled = (code[predicate] == CODES["not"]) | BOOLEAN[code[yes]]
    del code
    return _by_cases(
        yes.size,
        ((predicate == TRUE) | (yes == no), lambda i: yes[i]),
        (predicate == FALSE, lambda i: no[i]),
        (ruled, lambda i: alone(graph, "select", predicate[i], yes[i], no[i])),
        (True, lambda i: _made(graph, "select", predicate[i], yes[i], no[i])),
    )


def _plain(name: str, graph: Graph, *operands: Ids) -> Ids:
    known = np.logical_and.reduce([_seen(graph, x).known for x in operands])
    return _by_cases(
        known.size,
        (known, lambda i: _folded(graph, name, *(x[i] for x in operands))),
        (True, lambda i: _made(graph, name, *(x[i] for x in operands))),
    )


WITH_RULES = (
    "abs",
    "clamp",
    "max",
    "min",
    "pow",
    "sign",
    "square",
    *LOGIC,
)  # beyond folding; those without one here go one by one
RULES: dict[str, Callable[..., Ids]] = {
    **{name: partial(_plain, name) for name in set(FOLDS).difference(WITH_RULES)},
    "add": _add,
    "add_any": _add,
    "div": _div,
    "mul": _mul,
    "neg": _neg,
    "select": _select,
    "square": lambda graph, x: _mul(graph, x, x),
    "sub": _sub,
}
