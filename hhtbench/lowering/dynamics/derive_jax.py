"""The :class:`JaxDynamics` of a System: shapes checked and dependencies read by tracing, without running its functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.lowering.compile.routes import TRACED_AS_VALUE, explain_control_flow
from hhtbench.lowering.dynamics.declared import (
    FULL,
    expect_parts,
    expect_physics,
    mass_as_matrix,
    mass_kind,
    rows_of,
    wrong_shape,
)
from hhtbench.lowering.dynamics.dynamics import Structure
from hhtbench.lowering.dynamics.jax_dynamics import JaxDynamics
from hhtbench.lowering.dynamics.mass import compact, inverse_of
from hhtbench.lowering.dynamics.reductions import generalised
from hhtbench.lowering.flattening import traced_once
from hhtbench.lowering.jax_internals import used_inputs
from hhtbench.protocol.arguments import Vector, traced
from hhtbench.protocol.system import DERIVATIVES, System, declared, reaction_takes_velocity, signature_of
from hhtbench.solution.counting import preparing


def derive_jax(
    system: System, t: float, q: Vector, v: Vector, ignored: tuple[str, ...], without: tuple[str, ...]
) -> JaxDynamics:
    """The dynamics of ``system`` with sizes from the point (t, q, v); see :func:`~.derive.derive`."""
    expect_physics(system)
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
    except ValueError as error:  # raised by an assignment into an array of NumPy
        if not isinstance(error.__cause__, TRACED_AS_VALUE):
            raise
        raise explain_control_flow(error, system) from error


def _structure(system: Any, t: Any, q: Any, v: Any, ignored: tuple[str, ...]) -> Structure:
    at = {"t": t, "q": q, "v": v}
    _expect(system, "force", at, q.size)
    m, p = rows_of(system, lambda name: abstract_result(system, name, at))
    with preparing("evaluating mass_matrix"):
        mass = mass_kind(system)
    if mass == "variable":
        if abstract_result(system, "mass_matrix", at).shape != (q.size,):
            _expect(system, "mass_matrix", at, q.size)
        mass = "variable" if any(used_arguments(traced_once(system, "mass_matrix"), t, q)) else "constant"
    general = Structure(n=q.size, m=m, p=p, mass=mass, reaction_uses_v=reaction_takes_velocity(system))
    plain = JaxDynamics(system=system, structure=general, ignored=ignored)
    at |= {"lam": jnp.zeros(m), "mu": jnp.zeros(p)}
    for name in ("reaction", "velocity_reaction", *DERIVATIVES):
        if plain.gives(name):
            _expect(system, name, at, q.size, m, p)
    _, force_uses_q, force_uses_v = used_arguments(plain.force, t, q, v)
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


def _is_linear(system: System, name: str, at: dict[str, Any]) -> bool:
    """True if a reaction is linear in the multipliers, that is, if its Jacobian does not use them."""
    function: Any = declared(system, name)
    arguments = [at[symbol] for symbol in signature_of(system, name).arguments]
    if function is None or not arguments[-1].size:
        return True
    return not used_arguments(jax.jacfwd(function, len(arguments) - 1), *arguments)[-1]


def _expect(system: System, name: str, at: dict[str, Any], n: int, m: int = 0, p: int = 0) -> None:
    """Raise unless the declared JAX function returns the shapes that follow from the sizes."""
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
    """Shape and type of a declared JAX function's result, found by tracing.

    Raises
    ------
    TypeError
        It returns something that is not one real array.
    """
    try:
        with preparing(f"tracing {name}"):
            arguments = (at[symbol] for symbol in signature_of(system, name).arguments)
            result = jax.eval_shape(traced_once(system, name), *arguments)
    except TypeError as error:
        if "not a valid JAX type" in str(error):
            raise TypeError(f"{name} must return a real array; {error}") from error
        raise
    if not hasattr(result, "shape"):
        hint = " Make it one by jnp.stack([...])." if isinstance(result, (list, tuple)) else ""
        raise TypeError(f"{name} must return one real array; got {type(result).__name__}.{hint}")
    if result.dtype.kind not in "fiu":
        raise TypeError(f"{name} must return real numbers; got dtype {result.dtype}.")
    return result


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
