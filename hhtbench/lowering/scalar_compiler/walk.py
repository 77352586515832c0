"""Reads a jaxpr equation by equation and writes it into the scalar graph."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hhtbench.lowering.jax_internals import ClosedJaxpr, Literal, line_of
from hhtbench.lowering.scalar_compiler.graph import Graph
from hhtbench.lowering.scalar_compiler.reasons import NotNative, TooLarge
from hhtbench.lowering.scalar_compiler.values import Unknown, Value, is_known

Rule = Callable[..., list[Value]]

RULES: dict[str, Rule] = {}  #: primitive -> rule(walk, equation, *inputs), for inputs that are not all known
KNOWN: dict[str, Callable[..., Any]] = {}  #: primitive -> NumPy function(parameters, *arrays), for known inputs


def rule(*names: str) -> Callable[[Rule], Rule]:
    """Registers a rule under the names of primitives."""

    def register(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        return function

    return register


class Walk:
    """One reading of one computation."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self._calls: list[Any] = []  #: equations whose inner computation is being read

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
                return _evaluate(equation, inputs)
            if found is None:
                raise NotNative(f"the primitive {name} has no rule")
            if name not in ACCEPTS_UNKNOWN:
                missing = next((value for value in inputs if isinstance(value, Unknown)), None)
                if missing is not None:
                    return [missing] * len(equation.outvars)
            return found(self, equation, *inputs)
        except NotNative as error:
            if not equation.outvars or isinstance(error, TooLarge):
                raise
            reason = error.reason if ", at " in error.reason else f"{error.reason}, at {self._place(equation)}"
            return [Unknown(reason)] * len(equation.outvars)

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
    "checkpoint": "jaxpr",
    "closed_call": "call_jaxpr",
    "core_call": "call_jaxpr",
    "custom_jvp_call": "call_jaxpr",
    "custom_vjp_call": "call_jaxpr",
    "custom_vjp_call_jaxpr": "fun_jaxpr",
    "jit": "jaxpr",
    "pjit": "jaxpr",
    "remat": "jaxpr",
    "remat2": "jaxpr",
}
ACCEPTS_UNKNOWN = ("custom_linear_solve", "scan", "cond", "optimization_barrier")


def _evaluate(equation: Any, inputs: list[Value]) -> list[Value]:
    """All inputs are known: NumPy, else JAX itself (which compiles, 20 ms a new shape)."""
    function = KNOWN.get(equation.primitive.name)
    avals = [variable.aval for variable in equation.outvars]
    if function is not None:
        with np.errstate(all="ignore"):
            result = function(equation, *inputs)
        return [np.asarray(result, dtype=avals[0].dtype).reshape(avals[0].shape)]
    results = equation.primitive.bind(*inputs, **equation.params)
    return [np.asarray(part) for part in (results if equation.primitive.multiple_results else [results])]
