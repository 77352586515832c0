"""Check declared derivatives and sparsity patterns against derivatives of the functions.

A wrong force Jacobian only slows Newton down.  A wrong constraint Jacobian or sparsity pattern changes the motion:
these are compared at the start and at two points near it, so that one frozen at the start is found too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from hhtbench.lowering import Dynamics, compile_function, derive, route_of
from hhtbench.lowering.caching import Cache, by_id
from hhtbench.lowering.dynamics.differences import derivative, derivative_along
from hhtbench.lowering.dynamics.dynamics import as_declared
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import NonFiniteValue, ProblemError
from hhtbench.protocol.system import PATTERNS, checked_patterns, declared, full_pattern, signature_of

TRUSTED = 1e-5  # relative difference up to which a declared derivative agrees with the derived one
NEARBY = 1e-2  # relative distance of the other points: a frozen Jacobian is then off by a thousand times TRUSTED
MISSED = 1e-4  # relative difference of directional derivatives from which a pattern lacks an entry
_compared = Cache(64)  # results for JAX systems, whose functions do not change


def value_of(dynamics: Dynamics, name: str, *arguments: Any) -> Any:
    """Value of the function ``name`` of ``dynamics``."""
    return getattr(dynamics, name)(*arguments)


def wrong_derivatives(dynamics: Dynamics, names: tuple[str, ...], t: float, q: Vector, v: Vector) -> list[str]:
    """Names of declared derivatives in ``names`` that disagree with the derived ones."""
    derived = derive(dynamics.system, t, q, v, ignored=names)
    points = list(_points(t, q, v, derived.least))
    return [name for name in names if not all(_agrees(name, dynamics, derived, *at) for at in points)]


def _points(t: float, q: Vector, v: Vector, least: float) -> Iterator[tuple[float, Vector, Vector, bool]]:
    """Yield (t, q, v, defined): the start and two points near it; ``defined``: the system must be finite there."""
    index = np.arange(1.0, q.size + 1)
    moving = v + max(least, float(np.max(np.abs(v)))) * np.cos(index)
    yield t, q, moving, True
    for k, shift in enumerate((np.sin(2.0 * index), np.cos(3.0 * index))):
        size = max(least, float(np.max(np.abs(q))))
        yield t + NEARBY * (k + 1), q + NEARBY * size * shift, moving, False


def _agrees(name: str, dynamics: Dynamics, derived: Any, t: float, q: Vector, v: Vector, defined: bool) -> bool:
    values = {"t": t, "q": q, "v": v, "lam": np.cos(np.arange(1.0, dynamics.structure.m + 1))}
    signature = signature_of(dynamics.system, name)
    arguments = [values[symbol] for symbol in signature.arguments]
    for i in range(len(signature.results)):
        both = [compile_function(part_of, d, name, i) for d in (dynamics, derived)]
        try:
            given, wanted = (function(*arguments) for function in both)
        except (NonFiniteValue, ArithmeticError, ValueError):
            if defined and signature.arguments == ("t", "q"):
                raise
            return True  # at a made-up point the system need not be defined
        if given.size and not _equal(given, wanted):
            return False
    return True


def part_of(dynamics: Dynamics, name: str, i: int, *arguments: Any) -> Any:
    """Component ``i`` of the result of function ``name`` as a flat vector; empty for None."""
    value = as_declared(dynamics, name)(*arguments)
    part = value[i] if isinstance(value, tuple) else value
    return dynamics.xp.zeros(0) if part is None else part.ravel()


def _equal(given: Vector, wanted: Vector) -> bool:
    """True if two derivatives agree where both are finite; others are reported where they are used."""
    both = np.isfinite(given) & np.isfinite(wanted)
    given, size = given[both], np.abs(wanted[both])
    allowed = TRUSTED * (size + max(1.0, float(np.max(size, initial=0.0))))
    return bool((np.abs(given - wanted[both]) <= allowed).all())


def check_sparsity(dynamics: Dynamics, t: float, q: Vector, v: Vector) -> None:
    """Raise unless each declared pattern holds its derivative, compared along one direction at three points.

    Raises
    ------
    TypeError, ProblemError
        They are no mapping; a pattern has an unknown name, the wrong shape or lacks an entry: the message names pattern
        and rows.
    """
    if not checked_patterns(declared(dynamics.system, "sparsity")):
        return

    def compare() -> None:
        for at, place, moving, defined in _points(t, q, v, dynamics.least):
            try:
                _compare_patterns(dynamics, at, place, moving)
            except ProblemError:
                raise
            except Exception:
                if defined:
                    raise

    if route_of(dynamics) == "numpy":
        compare()
    else:
        _compared.find(by_id(dynamics), compare)


def _compare_patterns(dynamics: Dynamics, t: float, q: Vector, v: Vector) -> None:
    direction = np.cos(np.arange(1.0, q.size + 1))
    compared, s = _patterned(dynamics, t, q, v), dynamics.structure
    for name, pattern in checked_patterns(declared(dynamics.system, "sparsity")).items():
        rows, columns = (getattr(s, letter) for letter in PATTERNS[name])
        if np.shape(pattern) != (rows, columns):
            raise ProblemError(f"sparsity[{name!r}] must have shape {(rows, columns)}; got {np.shape(pattern)}.")
        if name not in compared:
            continue
        function, at = compared[name]
        seen = derivative_along(lambda e, f=function, x=at: f(x + e * direction), 0.0, at, direction)  # type: ignore[misc]
        found = derivative(function, at, 4, full_pattern(pattern)) @ direction
        off = np.abs(found - seen) > MISSED * max(1.0, float(np.max(np.abs(seen), initial=0.0)))
        if off.any():
            raise ProblemError(
                f"sparsity[{name!r}] lacks entries that are not zero, in rows {np.flatnonzero(off).tolist()}."
            )


def _patterned(dynamics: Dynamics, t: float, q: Vector, v: Vector) -> dict[str, tuple[Callable[[Vector], Any], Vector]]:
    """For each pattern's name the function of one vector that it describes, and the point of its derivative.

    Multipliers, and vectors multiplied by the mass, are arbitrary.
    """
    s, numbers = dynamics.structure, np.arange(1.0, q.size + 1)
    x, lam = np.sin(numbers), np.cos(np.arange(1.0, s.m + 1))
    call = partial(compile_function, value_of, dynamics, route="xla")
    force = call("force")
    found: dict[str, tuple[Callable[[Vector], Any], Vector]] = {
        "force_q": (lambda y: force(t, y, v), q),
        "force_v": (lambda y: force(t, q, y), v),
    }
    if s.mass == "variable":
        mass = call("mass_product")
        found["mass_matrix"] = (lambda y: mass(t, q, y), x)
        found["mass_product_jacobian"] = (lambda y: mass(t, y, x), q)
    if s.m:
        g, reaction = call("constraint"), call("reaction")
        found["constraint_jacobian"] = (lambda y: g(t, y), q)
        found["reaction_q"] = (lambda y: reaction(t, y, v, lam), q)
        found["reaction_v"] = (lambda y: reaction(t, q, y, lam), v)
    if s.p:
        k = call("velocity_constraint")
        found["velocity_constraint_jacobian"] = (lambda y: k(t, q, y), v)
        found["velocity_constraint_q"] = (lambda y: k(t, y, v), q)
    return found
