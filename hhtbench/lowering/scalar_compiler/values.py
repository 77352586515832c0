"""What a variable holds while a computation is evaluated: known numbers, nodes of the scalar graph, or a reason why not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.lowering.scalar_compiler.errors import NotNative
from hhtbench.lowering.scalar_compiler.graph import FALSE, ONE, TRUE, ZERO, Graph, Ids


@dataclass(frozen=True, eq=False)
class Nodes:
    """An array of nodes that depend on the arguments."""

    ids: Ids
    kind: str  #: "float", "bool", or "int": integers, held as float64 and without overflow

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the array."""
        return self.ids.shape


@dataclass(frozen=True, eq=False)
class Unknown:
    """A result nobody can compute here; it matters only if something needs it."""

    reason: str


Value = np.ndarray | Nodes | Unknown
EXACT = 2.0**53  # integers up to it are float64 numbers


def is_known(value: Value) -> bool:
    """Whether the value is there before any argument is."""
    return isinstance(value, np.ndarray)


def lift(graph: Graph, value: Any) -> Nodes:
    """``value`` as nodes.

    Raises
    ------
    NotNative
        It is unknown, or of a type that has no nodes.
    """
    if isinstance(value, Nodes):
        return value
    if isinstance(value, Unknown):
        raise NotNative(value.reason)
    kind = {"b": "bool", "i": "int", "u": "int"}.get(value.dtype.kind, "float")
    if kind == "float" and value.dtype != np.float64:
        raise NotNative(f"{value.dtype} values")
    if kind == "int":
        _expect_exact(value)
    return Nodes(graph.constants(value), kind)


def numbers(graph: Graph, value: Any) -> Ids:
    """Nodes of a value that must be float64 numbers."""
    nodes = lift(graph, value)
    if nodes.kind != "float":
        raise NotNative("booleans or integers where numbers are needed")
    return nodes.ids


def as_numbers(graph: Graph, value: Nodes) -> Ids:
    """Booleans as 1 and 0, integers as they are."""
    return graph.elementwise("select", value.ids, np.int64(ONE), np.int64(ZERO)) if value.kind == "bool" else value.ids


def folded(graph: Graph, value: Value) -> Value:
    """Nodes that all turned out to be constants, as the values they are."""
    if not isinstance(value, Nodes):
        return value
    nodes, places = np.unique(value.ids, return_inverse=True)
    if any(node not in graph.number and node not in (TRUE, FALSE) for node in nodes.tolist()):
        return value
    if value.kind == "bool":
        return np.asarray(value.ids == TRUE)
    plain = np.array([graph.number[node] for node in nodes.tolist()])
    if value.kind == "int":
        _expect_exact(plain)
        plain = plain.astype(np.int64)
    return np.asarray(plain[places]).reshape(value.shape)


def _expect_exact(whole: np.ndarray) -> None:
    """Raise where float64 does not hold integers exactly."""
    if np.any(np.abs(whole.astype(np.float64)) > EXACT):
        raise NotNative("integers beyond 2**53")
