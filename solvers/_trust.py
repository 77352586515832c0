"""What a user declares about derivatives, compared with what follows from the functions, before it is believed.

A wrong force Jacobian only slows Newton down.  A wrong constraint Jacobian or a wrong sparsity pattern changes the
motion: they are compared at the start and at two points near it, so that one frozen at the start is found too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.errors import NonFiniteValue, ProblemError
from hhtbench.lowering import Dynamics, compile_function, derive, route_of
from hhtbench.lowering.dynamics.differences import derivative_along
from hhtbench.protocol import DERIVATIVES, SIGNATURES, declared

TRUSTED = 1e-5  # relative difference up to which a declared derivative agrees with the derived one
NEARBY = 1e-2  # relative distance of the other points: a frozen Jacobian is then off by a thousand times TRUSTED
MISSED = 1e-4  # relative difference along a direction from which an entry is missing in a pattern
EQUATIONS = tuple(name for name in DERIVATIVES if name != "force_jacobians")  # derivatives that enter the equations


def as_arguments(dynamics: Dynamics, *values: Any) -> list[Any]:
    """``values`` as the functions of ``dynamics`` take them when they are called outside compiled code."""
    return list(values) if dynamics.xp is np else [dynamics.xp.asarray(value, dtype=float) for value in values]


def wrong_derivatives(dynamics: Dynamics, names: tuple[str, ...], t: float, q: Vector, v: Vector) -> list[str]:
    """Those of ``names``, declared derivatives that enter the equations, that disagree with the derived ones."""
    if not names:
        return []
    derived = derive(dynamics.system, t, q, v, ignored=names)
    return [name for name in names if not all(_agrees(name, dynamics, derived, *at) for at in _points(t, q, v))]


def _points(t: float, q: Vector, v: Vector) -> Iterator[tuple[float, Vector, Vector, bool]]:
    """The start and two points near it; true where the system must be defined.  No velocity entry is at rest."""
    index = np.arange(1.0, q.size + 1)
    moving = v + max(1.0, float(np.max(np.abs(v)))) * np.cos(index)
    yield t, q, moving, True
    for k, shift in enumerate((np.sin(2.0 * index), np.cos(3.0 * index))):
        size = max(1.0, float(np.max(np.abs(q))))
        yield t + NEARBY * (k + 1), q + NEARBY * size * shift, moving, False


def _agrees(name: str, dynamics: Dynamics, derived: Any, t: float, q: Vector, v: Vector, defined: bool) -> bool:
    values = {"t": t, "q": q, "v": v, "lam": np.cos(np.arange(1.0, dynamics.structure.m + 1))}
    signature = SIGNATURES[name]
    arguments = [values[symbol] for symbol in signature.arguments]
    for i in range(len(signature.results)):
        both = [compile_function(part_of, d, name, i) for d in (dynamics, derived)]
        try:
            given, wanted = (function(*arguments) for function in both)
        except (NonFiniteValue, ArithmeticError, ValueError) as error:
            if (defined and signature.arguments == ("t", "q")) or not _always(type(error), both, arguments):
                raise
            return True  # at a made-up point the system need not be defined
        if given.size and not _equal(given, wanted):
            return False
    return True


def part_of(dynamics: Dynamics, name: str, i: int, *arguments: Any) -> Any:
    """Matrix ``i`` of what the function ``name`` returns, or its only array, as one vector; None has no entries."""
    value = getattr(dynamics, name)(*arguments)
    part = value[i] if isinstance(value, tuple) else value
    return dynamics.xp.zeros(0) if part is None else part.ravel()


def _always(kind: type[Exception], functions: list[Callable[..., Any]], arguments: list[Any]) -> bool:
    """Whether the error comes again at the same point; one that does not is tried again by the caller."""
    try:
        for function in functions:
            function(*arguments)
    except kind:
        return True
    return False


def _equal(given: Vector, wanted: Vector) -> bool:
    """Whether two derivatives are equal where both are finite; one that is not is found and named where it is used."""
    both = np.isfinite(given) & np.isfinite(wanted)
    given, size = given[both], np.abs(wanted[both])
    allowed = TRUSTED * (size + max(1.0, float(np.max(size, initial=0.0))))
    return bool((np.abs(given - wanted[both]) <= allowed).all())


def check_sparsity(dynamics: Dynamics, t: float, q: Vector, v: Vector) -> None:
    """Raise unless every declared pattern holds the derivative it is for, seen along one direction.

    Raises
    ------
    ProblemError
        A pattern has the wrong shape or lacks an entry; the text names pattern and rows.
    """
    if route_of(dynamics) != "numpy" or not declared(dynamics.system, "sparsity"):
        return
    direction = np.cos(np.arange(1.0, q.size + 1))
    compared = _patterned(dynamics, t, q, v)
    for name, pattern in declared(dynamics.system, "sparsity").items():
        if name not in compared:
            continue
        function, at, matrix = compared[name]
        wanted = (np.size(function(at)), q.size)
        if np.shape(pattern) != wanted:
            raise ProblemError(f"sparsity[{name!r}] must have shape {wanted}; got {np.shape(pattern)}.")
        seen = derivative_along(lambda e, f=function, x=at: f(x + e * direction), 0.0, at, direction)  # type: ignore[misc]
        off = np.abs(matrix() @ direction - seen) > MISSED * max(1.0, float(np.max(np.abs(seen), initial=0.0)))
        if off.any():
            raise ProblemError(
                f"sparsity[{name!r}] lacks entries that are not zero, in rows {np.flatnonzero(off).tolist()}."
            )


Patterned = tuple[Callable[[Vector], Any], Vector, Callable[[], Matrix]]


def _patterned(dynamics: Dynamics, t: float, q: Vector, v: Vector) -> dict[str, Patterned]:
    """For each pattern's name: a function, the point of its derivative, and that derivative made with the pattern."""
    d, s = dynamics, dynamics.structure
    found: dict[str, Patterned] = {
        "force_q": (lambda x: d.force(t, x, v), q, lambda: d.force_jacobians(t, q, v)[0]),
        "force_v": (lambda x: d.force(t, q, x), v, lambda: d.force_jacobians(t, q, v)[1]),
    }
    if declared(d.system, "force_jacobians") is not None:
        found.clear()  # the patterns of the force are not used
    if s.m:
        found["constraint_jacobian"] = (lambda x: d.constraint(t, x), q, lambda: d.constraint_jacobian(t, q))
    if s.p:
        k, k_v = d.velocity_constraint, d.velocity_constraint_jacobian
        found["velocity_constraint_jacobian"] = (lambda x: k(t, q, x), v, lambda: k_v(t, q, v))
        by_q = d.velocity_constraint_position_jacobian
        found["velocity_constraint_q"] = (lambda x: k(t, x, v), q, lambda: by_q(t, q, v))
    return found
