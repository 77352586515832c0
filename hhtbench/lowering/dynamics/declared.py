"""A system's declarations: number of constraints, kind of mass, and errors for results of the wrong shape."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from hhtbench.lowering.dynamics.mass import Diagonal
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import WITH_VELOCITY, NumpySystem, System, accepts, declared, reaction_takes_velocity

ROWS = {
    "force": "one entry per coordinate",
    "mass_matrix": "(coordinates, coordinates), or (coordinates,) for a diagonal one",
    "constraint_jacobian": "(constraints, coordinates); row i is the derivative of constraint i",
    "velocity_constraint_jacobian": "(velocity constraints, coordinates); row i is the derivative of constraint i by v",
}
FULL = 256  # coordinates up to which a constant mass is a full matrix of half a megabyte


def expect_physics(system: System | NumpySystem) -> None:
    """Raise unless ``system`` has a force, and Jacobians of its reaction with the same arguments as the reaction."""
    if not callable(declared(system, "force")):
        raise TypeError(f"{type(system).__name__} declares no force(t, q, v); every system needs one.")
    jacobians, with_velocity = declared(system, "reaction_jacobians"), reaction_takes_velocity(system)
    if jacobians is not None and with_velocity and not accepts(jacobians, WITH_VELOCITY["reaction_jacobians"]):
        raise ProblemError(
            "reaction takes (t, q, v, lam), so reaction_jacobians must take them too and return Q_q, Q_v and Q_lam; "
            "it does not accept four arguments."
        )


def rows_of(system: Any, result: Callable[[str], Any]) -> list[int]:
    """Number of position and of velocity constraints, from the results of their functions."""
    sizes = []
    for name in ("constraint", "velocity_constraint"):
        shape = (0,) if declared(system, name) is None else result(name).shape
        if len(shape) != 1:
            raise wrong_shape(name, "(m,), one entry per constraint", shape)
        sizes.append(shape[0])
    return sizes


def mass_kind(system: System | NumpySystem) -> str:
    """Kind of mass for :class:`~.dynamics.Structure`: identity, constant, or variable if it is a function."""
    mass = declared(system, "mass_matrix")
    if mass is None:
        return "identity"
    return "variable" if callable(mass) else "constant"


def mass_as_matrix(mass: Any, n: int, xp: Any) -> Any:
    """A declared constant mass (scalar, ``(n,)`` or ``(n, n)``) as a matrix ``(n, n)``; a large diagonal as Diagonal."""
    if mass is None:
        return None
    mass = xp.asarray(mass, dtype=float)
    if mass.shape == (n, n):
        return mass
    if mass.shape not in ((), (n,)):
        raise wrong_shape("mass_matrix", (n, n), mass.shape)
    diagonal = xp.broadcast_to(mass, (n,))
    return Diagonal(diagonal) if n > FULL else xp.diag(diagonal)


def wrong_shape(function: str, expected: tuple[int, ...] | str, given: Any) -> ProblemError:
    """Error for a result of the wrong shape."""
    hint = f" = {ROWS[function]}" if function in ROWS else ""
    return ProblemError(f"{function} must return shape {expected}{hint}; got {given}. Nothing is broadcast.")


def expect_parts(function: str, value: Any, shapes: tuple[tuple[int, ...], ...]) -> Any:
    """``value``; raises unless it holds as many matrices as ``shapes``."""
    if not isinstance(value, (tuple, list)) or len(value) != len(shapes):
        many, got = {2: "two", 3: "three"}[len(shapes)], type(value).__name__
        got += f" of {len(value)}" if isinstance(value, (tuple, list)) else ""
        raise TypeError(f"{function} must return {many} matrices of shapes {shapes}; got {got}.")
    return value
