"""Check shapes: call every declared function once at the start and compare its result with the protocol."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.checks.problem.rows import attempt, not_measured, yes_or_fault
from hhtbench.protocol.arguments import real_values
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.evidence import Row
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import (
    DECLARABLE,
    DERIVATIVES,
    PATTERNS,
    PHYSICS,
    Signature,
    System,
    checked_patterns,
    declared,
    signature_of,
)
from hhtbench.protocol.wrong_use import require_arguments

MEASURED = ("energy", "power", "invariants")  # no solver uses them
MEANING = {"m": "constraints", "p": "velocity constraints"}


@dataclass(frozen=True)
class Survey:
    """Result of the shape check of all declared functions."""

    rows: tuple[Row, ...]
    faults: dict[str, str]  #: function -> what is wrong with it

    @property
    def blocking(self) -> str:
        """Why nothing can be derived from the system; empty string if it can."""
        names = [name for name in self.faults if name in PHYSICS and name not in MEASURED]
        return "; ".join(f"{name} is faulty (row shape/{name})" for name in names)

    @property
    def untrusted(self) -> tuple[str, ...]:
        """Declared derivatives that cannot be used."""
        return tuple(name for name in self.faults if name in DERIVATIVES)


def survey(problem: Problem) -> Survey:
    """Call every declared function of the system once, at the start (a JAX function is traced, not run)."""
    system = problem.system
    sizes: dict[str, int | None] = {"n": problem.q0.size, "m": 0, "p": 0}
    rows, faults = {}, {}
    for letter, name in (("m", "constraint"), ("p", "velocity_constraint")):
        if declared(system, name) is not None:
            result = attempt(lambda name=name: _call(problem, name, sizes))  # type: ignore[misc]
            shape: tuple[int, ...] = () if result.fault else np.shape(result.value)
            sizes[letter] = shape[0] if len(shape) == 1 else None
    for name in DECLARABLE:
        if name == "force" or declared(system, name) is not None:
            rows[name] = _row(problem, name, sizes)
            if not rows[name].passed:
                faults[name] = str(rows[name].measured)
    return Survey(tuple(rows.values()), faults)


def _row(problem: Problem, name: str, sizes: dict[str, int | None]) -> Row:
    row_id = f"shape/{name}"
    if name == "sparsity":
        fault, bound = _pattern_fault(declared(problem.system, "sparsity"), sizes), "known names, fitting shapes"
        return yes_or_fault(row_id, "sparsity gives boolean patterns by name", fault, "fits", bound)
    signature = signature_of(problem.system, name)
    bound = "a dict of real scalars" if name == "invariants" else _bound(signature, sizes)
    claim = f"{name}({', '.join(signature.arguments)}) returns {bound}"
    missing = [MEANING[x] for x, size in sizes.items() if size is None and x in _letters(name, signature)]
    if missing:
        return not_measured(row_id, claim, bound, f"the number of {missing[0]} is not known, their function is faulty")
    if name == "mass_matrix" and not callable(declared(problem.system, name)):
        claim = f"mass_matrix is a scalar, (n,) or {bound}"
        n = sizes["n"]
        outcome = attempt(lambda: _array_fault(np.asarray(declared(problem.system, name)), (), (n,), (n, n)))
    elif not callable(declared(problem.system, name)):
        return yes_or_fault(row_id, claim, "no such function is declared", "", bound)
    else:
        if name == "mass_matrix":
            claim += ", or its diagonal (n,)"
        outcome = attempt(lambda: _fault(name, _call(problem, name, sizes), signature, sizes))
    return yes_or_fault(row_id, claim, outcome.fault or outcome.value, bound, bound)


def _letters(name: str, signature: Signature) -> str:
    """Return the sizes that a function's arguments and result need; constraint and velocity_constraint define m and p."""
    own = {"constraint": "m", "velocity_constraint": "p"}.get(name, "")
    needed = "".join(signature.results) + {"lam": "m", "mu": "p"}.get(signature.arguments[-1], "")
    return needed.replace(own, "") if own else needed


def _bound(signature: Signature, sizes: dict[str, int | None]) -> str:
    texts = [
        str(tuple(x if sizes[x] is None else sizes[x] for x in letters)).replace("'", "") for letters in signature.results
    ]
    if len(texts) == 1:
        return texts[0]
    return f"{', '.join(texts)}, three matrices" if len(texts) == 3 else f"a pair of {texts[0]} and {texts[1]}"


def arguments_at_start(problem: Problem, name: str, sizes: dict[str, int | None]) -> tuple[Any, ...]:
    """Return t0 and private, read-only copies of the arguments of ``name``; multipliers from their guess if it fits, else
    zero.
    """
    values: dict[str, Any] = {"q": problem.q0, "v": problem.v0}
    for letter, key, guess in (("m", "lam", problem.lam_guess), ("p", "mu", problem.mu_guess)):
        size = sizes[letter] or 0
        values[key] = guess if guess is not None and guess.size == size else np.zeros(size)
    names = signature_of(problem.system, name).arguments[1:]
    if isinstance(problem.system, System):
        return (jnp.asarray(problem.t_span[0]), *(jnp.asarray(values[key]) for key in names))
    copies = [np.array(values[key]) for key in names]
    for copy in copies:
        copy.setflags(write=False)
    return (problem.t_span[0], *copies)


def _call(problem: Problem, name: str, sizes: dict[str, int | None]) -> Any:
    function = declared(problem.system, name)
    require_arguments(name, function, signature_of(problem.system, name))
    arguments = arguments_at_start(problem, name, sizes)
    return jax.eval_shape(function, *arguments) if isinstance(problem.system, System) else function(*arguments)


def _fault(name: str, result: Any, signature: Signature, sizes: dict[str, int | None]) -> str:
    """Describe what is wrong with ``result``; empty string if it is right."""
    if name == "invariants":
        if not isinstance(result, dict):
            return f"got {type(result).__name__}"
        return next((f"{key}: {fault}" for key, value in result.items() if (fault := _array_fault(value, ()))), "")
    shapes = [tuple(sizes[x] for x in letters) for letters in signature.results]
    if len(shapes) == 1:
        return _array_fault(result, shapes[0], *([(sizes["n"],)] if name == "mass_matrix" else []))
    if not isinstance(result, (tuple, list)) or len(result) != len(shapes):
        return f"got {type(result).__name__}"
    faults = [_array_fault(value, shape) for value, shape in zip(result, shapes, strict=True) if value is not None]
    return next(filter(None, faults), "")


def _array_fault(value: Any, *shapes: tuple[int | None, ...]) -> str:
    """Describe why ``value`` is not a real array of one of the ``shapes``; empty string if it is."""
    if value is None:
        return "got None"
    if isinstance(value, jax.ShapeDtypeStruct) and value.dtype.kind not in "fiu":
        return f"got dtype {value.dtype}"
    given = value.shape if isinstance(value, jax.ShapeDtypeStruct) else real_values("the result", value).shape
    return "" if given in shapes else f"got shape {given}"


def _pattern_fault(sparsity: Any, sizes: dict[str, int | None]) -> str:
    try:
        patterns = checked_patterns(sparsity)
    except (TypeError, ProblemError) as error:
        return str(error)
    for name, pattern in patterns.items():
        expected = tuple(sizes[x] for x in PATTERNS[name])
        if np.shape(pattern) != expected:
            return f"{name} must have shape {expected}; got {np.shape(pattern)}"
    return ""
