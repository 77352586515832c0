"""Systems from Lagrange's equations of SymPy (``sympy.physics.mechanics.LagrangesMethod``)."""

from __future__ import annotations

import keyword
import types
from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp

from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import DECLARABLE, System, parameter

OF_POSITION = {  # functions without velocities, and what to do where there are some
    "mass_matrix": "a Lagrangian must be quadratic in them",
    "constraint": "give what holds velocities as nonhol_coneqs",
}


def from_sympy(method: Any, values: Mapping[Any, float], name: str = "Lagrange") -> System:
    """Make a System from SymPy's ``LagrangesMethod``: ``M(t, q) q'' = F(t, q, q')`` with its constraints.

    Its parameters are the symbols of the expressions, with their names: ``dataclasses.replace(system, m=2.0)`` changes one
    without a new compilation.  The multipliers' sign is that of :class:`~hhtbench.System`: ``Q = -g_q^T lam``.

    Parameters
    ----------
    method
        A ``LagrangesMethod``; ``form_lagranges_equations`` is called if it was not yet.  Its holonomic constraints become
        ``constraint``, its nonholonomic ones ``velocity_constraint``.
    values
        The number of every symbol in it (or of its name) [SI].
    name
        Name of the new system class, used in messages.

    Raises
    ------
    ProblemError
        A symbol has no value or a name that no parameter can have; a value belongs to no symbol; the mass matrix or a
        holonomic constraint depends on velocities.
    """
    import sympy
    from sympy.physics.mechanics import LagrangesMethod, dynamicsymbols

    if not isinstance(method, LagrangesMethod):
        raise TypeError(f"from_sympy takes a sympy.physics.mechanics.LagrangesMethod; got {type(method).__name__}.")
    if method.eom is None:
        method.form_lagranges_equations()
    t, q = dynamicsymbols._t, list(method.q)
    v = [x.diff(t) for x in q]
    holonomic = method._hol_coneqs
    taken = {
        "mass_matrix": method.mass_matrix[:, : len(q)],
        "force": method.forcing,
        "constraint": holonomic,
        "velocity_constraint": method.coneqs[len(holonomic) :, :] if len(method.coneqs) > len(holonomic) else (),
    }
    expressions = {title: sympy.Matrix(found) for title, found in taken.items() if len(found)}
    symbols = sorted(set().union(*(found.free_symbols for found in expressions.values())) - {t}, key=str)
    numbers = _numbers(symbols, values)
    places = [[sympy.Dummy(f"{letter}{i}") for i in range(len(q))] for letter in "qv"]
    of_q, of_v = (dict(zip(names, dummies, strict=True)) for names, dummies in zip((q, v), places, strict=True))
    namespace: dict[str, Any] = {
        "__doc__": "Lagrange's equations, made by SymPy.",
        "__module__": __name__,
        "__annotations__": dict.fromkeys(numbers, object),
        **{symbol: parameter(number) for symbol, number in numbers.items()},
    }
    for title, found in expressions.items():
        plain = found.subs(of_v).subs(of_q)
        if left := _of_time(plain, t):
            raise ProblemError(f"{title} has {_listed(left)}, which are neither coordinates nor their velocities.")
        if title in OF_POSITION and plain.free_symbols & set(of_v.values()):
            raise ProblemError(f"{title} depends on velocities; {OF_POSITION[title]}.")
        function = sympy.lambdify([t, *places, symbols], plain, "jax", cse=True)
        namespace[title] = _method(function, tuple(numbers), title)
    made = types.new_class(name, (System,), exec_body=lambda body: body.update(namespace))
    return made()


def _of_time(expression: Any, t: Any) -> set[Any]:
    """Return the undefined functions of time in ``expression``, and their derivatives."""
    import sympy
    from sympy.core.function import AppliedUndef

    return {x for x in expression.atoms(AppliedUndef, sympy.Derivative) if x.has(t)}


def _numbers(symbols: list[Any], values: Mapping[Any, float]) -> dict[str, float]:
    """Return the parameters' values by name, sorted; raise if a symbol has no value or a value no symbol."""
    given = {str(symbol): value for symbol, value in values.items()}
    wanted = [str(symbol) for symbol in symbols]
    if twice := sorted({word for word in wanted if wanted.count(word) > 1}):
        raise ProblemError(f"several symbols are called {', '.join(twice)}; give each a name of its own.")
    if missing := sorted(set(wanted) - set(given)):
        raise ProblemError(f"values lacks {', '.join(missing)}; it has {', '.join(sorted(given)) or 'nothing'}.")
    if strange := sorted(set(given) - set(wanted)):
        raise ProblemError(
            f"values has {', '.join(strange)}, which no equation has; these have {', '.join(wanted) or 'no symbol'}."
        )
    for word in wanted:
        if not word.isidentifier() or keyword.iskeyword(word) or word in DECLARABLE or word.startswith("_"):
            raise ProblemError(f"the symbol {word!r} cannot be the name of a parameter; rename it.")
    return {word: real_number(f"values[{word}]", given[word]) for word in wanted}


def _method(function: Any, parameters: tuple[str, ...], title: str) -> Any:
    """Wrap ``function(t, q, v, parameters)`` as the method ``title`` of a system; a column (k, 1) becomes a vector (k,)."""

    def full(self: Any, t: Any, q: Any, v: Any) -> Any:
        found = jnp.asarray(function(t, q, v, [getattr(self, name) for name in parameters]), dtype=jnp.float64)
        return found if title == "mass_matrix" else found[:, 0]

    def of_position(self: Any, t: Any, q: Any) -> Any:
        return full(self, t, q, jnp.zeros_like(q))

    return of_position if title in OF_POSITION else full


def _listed(found: set[Any]) -> str:
    return ", ".join(sorted(map(str, found)))
