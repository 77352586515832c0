"""``derive``: from a System to its Dynamics, with shapes checked and dependencies read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Vector, real_values, traced
from hhtbench.counting import preparing
from hhtbench.lowering.caching import ById, Cache
from hhtbench.lowering.compile.control_flow import TRACED_AS_VALUE, explain_control_flow
from hhtbench.lowering.dynamics.dynamics import Structure
from hhtbench.lowering.dynamics.jax_dynamics import JaxDynamics
from hhtbench.lowering.dynamics.mass import Diagonal, inverse_of
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics, expect_pair, wrong_shape
from hhtbench.lowering.jax_internals import used_inputs
from hhtbench.protocol import DERIVATIVES, SIGNATURES, NumpySystem, System, declared

FULL = 256  # coordinates up to which a constant diagonal mass is a full matrix: half a megabyte
_derived = Cache(64)  # a system is immutable; reading its structure costs a trace for each of its functions


def derive(
    system: System | NumpySystem, t: float, q: Vector, v: Vector, *, ignored: tuple[str, ...] = ()
) -> JaxDynamics | NumpyDynamics:
    """Every derived function of ``system``, uncompiled.

    Parameters
    ----------
    t, q, v
        A point, for the sizes: (n,) arrays.
    ignored
        Declared derivatives that are derived afresh instead of used.

    Raises
    ------
    ProblemError
        A declared function returns the wrong shape; the text names it and both shapes.  Or Python control flow looks at a
        value that JAX traces; the text names the line.
    TypeError
        A declared function returns something that is not a real array, or nothing declares ``force``.
    """
    if not callable(declared(system, "force")):
        raise TypeError(f"{type(system).__name__} declares no force(t, q, v); every system needs one.")
    if isinstance(system, System):
        if any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(system)):
            raise traced(f"a parameter of {type(system).__name__}")
        found: JaxDynamics = _derived.find(
            (ById(system), np.shape(q), ignored), lambda: _derive_jax(system, t, q, v, ignored)
        )
        return found
    if isinstance(system, NumpySystem):
        return _derive_numpy(system, t, q, v, ignored)
    raise TypeError(f"expected a System or a NumpySystem; got {type(system).__name__}.")


def _derive_jax(system: System, t: float, q: Vector, v: Vector, ignored: tuple[str, ...]) -> JaxDynamics:
    with preparing("starting JAX"):  # where this is its first use
        place = jnp.asarray(t, dtype=float), jnp.asarray(q), jnp.asarray(v)
    try:
        structure = _structure(system, *place, ignored)
        with preparing("evaluating mass_matrix"):
            constant = _constant_mass(system, *place[:2]) if structure.mass == "constant" else None
            return JaxDynamics(system, structure, ignored, constant, inverse_of(constant, jnp))
    except TRACED_AS_VALUE as error:
        raise explain_control_flow(error, system) from error


def _structure(system: Any, t: Any, q: Any, v: Any, ignored: tuple[str, ...]) -> Structure:
    expect_shape(system, "force", q.shape, t, q, v)
    m, p = (_rows(system, name, abstract_result, *at) for name, *at in _constraints(t, q, v))
    with preparing("evaluating mass_matrix"):
        mass = _mass_kind(system)
    if mass == "variable":
        expect_shape(system, "mass_matrix", (q.size, q.size), t, q)
        mass = "variable" if any(used_arguments(system.mass_matrix, t, q)) else "constant"
    general = Structure(n=q.size, m=m, p=p, mass=mass)
    plain = JaxDynamics(system=system, structure=general, ignored=ignored)
    _expect_optional_shapes(plain, t, q, v)
    _, force_uses_q, force_uses_v = used_arguments(system.force, t, q, v)
    declares_g_t = declared(system, "constraint_time_derivative") is not None
    return replace(
        general,
        force_uses_q=force_uses_q,
        force_uses_v=force_uses_v,
        rheonomic=m > 0 and (used_arguments(plain.constraint, t, q)[0] or declares_g_t),
        linear_reaction=_reactions_are_linear(plain, t, q, v),
        velocity_jacobian_uses_v=p > 0 and used_arguments(plain.velocity_constraint_jacobian, t, q, v)[2],
        velocity_reaction_uses_v=p > 0 and used_arguments(plain.velocity_reaction, t, q, v, jnp.zeros(p))[2],
    )


def _derive_numpy(system: NumpySystem, t: float, q: Vector, v: Vector, ignored: tuple[str, ...]) -> NumpyDynamics:
    m, p = (_rows(system, name, _result, *at) for name, *at in _constraints(t, q, v))
    linear = declared(system, "reaction") is None and declared(system, "velocity_reaction") is None
    structure = Structure(n=np.size(q), m=m, p=p, mass=_mass_kind(system), linear_reaction=linear)
    constant = mass_as_matrix(system.mass_matrix, structure.n, np) if structure.mass == "constant" else None  # type: ignore[attr-defined]
    return NumpyDynamics(system, structure, ignored, constant, inverse_of(constant, np))


def _mass_kind(system: System | NumpySystem) -> str:
    mass = declared(system, "mass_matrix")
    if mass is None:
        return "identity"
    return "variable" if callable(mass) else "constant"


def _constant_mass(system: System, t: Any, q: Any) -> Any:
    """In float64, also where it comes of whole numbers, or of Python's."""
    mass = system.mass_matrix  # type: ignore[attr-defined]
    mass = mass_as_matrix(mass(t, q) if callable(mass) else mass, q.size)
    return jax.tree.map(lambda values: jnp.asarray(values, dtype=float), mass)


def _constraints(t: Any, q: Any, v: Any) -> Any:
    """The functions whose results say how many constraints there are, with their arguments."""
    return ("constraint", t, q), ("velocity_constraint", t, q, v)


def _rows(system: Any, name: str, result: Any, *arguments: Any) -> int:
    if declared(system, name) is None:
        return 0
    shape: tuple[int, ...] = result(system, name, *arguments).shape
    if len(shape) != 1:
        raise wrong_shape(name, "(m,), one entry per constraint", shape)
    return shape[0]


def _result(system: NumpySystem, name: str, t: float, *arguments: Vector) -> np.ndarray:
    copies = [np.array(argument, dtype=np.float64) for argument in arguments]
    for copy in copies:
        copy.setflags(write=False)
    return real_values(f"{name} result", getattr(system, name)(float(t), *copies))


def _expect_optional_shapes(dynamics: JaxDynamics, t: Any, q: Any, v: Any) -> None:
    system, s = dynamics.system, dynamics.structure
    at = {"t": t, "q": q, "v": v, "lam": jnp.zeros(s.m), "mu": jnp.zeros(s.p)}
    for name in ("reaction", "velocity_reaction", *DERIVATIVES):
        if not dynamics.gives(name):
            continue
        arguments = [at[symbol] for symbol in SIGNATURES[name].arguments]
        shapes = SIGNATURES[name].shapes(s.n, s.m, s.p)
        if len(shapes) == 1:
            expect_shape(system, name, shapes[0], *arguments)
            continue
        pair = expect_pair(name, jax.eval_shape(getattr(system, name), *arguments), shapes)
        for value, shape in zip(pair, shapes, strict=True):
            if value is not None and value.shape != shape:
                raise wrong_shape(name, shape, value.shape)


def _reactions_are_linear(dynamics: JaxDynamics, t: Any, q: Any, v: Any) -> bool:
    """Whether both reactions are linear in the multipliers: their Jacobian does not use them."""
    s = dynamics.structure
    for name, *arguments in ("reaction", t, q, jnp.zeros(s.m)), ("velocity_reaction", t, q, v, jnp.zeros(s.p)):
        function: Any = declared(dynamics.system, name)
        if function is None or not arguments[-1].size:
            continue
        if used_arguments(jax.jacfwd(function, len(arguments) - 1), *arguments)[-1]:
            return False
    return True


def abstract_result(system: System, function: str, *arguments: Any) -> jax.ShapeDtypeStruct:
    """Shape and type that a declared JAX function returns, found without running it.

    Raises
    ------
    TypeError
        It returns something that is not one real array.
    """
    try:
        with preparing(f"tracing {function}"):
            result = jax.eval_shape(getattr(system, function), *arguments)
    except TypeError as error:
        if "not a valid JAX type" in str(error):
            raise TypeError(f"{function} must return a real array; {error}") from error
        raise
    if not hasattr(result, "shape"):
        raise TypeError(f"{function} must return one real array; got {type(result).__name__}.")
    if result.dtype.kind not in "fiu":
        raise TypeError(f"{function} must return real numbers; got dtype {result.dtype}.")
    return result


def expect_shape(system: System, function: str, expected: tuple[int, ...], *arguments: Any) -> None:
    """Raise unless the declared JAX function returns ``expected``."""
    given = abstract_result(system, function, *arguments).shape
    if given != expected:
        raise wrong_shape(function, expected, given)


def mass_as_matrix(mass: Any, n: int, xp: Any = jnp) -> Any:
    """A declared constant mass (scalar, ``(n,)`` or ``(n, n)``) as a matrix ``(n, n)``, a large diagonal as such."""
    mass = xp.asarray(mass)
    if n > FULL and mass.shape in ((), (n,)):
        return Diagonal(xp.broadcast_to(mass, (n,)))
    if mass.ndim == 0:
        return mass * xp.eye(n)
    if mass.shape == (n,):
        return xp.diag(mass)
    if mass.shape == (n, n):
        return mass
    raise wrong_shape("mass_matrix", (n, n), mass.shape)


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
