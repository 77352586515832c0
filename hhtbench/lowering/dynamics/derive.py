"""``derive``: from a System to its Dynamics, with shapes checked and dependencies read."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Vector, real_values, traced
from hhtbench.counting import preparing
from hhtbench.errors import ProblemError
from hhtbench.lowering.caching import Cache, by_id, same
from hhtbench.lowering.compile.compiling import TRACED_AS_VALUE, explain_control_flow
from hhtbench.lowering.dynamics.differences import least_size, uncommon_decade
from hhtbench.lowering.dynamics.dynamics import Structure
from hhtbench.lowering.dynamics.jax_dynamics import JaxDynamics
from hhtbench.lowering.dynamics.mass import Diagonal, compact, inverse_of
from hhtbench.lowering.dynamics.names import expect_names
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics, expect_parts, wrong_shape
from hhtbench.lowering.dynamics.reductions import generalised
from hhtbench.lowering.jax_internals import used_inputs
from hhtbench.protocol import (
    DERIVATIVES,
    SIGNATURES,
    WITH_VELOCITY,
    NumpySystem,
    System,
    accepts,
    declared,
    reaction_takes_velocity,
    signature_of,
)

FULL = 256  # coordinates up to which a constant mass is a full matrix: half a megabyte
_ways: dict[type, Callable[[Any], Hashable]] = {}  # of comparing values, by their kind
_derived = Cache(64)  # reading a structure costs a trace for each function of the system


def derive(
    system: System | NumpySystem,
    t: float,
    q: Vector,
    v: Vector,
    *,
    ignored: tuple[str, ...] = (),
    without: tuple[str, ...] = (),
) -> JaxDynamics | NumpyDynamics:
    """Every derived function of ``system``, uncompiled.

    Parameters
    ----------
    t, q, v
        A point, for the sizes: (n,) arrays.
    ignored
        Declared derivatives that are derived afresh instead of used.
    without
        Names of ``REDUCTIONS`` that are not read off the system.

    Raises
    ------
    ProblemError
        A declared function returns the wrong shape; the text names it and both shapes.  Or Python control flow looks at a
        value that JAX traces; the text names the line.
    TypeError
        A declared function returns something that is not a real array, or nothing declares ``force``.
    """
    expect_names(type(system))  # type: ignore[arg-type] # classes are hashable
    if issubclass(type(system), System):  # of an object equinox would be asked for its class
        key = by_id(system), parameters_of(system), np.shape(q), ignored, without
        found: JaxDynamics = _derived.find(key, lambda: _derive_jax(system, t, q, v, ignored, without))  # type: ignore[arg-type] # it is one
        return found
    if isinstance(system, NumpySystem):
        _expect_physics(system)
        return _derive_numpy(system, t, q, v, ignored, without)
    raise TypeError(f"expected a System or a NumpySystem; got {type(system).__name__}.")


def parameters_of(value: Any) -> Hashable:
    """What a system holds, to be compared: arrays that their owner may change by their bytes, all else by identity.

    Of what a function or another object in a field refers to nothing can be seen.
    """
    return _ways.get(type(value), _found_way)(value)


def _found_way(value: Any) -> Hashable:
    """:func:`parameters_of` of the first value of its kind: to ask for kinds takes longer than all else here."""
    kind = type(value)  # of an object equinox would be asked for its class, and for every attribute
    way = _ways[kind] = next((way for kinds, way in COMPARED if issubclass(kind, kinds)), by_id if value is None else same)
    return way(value)


def _of_values(values: Iterable[Any]) -> Hashable:
    return tuple([_ways.get(type(value), _found_way)(value) for value in values])


COMPARED: tuple[tuple[Any, Callable[[Any], Hashable]], ...] = (
    (np.ndarray, lambda x: (x.shape, x.dtype.str, x.tobytes())),
    ((eqx.Module, NumpySystem), lambda x: parameters_of(object.__getattribute__(x, "__dict__"))),
    (dict, lambda x: (tuple(x), _of_values(x.values()))),
    ((tuple, list), _of_values),
)


def _expect_physics(system: System | NumpySystem) -> None:
    if not callable(declared(system, "force")):
        raise TypeError(f"{type(system).__name__} declares no force(t, q, v); every system needs one.")
    jacobians, with_velocity = declared(system, "reaction_jacobians"), reaction_takes_velocity(system)
    if jacobians is not None and with_velocity and not accepts(jacobians, WITH_VELOCITY["reaction_jacobians"]):
        raise ProblemError(
            "reaction takes (t, q, v, lam), so reaction_jacobians must take them too and return Q_q, Q_v and Q_lam; "
            "it does not accept four arguments."
        )


def _derive_jax(
    system: System, t: float, q: Vector, v: Vector, ignored: tuple[str, ...], without: tuple[str, ...]
) -> JaxDynamics:
    _expect_physics(system)
    if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(system)):
        raise traced(f"a parameter of {type(system).__name__}")
    with preparing("starting JAX"):  # where this is its first use
        place = jnp.asarray(t, dtype=float), jnp.asarray(q), jnp.asarray(v)
    try:
        structure = _structure(system, *place, ignored)
        with preparing("evaluating mass_matrix"):
            mass: Any = declared(system, "mass_matrix") if structure.mass == "constant" else None
            constant = mass_as_matrix(mass(*place[:2]) if callable(mass) else mass, structure.n, jnp)
            constant = compact(constant, jnp) if constant is not None and structure.n > FULL else constant
            return JaxDynamics(system, generalised(structure, without), ignored, constant, inverse_of(constant, jnp))
    except TRACED_AS_VALUE as error:
        raise explain_control_flow(error, system) from error


def _structure(system: Any, t: Any, q: Any, v: Any, ignored: tuple[str, ...]) -> Structure:
    at = {"t": t, "q": q, "v": v}
    _expect(system, "force", at, q.size)
    m, p = _rows(system, lambda name: abstract_result(system, name, at))
    with preparing("evaluating mass_matrix"):
        mass = _mass_kind(system)
    if mass == "variable":
        if abstract_result(system, "mass_matrix", at).shape != (q.size,):
            _expect(system, "mass_matrix", at, q.size)
        mass = "variable" if any(used_arguments(system.mass_matrix, t, q)) else "constant"
    general = Structure(n=q.size, m=m, p=p, mass=mass, reaction_uses_v=reaction_takes_velocity(system))
    plain = JaxDynamics(system=system, structure=general, ignored=ignored)
    at |= {"lam": jnp.zeros(m), "mu": jnp.zeros(p)}
    for name in ("reaction", "velocity_reaction", *DERIVATIVES):
        if plain.gives(name):
            _expect(system, name, at, q.size, m, p)
    _, force_uses_q, force_uses_v = used_arguments(system.force, t, q, v)
    declares_g_t = declared(system, "constraint_time_derivative") is not None
    return replace(
        general,
        force_uses_q=force_uses_q,
        force_uses_v=force_uses_v,
        rheonomic=m > 0 and (used_arguments(plain.constraint, t, q)[0] or declares_g_t),
        linear_reaction=_is_linear(system, "reaction", at) and _is_linear(system, "velocity_reaction", at),
        velocity_jacobian_uses_v=p > 0 and used_arguments(plain.velocity_constraint_jacobian, t, q, v)[2],
        velocity_reaction_uses_v=p > 0 and used_arguments(plain.velocity_reaction, t, q, v, jnp.zeros(p))[2],
    )


def _derive_numpy(
    system: NumpySystem, t: float, q: Vector, v: Vector, ignored: tuple[str, ...], without: tuple[str, ...]
) -> NumpyDynamics:
    def result(name: str) -> np.ndarray:
        copies = [np.array({"q": q, "v": v}[symbol], dtype=np.float64) for symbol in SIGNATURES[name].arguments[1:]]
        for copy in copies:
            copy.setflags(write=False)
        return real_values(f"{name} result", getattr(system, name)(float(t), *copies))

    m, p = _rows(system, result)
    linear = declared(system, "reaction") is None and declared(system, "velocity_reaction") is None
    uses_v = reaction_takes_velocity(system)
    structure = Structure(n=np.size(q), m=m, p=p, mass=_mass_kind(system), linear_reaction=linear, reaction_uses_v=uses_v)

    def made() -> NumpyDynamics:
        mass = declared(system, "mass_matrix") if structure.mass == "constant" else None
        constant = mass_as_matrix(mass, structure.n, np)
        found = NumpyDynamics(system, generalised(structure, without), ignored, constant, inverse_of(constant, np))
        return replace(found, least=least_size(_differenced(found, t, v), q))

    key = by_id(system), parameters_of(system), structure, ignored, without, uncommon_decade(q)
    found: NumpyDynamics = _derived.find(key, made)
    return found


def _differenced(dynamics: NumpyDynamics, t: float, v: Vector) -> Iterator[Callable[[Vector], Any]]:
    """Declared functions of q whose derivatives are not declared."""
    gives = dynamics.gives
    if not gives("force_jacobians"):
        yield lambda q: dynamics.force(t, q, v)
    if gives("constraint") and not (gives("constraint_jacobian") and gives("constraint_acceleration")):
        yield lambda q: dynamics.constraint(t, q)
    if gives("velocity_constraint"):  # nothing declares its derivative by q
        yield lambda q: dynamics.velocity_constraint(t, q, v)
    if gives("mass_matrix"):
        yield lambda q: dynamics.mass(t, q).ravel()


def _rows(system: Any, result: Callable[[str], Any]) -> list[int]:
    """How many position and velocity constraints there are, by what their functions return."""
    sizes = []
    for name in ("constraint", "velocity_constraint"):
        shape = (0,) if declared(system, name) is None else result(name).shape
        if len(shape) != 1:
            raise wrong_shape(name, "(m,), one entry per constraint", shape)
        sizes.append(shape[0])
    return sizes


def _mass_kind(system: System | NumpySystem) -> str:
    mass = declared(system, "mass_matrix")
    if mass is None:
        return "identity"
    return "variable" if callable(mass) else "constant"


def _is_linear(system: System, name: str, at: dict[str, Any]) -> bool:
    """Whether a reaction is linear in the multipliers: its Jacobian does not use them."""
    function: Any = declared(system, name)
    arguments = [at[symbol] for symbol in signature_of(system, name).arguments]
    if function is None or not arguments[-1].size:
        return True
    return not used_arguments(jax.jacfwd(function, len(arguments) - 1), *arguments)[-1]


def _expect(system: System, name: str, at: dict[str, Any], n: int, m: int = 0, p: int = 0) -> None:
    """Raise unless the declared JAX function returns what the sizes ask for."""
    signature = signature_of(system, name)
    shapes = signature.shapes(n, m, p)
    if len(shapes) == 1:
        results = [abstract_result(system, name, at)]
    else:
        arguments = (at[symbol] for symbol in signature.arguments)
        results = expect_parts(name, jax.eval_shape(getattr(system, name), *arguments), shapes)
    for result, shape in zip(results, shapes, strict=True):
        if result is not None and result.shape != shape:
            raise wrong_shape(name, shape, result.shape)


def abstract_result(system: System, name: str, at: dict[str, Any]) -> jax.ShapeDtypeStruct:
    """Shape and type that a declared JAX function returns at a place, found without running it.

    Raises
    ------
    TypeError
        It returns something that is not one real array.
    """
    try:
        with preparing(f"tracing {name}"):
            arguments = (at[symbol] for symbol in signature_of(system, name).arguments)
            result = jax.eval_shape(getattr(system, name), *arguments)
    except TypeError as error:
        if "not a valid JAX type" in str(error):
            raise TypeError(f"{name} must return a real array; {error}") from error
        raise
    if not hasattr(result, "shape"):
        raise TypeError(f"{name} must return one real array; got {type(result).__name__}.")
    if result.dtype.kind not in "fiu":
        raise TypeError(f"{name} must return real numbers; got dtype {result.dtype}.")
    return result


def mass_as_matrix(mass: Any, n: int, xp: Any) -> Any:
    """A declared constant mass (scalar, ``(n,)`` or ``(n, n)``) as a matrix ``(n, n)``, a large diagonal as such."""
    if mass is None:
        return None
    mass = xp.asarray(mass, dtype=float)
    if mass.shape == (n, n):
        return mass
    if mass.shape not in ((), (n,)):
        raise wrong_shape("mass_matrix", (n, n), mass.shape)
    diagonal = xp.broadcast_to(mass, (n,))
    return Diagonal(diagonal) if n > FULL else xp.diag(diagonal)


def used_arguments(function: Callable[..., Any], *arguments: Any) -> tuple[bool, ...]:
    """For each argument, whether any output of ``function`` depends on it (dead code removed from its jaxpr)."""
    with preparing(f"tracing {getattr(function, '__name__', 'a derivative')}"):
        closed = jax.make_jaxpr(function)(*arguments)
    if any(isinstance(value, jax.core.Tracer) for value in closed.consts):
        raise traced("a value outside of the system that its functions use")
    used = used_inputs(closed.jaxpr)
    sizes = [len(jax.tree.leaves(argument)) for argument in arguments]
    bounds = np.cumsum([0, *sizes])
    return tuple(any(used[bounds[i] : bounds[i + 1]]) for i in range(len(arguments)))
