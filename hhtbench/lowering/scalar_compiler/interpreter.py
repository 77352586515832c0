"""An interpreter of jaxprs that writes into the scalar graph, equation by equation."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hhtbench.lowering.jax_internals import ClosedJaxpr, Literal, line_of
from hhtbench.lowering.scalar_compiler.errors import NotNative, TooLarge
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.operations import ELEMENTWISE
from hhtbench.lowering.scalar_compiler.values import Unknown, Value, folded, is_known

Rule = Callable[..., list[Value]]

RULES: dict[str, Rule] = {}  #: primitive -> rule(ctx, equation, *inputs)


def rule(*names: str) -> Callable[[Rule], Rule]:
    """Registers a rule under the names of primitives."""

    def register(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        return function

    return register


class Interpreter:
    """Evaluates the equations of one computation, as JAX's own interpreters do, into nodes of a graph."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._calls: list[Any] = []  #: equations whose inner computation is being evaluated

    def run(self, jaxpr: Any, consts: Sequence[Value], arguments: Sequence[Value]) -> list[Value]:
        """The outputs of ``jaxpr`` at ``arguments``."""
        environment: dict[Any, Value] = {}
        environment.update(zip(jaxpr.constvars, consts, strict=True))
        environment.update(zip(jaxpr.invars, arguments, strict=True))

        def read(atom: Any) -> Value:
            if isinstance(atom, Literal):
                return np.asarray(atom.val, dtype=np.dtype(atom.aval.dtype))  # type: ignore[attr-defined]
            return environment[atom]

        for equation in jaxpr.eqns:
            results = self.equation(equation, [read(atom) for atom in equation.invars])
            environment.update(zip(equation.outvars, results, strict=True))
        return [read(atom) for atom in jaxpr.outvars]

    def closed(self, closed: Any, arguments: Sequence[Value]) -> list[Value]:
        """The same for a jaxpr with or without its constants."""
        if isinstance(closed, ClosedJaxpr):
            return self.run(closed.jaxpr, [np.asarray(const) for const in closed.consts], arguments)
        return self.run(closed, (), arguments)

    def equation(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """The outputs of one equation; unknown ones carry the reason."""
        name = equation.primitive.name
        found = RULES.get(name)
        try:
            if equation.effects:
                raise NotNative(f"{name} has an effect beside its value")
            if name in CALLS:
                return self._called(equation, inputs)
            if all(is_known(value) for value in inputs):
                return self._folded(equation, inputs) or _bound(equation, inputs)
            if found is None:
                raise NotNative(f"the primitive {name} has no rule")
            return found(self, equation, *inputs)
        except NotNative as error:
            if not equation.outvars or isinstance(error, TooLarge):
                raise
            reason = error.reason if ", at " in error.reason else f"{error.reason}, at {self._place(equation)}"
            return [Unknown(reason)] * len(equation.outvars)

    def _folded(self, equation: Any, inputs: list[Value]) -> list[Value]:
        """The outputs for known inputs by NumPy, or by the rule, which folds; none where it does not know."""
        name = equation.primitive.name
        found, results = RULES.get(name), list[Value]()
        if name in ELEMENTWISE:
            with np.errstate(all="ignore"):
                results = [np.asarray(ELEMENTWISE[name](*inputs))]
        elif found is not None:
            try:
                results = [folded(self.graph, value) for value in found(self, equation, *inputs)]
            except NotNative:
                return []
        if not all(is_known(value) for value in results):
            return []
        avals = [variable.aval for variable in equation.outvars[: len(results)]]
        return [value.astype(aval.dtype).reshape(aval.shape) for value, aval in zip(results, avals, strict=True)]  # type: ignore[union-attr]

    def _called(self, equation: Any, inputs: list[Value]) -> list[Value]:
        self._calls.append(equation)
        try:
            return self.closed(equation.params[CALLS[equation.primitive.name]], inputs)
        finally:
            self._calls.pop()

    def _place(self, equation: Any) -> str:
        """The user's line that made this equation, or the call it is in: a library's inner functions have none."""
        for candidate in (equation, *reversed(self._calls)):
            if where := line_of(candidate):
                return where
        return "an unknown line"


CALLS = {  # primitives that only wrap a computation, and the parameter that holds it
    "closed_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "jit": "jaxpr",
    "remat2": "jaxpr",
}


def _bound(equation: Any, inputs: list[Value]) -> list[Value]:
    """By JAX itself, which compiles: 20 ms a new shape."""
    results = equation.primitive.bind(*inputs, **equation.params)
    return [np.asarray(part) for part in (results if equation.primitive.multiple_results else [results])]
