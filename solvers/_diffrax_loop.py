"""diffrax's steps in one compiled loop: its solvers and step-size controller, stepped by hand as its manual describes.

Tolerances, times and parameters are arguments of the compiled code, so that it is shared.  ``diffeqsolve`` is not
used: it cannot continue exactly where an earlier call stopped.
"""

from __future__ import annotations

from typing import Any

import diffrax
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from hhtbench.lowering import Dynamics
from solvers._xla_call import called
from solvers.forms import rhs_function

SEGMENT = 64  # attempted steps per compiled call: long against its 50 us, short against a time budget
AT_START = 3  # evaluations for the length of the first step and for its first stage
CLIP = 2e-14  # relative: a step that ends this close to the end is extended to it, as in diffrax


def evaluations_per_step(name: str) -> int | None:
    """Evaluations per attempted step of an explicit method (first same as last); None for an implicit one."""
    tableau: Any = getattr(diffrax, name).tableau
    return tableau.num_stages - 1 if tableau.a_diagonal is None else None


@jax.custom_jvp
def rhs_outside(ticket: Any, t: Any, y: Any) -> Any:
    """y' by the Python functions of ``ticket``, called from compiled code."""
    return called(ticket, y.shape, t, y)


@rhs_outside.defjvp
def _along(primals: Any, tangents: Any) -> Any:
    """Tangent of :func:`rhs_outside` by y; no method here differentiates by t."""
    ticket, t, y = primals
    return rhs_outside(ticket, t, y), called(ticket, (y.size, y.size), t, y) @ tangents[2]


def _method(dynamics: Dynamics, name: str, outside: bool, fixed: Any, weights: Any) -> tuple[Any, Any, Any]:
    """diffrax's terms, solver and step-size controller; time runs forward in s = direction * (t - t0).

    ``outside``: y' is computed by Python functions, which are counted, and not in this code.
    """
    direction, ticket, t0, rtol = fixed[0], fixed[1], fixed[2], fixed[4]

    def field(s: Any, y: Any, _: Any) -> Any:
        if outside:
            return direction * rhs_outside(ticket, direction * s, y)
        return direction * rhs_function(dynamics, t0 + direction * s, y)

    controller = diffrax.PIDController(rtol=rtol, atol=weights)
    options: dict[str, Any] = {}
    if name == "Kvaerno5":  # as diffeqsolve does: Newton's tolerances are the controller's
        norm: Any = controller.norm
        options = {"root_finder": diffrax.VeryChord(rtol=rtol, atol=weights, norm=norm)}
    return diffrax.ODETerm(field), getattr(diffrax, name)(**options), controller


def _first(dynamics: Dynamics, name: str, outside: bool, fixed: Any, weights: Any, y: Any) -> dict[str, Any]:
    """State of the loop before the first step, as a dictionary."""
    terms, solver, controller = _method(dynamics, name, outside, fixed, weights)
    s, end = jnp.zeros_like(fixed[2]), fixed[3]
    following, control = controller.init(terms, s, end, y, None, None, solver.func, solver.error_order(terms))
    following = jnp.minimum(following, end)
    memory = solver.init(terms, s, following, y, None)
    return {"s": s, "next": following, "y": y, "memory": memory, "control": control}


def start_steps(dynamics: Dynamics, name: str, outside: bool, fixed: Any, weights: Any, y: Any) -> Any:
    """State of the loop before the first step, packed as one vector; ``fixed``: direction, ticket, t0, end, rtol."""
    return ravel_pytree(_first(dynamics, name, outside, fixed, weights, y))[0]


def take_steps(dynamics: Dynamics, name: str, outside: bool, fixed: Any, weights: Any, packed: Any, most: Any) -> Any:
    """Attempt SEGMENT steps or until ``most`` are accepted; the state, three numbers and a row per step, as one vector.

    The numbers: steps accepted, steps attempted, and the end of the first attempt since the last step whose error was not
    finite.  A row holds a step: its start and end, then y at its end and at its start.
    """
    terms, solver, controller = _method(dynamics, name, outside, fixed, weights)
    shapes = jax.eval_shape(lambda y: _first(dynamics, name, outside, fixed, weights, y), weights)
    unravel = ravel_pytree(jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), shapes))[1]
    end = fixed[3]

    def going(loop: Any) -> Any:
        state, accepted, attempted, _, _ = loop
        return (attempted < SEGMENT) & (accepted < most) & (state["s"] < end) & (state["next"] > state["s"])

    def body(loop: Any) -> Any:
        state, accepted, attempted, bad, rows = loop
        y, error, _, memory, _ = solver.step(terms, state["s"], state["next"], state["y"], None, state["memory"], False)
        lost = ~jnp.all(jnp.isfinite(error)) | ~jnp.all(jnp.isfinite(y))
        error = jnp.where(lost, jnp.inf, error)  # rejects such a step, as diffrax does
        s, following, control = state["s"], state["next"], state["control"]
        keep, reached, proposed, _, control, _ = controller.adapt_step_size(
            s, following, state["y"], y, None, error, solver.error_order(terms), control
        )
        proposed = jnp.where(proposed > end - CLIP * jnp.abs(end), jnp.where(keep, end, (reached + end) / 2), proposed)
        row = jnp.concatenate([jnp.stack([s, following]), y, state["y"]])
        new = {"y": y, "memory": memory}
        after = jax.tree.map(lambda a, b: jnp.where(keep, a, b), new, {key: state[key] for key in new})
        after |= {"s": reached, "next": proposed, "control": control}
        rows = rows.at[accepted].set(jnp.where(keep, row, rows[accepted]))
        bad = jnp.where(keep, jnp.nan, jnp.where(lost & jnp.isnan(bad), following, bad))
        return after, accepted + keep, attempted + 1, bad, rows

    width = 2 + 2 * weights.size
    loop = unravel(packed), jnp.asarray(0), jnp.asarray(0), jnp.asarray(jnp.nan), jnp.zeros((SEGMENT, width))
    state, accepted, attempted, bad, rows = jax.lax.while_loop(going, body, loop)
    return jnp.concatenate([ravel_pytree(state)[0], jnp.stack([accepted, attempted, bad]), rows.ravel()])


def inside(dynamics: Dynamics, name: str, outside: bool, fixed: Any, weights: Any, row: Any, times: Any) -> Any:
    """y (k, size) at ``times`` (k,) within the step in ``row``, by repeating it and the method's interpolant."""
    terms, solver, _ = _method(dynamics, name, outside, fixed, weights)
    begin, end, y = row[0], row[1], row[2 + weights.size :]
    _, _, known, _, _ = solver.step(terms, begin, end, y, None, solver.init(terms, begin, end, y, None), False)
    return jax.vmap(solver.interpolation_cls(t0=begin, t1=end, **known).evaluate)(times)


def step_to(dynamics: Dynamics, name: str, outside: bool, fixed: Any, weights: Any, row: Any, s: Any) -> Any:
    """y at ``s`` within the step in ``row``, by a shorter step from its start: as accurate as the step.

    The interpolants of these methods are less accurate than their steps, up to forty times at rtol 1e-9.
    """
    terms, solver, _ = _method(dynamics, name, outside, fixed, weights)
    begin, y = row[0], row[2 + weights.size :]
    reached, _, _, _, result = solver.step(terms, begin, s, y, None, solver.init(terms, begin, s, y, None), False)
    return jnp.where(result == diffrax.RESULTS.successful, reached, jnp.nan)
