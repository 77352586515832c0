"""``derive``: from a System to its Dynamics, with shapes checked and dependencies read."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Vector, real_values, traced
from hhtbench.counting import preparing
from hhtbench.lowering.caching import ById, Cache
from hhtbench.lowering.compile.control_flow import TRACED_AS_VALUE, explain_control_flow
from hhtbench.lowering.dynamics.jax_dynamics import JaxDynamics
from hhtbench.lowering.dynamics.mass import inverse_of
from hhtbench.lowering.dynamics.numpy_dynamics import NumpyDynamics
from hhtbench.lowering.dynamics.shapes import abstract_result, expect_pair, expect_shape, mass_as_matrix, wrong_shape
from hhtbench.lowering.dynamics.structure import Structure, used_arguments
from hhtbench.protocol import DERIVATIVES, SIGNATURES, NumpySystem, System, declared


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
        return _remember(system, t, q, v, ignored)
    if isinstance(system, NumpySystem):
        return _derive_numpy(system, t, q, v, ignored)
    raise TypeError(f"expected a System or a NumpySystem; got {type(system).__name__}.")


_derived = Cache(64)  # reading a system's structure costs a trace for each of its functions


def _remember(system: System, t: float, q: Vector, v: Vector, ignored: tuple[str, ...]) -> JaxDynamics:
    """A system is immutable: its dynamics is derived once per size."""
    return _derived.find((ById(system), np.shape(q), ignored), lambda: _read_off(system, t, q, v, ignored))


def _read_off(system: System, t: float, q: Vector, v: Vector, ignored: tuple[str, ...]) -> JaxDynamics:
    with preparing("starting JAX"):  # where this is its first use
        place = jnp.asarray(q), jnp.asarray(v)
    try:
        return _trace(system, t, *place, ignored)
    except TRACED_AS_VALUE as error:
        raise explain_control_flow(error, system) from error


def _trace(system: System, t: float, q: Any, v: Any, ignored: tuple[str, ...]) -> JaxDynamics:
    n = q.size
    time = jnp.asarray(t, dtype=float)
    expect_shape(system, "force", (n,), time, q, v)
    m = _rows_jax(system, "constraint", time, q)
    p = _rows_jax(system, "velocity_constraint", time, q, v)
    with preparing("evaluating mass_matrix"):
        mass = _mass_kind(system)
    if mass == "variable":
        expect_shape(system, "mass_matrix", (n, n), time, q)
        mass = "variable" if any(used_arguments(system.mass_matrix, time, q)) else "constant"  # type: ignore[attr-defined]
    _expect_optional_shapes(system, time, q, v, m, p, ignored)
    force_uses = used_arguments(system.force, time, q, v)  # type: ignore[attr-defined]
    general = Structure(n=n, m=m, p=p, mass=mass)
    plain = JaxDynamics(system=system, structure=general, ignored=ignored)
    structure = Structure(
        n=n,
        m=m,
        p=p,
        mass=mass,
        force_uses_q=force_uses[1],
        force_uses_v=force_uses[2],
        rheonomic=m > 0
        and (used_arguments(plain.constraint, time, q)[0] or _declares(system, "constraint_time_derivative")),
        linear_reaction=_reactions_are_linear(plain, time, q, v),
        velocity_jacobian_uses_v=p > 0 and used_arguments(plain.velocity_constraint_jacobian, time, q, v)[2],
        velocity_reaction_uses_v=p > 0 and used_arguments(plain.velocity_reaction, time, q, v, jnp.zeros(p))[2],
    )
    with preparing("evaluating mass_matrix"):
        constant = _constant_mass(system, time, q) if mass == "constant" else None
        inverse = inverse_of(constant, jnp)
    return JaxDynamics(system, structure, ignored, constant, inverse)


def _derive_numpy(system: NumpySystem, t: float, q: Vector, v: Vector, ignored: tuple[str, ...]) -> NumpyDynamics:
    n = np.size(q)
    mass = _mass_kind(system)
    m = _rows_numpy(system, "constraint", t, q)
    p = _rows_numpy(system, "velocity_constraint", t, q, v)
    linear = declared(system, "reaction") is None and declared(system, "velocity_reaction") is None
    structure = Structure(n=n, m=m, p=p, mass=mass, linear_reaction=linear)
    constant = mass_as_matrix(system.mass_matrix, n, np) if mass == "constant" else None  # type: ignore[attr-defined]
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


def _rows_jax(system: System, name: str, *arguments: Any) -> int:
    if declared(system, name) is None:
        return 0
    shape = abstract_result(system, name, *arguments).shape
    if len(shape) != 1:
        raise wrong_shape(name, "(m,), one entry per constraint", shape)
    return shape[0]


def _rows_numpy(system: NumpySystem, name: str, t: float, *arguments: Any) -> int:
    function = declared(system, name)
    if function is None:
        return 0
    copies = [np.array(argument, dtype=np.float64) for argument in arguments]
    for copy in copies:
        copy.setflags(write=False)
    result = real_values(f"{name} result", function(float(t), *copies))
    if result.ndim != 1:
        raise wrong_shape(name, "(m,), one entry per constraint", result.shape)
    return result.size


def _expect_optional_shapes(system: System, t: Any, q: Any, v: Any, m: int, p: int, ignored: tuple[str, ...]) -> None:
    at = {"t": t, "q": q, "v": v, "lam": jnp.zeros(m), "mu": jnp.zeros(p)}
    for name in ("reaction", "velocity_reaction", *DERIVATIVES):
        if not _declares(system, name) or name in ignored:
            continue
        arguments = [at[symbol] for symbol in SIGNATURES[name].arguments]
        shapes = SIGNATURES[name].shapes(q.size, m, p)
        if len(shapes) == 1:
            expect_shape(system, name, shapes[0], *arguments)
            continue
        pair = expect_pair(name, jax.eval_shape(getattr(system, name), *arguments), shapes)
        for value, shape in zip(pair, shapes, strict=True):
            if value is not None and value.shape != shape:
                raise wrong_shape(name, shape, value.shape)


def _declares(system: System | NumpySystem, name: str) -> bool:
    return declared(system, name) is not None


def _reactions_are_linear(dynamics: JaxDynamics, t: Any, q: Any, v: Any) -> bool:
    """Whether both reactions are linear in the multipliers: their Jacobian does not use them."""
    system, m, p = dynamics.system, dynamics.structure.m, dynamics.structure.p
    if m and _declares(system, "reaction") and used_arguments(jax.jacfwd(system.reaction, 2), t, q, jnp.zeros(m))[2]:  # type: ignore[attr-defined]
        return False
    if p and _declares(system, "velocity_reaction"):
        return not used_arguments(jax.jacfwd(system.velocity_reaction, 3), t, q, v, jnp.zeros(p))[3]  # type: ignore[attr-defined]
    return True
