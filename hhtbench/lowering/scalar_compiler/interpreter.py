"""Interpreter of jaxprs that builds the scalar graph, equation by equation.

A variable holds known numbers, nodes of the graph, or the reason why it cannot be computed here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.lowering.jax_internals import ClosedJaxpr, Literal, line_of
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.operations import ELEMENTWISE
from hhtbench.lowering.scalar_compiler.store import FALSE, ONE, TRUE, ZERO, Ids, NotNative, TooLarge

EXACT = 2.0**53  # integers up to it are float64 numbers


@dataclass(frozen=True, eq=False)
class Nodes:
    """An array of nodes that depend on the arguments."""

    ids: Ids
    kind: str  #: "float", "bool", or "int": integers, held as float64 and without overflow


@dataclass(frozen=True, eq=False)
class Unknown:
    """A result that cannot be computed here; an error only if something needs it."""

    reason: str


Value = np.ndarray | Nodes | Unknown
Rule = Callable[..., list[Value]]

RULES: dict[str, Rule] = {}  #: primitive -> rule(ctx, equation, *inputs)


def rule(*names: str) -> Callable[[Rule], Rule]:
    """Registers a rule under the names of primitives."""

    def register(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        return function

    return register


def rule_of_nodes(*names: str, numbers: bool = False) -> Callable[[Callable[..., Ids]], Callable[..., Ids]]:
    """Registers ``function(graph, equation, *ids) -> ids`` for inputs of one kind, or for float64 ``numbers`` only."""

    def register(function: Callable[..., Ids]) -> Callable[..., Ids]:
        @rule(*names)
        def of_values(ctx: Interpreter, equation: Any, *inputs: Value) -> list[Value]:
            ids = list(map(ctx.numbers, inputs)) if numbers else ctx.together(inputs)
            return made(equation, function(ctx.graph, equation, *ids))

        return function

    return register


def _kind(dtype: np.dtype) -> str:
    return {"b": "bool", "i": "int", "u": "int"}.get(dtype.kind, "float")


def nodes(ids: Ids, aval: Any) -> Nodes:
    """``ids`` with the kind of JAX's abstract value ``aval``."""
    return Nodes(ids, _kind(aval.dtype))


def made(equation: Any, *ids: Ids) -> list[Value]:
    """Nodes as the outputs of an equation."""
    return [nodes(part, variable.aval) for part, variable in zip(ids, equation.outvars, strict=True)]


def _expect_exact(whole: np.ndarray) -> None:
    """Raise where float64 does not hold integers exactly."""
    if np.any(np.abs(whole.astype(np.float64)) > EXACT):
        raise NotNative("integers beyond 2**53")


class Interpreter:
    """Evaluates the equations of one computation, as JAX's own interpreters do, into nodes of a graph."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._equations: list[Any] = []  #: that are being evaluated, the innermost last

    def closed(self, closed: Any, arguments: Any) -> list[Value]:
        """The outputs of a jaxpr, with or without its constants, at ``arguments``."""
        jaxpr, consts = (closed.jaxpr, closed.consts) if isinstance(closed, ClosedJaxpr) else (closed, ())
        inputs = *map(np.asarray, consts), *arguments
        environment: dict[Any, Value] = dict(zip((*jaxpr.constvars, *jaxpr.invars), inputs, strict=True))

        def read(atom: Any) -> Value:
            if isinstance(atom, Literal):
                return np.asarray(atom.val, dtype=np.dtype(atom.aval.dtype))  # type: ignore[attr-defined]
            return environment[atom]

        needed = {id(atom) for atom in jaxpr.outvars}
        last = {id(atom): i for i, equation in enumerate(jaxpr.eqns) for atom in equation.invars}
        for i, equation in enumerate(jaxpr.eqns):
            results = self._evaluated(equation, [read(atom) for atom in equation.invars])
            environment.update(zip(equation.outvars, results, strict=True))
            for atom in (*equation.invars, *equation.outvars):  # those of a large system hold millions of nodes
                if last.get(id(atom), i) == i and id(atom) not in needed:
                    environment.pop(atom, None) if not isinstance(atom, Literal) else None
        return [read(atom) for atom in jaxpr.outvars]

    def lift(self, value: Value) -> Nodes:
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
        kind = _kind(value.dtype)
        if kind == "float" and value.dtype != np.float64:
            raise NotNative(f"{value.dtype} values")
        if kind == "int":
            _expect_exact(value)
        return Nodes(self.graph.constants(value), kind)

    def together(self, values: Any) -> list[Ids]:
        """Nodes of several values, which must be of one kind."""
        lifted = [self.lift(value) for value in values]
        if len({value.kind for value in lifted}) != 1:
            raise NotNative("values of two kinds in one array")
        return [value.ids for value in lifted]

    def numbers(self, value: Value) -> Ids:
        """Nodes of a value that must be float64 numbers."""
        nodes = self.lift(value)
        if nodes.kind != "float":
            raise NotNative("booleans or integers where numbers are needed")
        return nodes.ids

    def as_numbers(self, value: Nodes) -> Ids:
        """Booleans as 1 and 0, integers as they are."""
        return (
            self.graph.elementwise("select", value.ids, np.int64(ONE), np.int64(ZERO)) if value.kind == "bool" else value.ids
        )

    def folded(self, value: Value) -> Value:
        """The value of nodes that are all constants; others unchanged."""
        if not isinstance(value, Nodes):
            return value
        nodes, places = np.unique(value.ids, return_inverse=True)
        if any(node not in self.graph.number and node not in (TRUE, FALSE) for node in nodes.tolist()):
            return value
        if value.kind == "bool":
            return np.asarray(value.ids == TRUE)
        plain = np.array([self.graph.number[node] for node in nodes.tolist()])
        if value.kind == "int":
            _expect_exact(plain)
            plain = plain.astype(np.int64)
        return np.asarray(plain[places]).reshape(value.ids.shape)

    def known(self, value: Value) -> np.ndarray:
        """Indices as numbers; raises NotNative if they depend on the arguments."""
        found = self.folded(self.lift(value))
        if not isinstance(found, np.ndarray):
            raise NotNative("a place that depends on the arguments")
        return found

    def _evaluated(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """The outputs of one equation; unknown ones carry the reason."""
        name = equation.primitive.name
        self._equations.append(equation)
        try:
            if equation.effects:
                raise NotNative(f"{name} has an effect beside its value")
            if all(isinstance(value, np.ndarray) for value in inputs):
                return self._folded(equation, inputs) or _bound(equation, inputs)
            if name not in RULES:
                raise NotNative(f"the primitive {name} has no rule")
            return RULES[name](self, equation, *inputs)
        except NotNative as error:
            if not equation.outvars or isinstance(error, TooLarge):
                raise
            reason = error.reason if ", at " in error.reason else f"{error.reason}, at {self._place()}"
            return [Unknown(reason)] * len(equation.outvars)
        finally:
            self._equations.pop()

    def _folded(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """Outputs for known inputs by NumPy or the rule; [] if neither can."""
        name = equation.primitive.name
        results: list[Value] = []
        if name in ELEMENTWISE:
            with np.errstate(all="ignore"):
                results = [np.asarray(ELEMENTWISE[name](*inputs))]
        elif name in RULES:
            try:
                results = [self.folded(value) for value in RULES[name](self, equation, *inputs)]
            except NotNative:
                return []
        if not all(isinstance(value, np.ndarray) for value in results):
            return []
        avals = [variable.aval for variable in equation.outvars[: len(results)]]
        return [np.asarray(value, dtype=aval.dtype).reshape(aval.shape) for value, aval in zip(results, avals, strict=True)]

    def _place(self) -> str:
        """The user's line that made this equation, or the call it is in: a library's inner functions have none."""
        return next((line for equation in reversed(self._equations) if (line := line_of(equation))), "an unknown line")


def _bound(equation: Any, inputs: list[Value]) -> list[Value]:
    """Outputs computed by JAX, which compiles for 20 ms per new shape."""
    results = equation.primitive.bind(*inputs, **equation.params)
    try:
        return [np.asarray(part) for part in (results if equation.primitive.multiple_results else [results])]
    except TypeError as error:  # keys of random numbers
        raise NotNative(f"{equation.primitive.name} gives what NumPy does not know") from error
