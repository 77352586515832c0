"""Derived functions that solvers use, a part of them for every problem of the library: machine code and XLA agree.

XLA compiles one function per problem that calls all of them, without optimisation; both routes share their traces.  Its
seconds are what this costs, so problems take turns: with the residual and the end of a step, with matrices, forms, loops.
"""

import importlib
from importlib.metadata import entry_points

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench
from hhtbench.lowering import NotNative, derive, native, route_of
from hhtbench.lowering.dynamics.kkt import kkt_terms
from hhtbench.lowering.dynamics.levels import level_terms
from hhtbench.lowering.flattening import flat_function, jitted
from hhtbench.lowering.scalar_compiler import native_call
from solvers._finite import inverse_mass_at
from solvers.forms import FORMS
from solvers.forms.form import refusal
from solvers.forms.layout import Layout as FormLayout
from solvers.forms.layout import jacobian_function, residual_function
from solvers.forms.underlying import rhs_function, rhs_jacobian_function
from solvers.hht.equations.coefficients import Coefficients, Method
from solvers.hht.equations.corrections import residual_of, state_after
from solvers.hht.equations.discretise import step_residual_and_matrix
from solvers.hht.equations.known import Layout
from solvers.kernel.kkt import force_and_inverse_mass
from tests.lowering.native import in_loops
from tests.lowering.xla import compiled

NAMES = sorted({entry.name for entry in entry_points(group="hhtbench.problems")})
ROUNDOFF = 2e-13  # of the largest entry: sums of many products in another order
OF_SOLVES = 1e-9  # after a solve with a matrix of condition 1e4
LARGE = 12  # n + m + p from which the matrices are left out: XLA takes half a minute for those of andrews


def dynamics_of(problem):
    return derive(problem.system, problem.t_span[0], problem.q0, problem.v0)


def points_of(problem):
    """(t, q, v, generator) at the start and near it."""
    for seed in (0, 1):
        draw = np.random.default_rng(seed)
        near = 1e-3 * seed * draw.normal(size=(2, problem.q0.size))
        scale = np.broadcast_to(problem.scales.q, problem.q0.shape), np.broadcast_to(problem.scales.v, problem.q0.shape)
        yield problem.t_span[0] + 0.1 * seed, problem.q0 + near[0] * scale[0], problem.v0 + near[1] * scale[1], draw


def given_arguments(layout, t, q, v, draw):
    """Unknowns, and the step with the state before it as the loops keep them."""
    s, h = layout.structure, 0.01
    head = [h, t + h, 0.7, 1.0, 0.0, t, h, 1.0, 1.0, 0.0, -1.0]
    sizes = 2 * s.n + s.m + s.p + s.n + (s.n * s.n if s.mass == "variable" else 0)  # a, f, lam, mu, vdot, inverse mass
    return draw.normal(size=layout.size), np.concatenate([head, q, v, draw.normal(size=sizes)])


def functions_of(problem, dynamics):
    """name -> (function, static options, arguments at two points, tolerance)."""
    s, found = dynamics.structure, {}
    small, unknowns, turn = s.n + s.m + s.p < LARGE, s.n + s.m + s.p, NAMES.index(problem.name)
    points = list(points_of(problem))

    def add(function, static, arguments, tolerance=ROUNDOFF, name=""):
        found[function.__name__ + name] = function, static, [arguments(*point) for point in points], tolerance

    for moving in (True, False):
        layout = Layout(s, moving, moving and s.mass == "variable")
        method = Method(coefficients=Coefficients(alpha=-0.2, b=0.0), reaction="implicit" if moving else "predictor")
        given = lambda *point, layout=layout: given_arguments(layout, *point)  # noqa: E731
        add(state_after if turn % 2 == moving else residual_of, (method, layout), given, name=f" {moving}")
        if small and turn % 3 == moving:
            add(step_residual_and_matrix, (method, layout), given, name=f" {moving}")
    add(kkt_terms, (), lambda t, q, v, draw: (t, q, v, draw.normal(size=unknowns)))
    add(force_and_inverse_mass, (), lambda t, q, v, _: (t, q, v), OF_SOLVES)
    add(inverse_mass_at, (), lambda t, q, v, _: (t, q), OF_SOLVES)
    if s.constrained:
        add(level_terms, (), lambda t, q, v, _: (t, q, v))
    forms = [form for form in FORMS if refusal(form, s) is None] if small else []
    forms = forms[turn % 2 :: 2] or forms
    for i, form in enumerate(forms):
        with_matrix = i == turn // 2 % len(forms)
        if form == "ode":
            packed = lambda t, q, v, _: (t, np.concatenate([q, v]))  # noqa: E731
            add(rhs_function, (), packed, OF_SOLVES)
            if with_matrix:
                add(rhs_jacobian_function, (), packed, OF_SOLVES)
            continue
        layout = FormLayout(form, s)
        at = lambda t, q, v, draw, layout=layout: form_arguments(layout, t, q, v, draw)  # noqa: E731
        add(residual_function, (layout,), at, name=f" {form}")
        if with_matrix:
            add(jacobian_function, (layout,), lambda *point, at=at: (*at(*point), 3.0), name=f" {form}")
    return found


def form_arguments(layout, t, q, v, draw):
    y = draw.normal(size=layout.size)
    y[layout.blocks["q"]], y[layout.blocks["v"]] = q, v
    return t, y, draw.normal(size=layout.size)


def by_xla(dynamics, functions):
    """name -> values at both points, all by one compilation."""
    flats = {name: flat_function(function, dynamics, *static) for name, (function, static, *_) in functions.items()}

    def everything(parameters, arguments):
        return {name: jnp.ravel(jitted(flat)(parameters, *arguments[name])) for name, flat in flats.items()}

    parameters = next(iter(flats.values())).parameters
    at = [{name: [np.asarray(x) for x in entry[2][i]] for name, entry in functions.items()} for i in (0, 1)]
    code = compiled(jax.jit(everything), parameters, at[0])
    return [jax.tree.map(np.asarray, code(parameters, arguments)) for arguments in at]


@pytest.mark.parametrize("name", NAMES)
def test_machine_code_and_xla_give_the_same_values(name):
    problem = hhtbench.load_problem(name)
    dynamics = dynamics_of(problem)
    if route_of(dynamics) == "numpy" or (dynamics.inverse_mass is None and dynamics.structure.mass == "constant"):
        pytest.skip("plain callables, or a singular mass")
    functions = functions_of(problem, dynamics)
    expected, missing = by_xla(dynamics, functions), []
    for i, (label, (function, static, arguments, tolerance)) in enumerate(functions.items()):
        shapes = tuple(np.shape(argument) for argument in arguments[0])
        made = (native, in_loops) if (i + NAMES.index(name)) % 2 else (native,)
        try:
            call, *looped = (native_call(make(function, dynamics, *static, shapes=shapes), shapes) for make in made)
        except NotNative as error:
            missing.append((label, error.reason))
            continue
        for values, known in zip(arguments, expected, strict=True):
            got = call(*values).ravel()
            for other in looped:
                np.testing.assert_array_equal(other(*values).ravel(), got, err_msg=f"{label} in loops")
            size = np.abs(known[label]).max(initial=0.0)
            if not np.isfinite(size):
                assert (name, label[:3]) == ("redundant_pendulum", "rhs"), "a KKT matrix is singular there only"
                assert not np.isfinite(got).all()
                continue
            np.testing.assert_allclose(got, known[label], rtol=0.0, atol=tolerance * size, err_msg=label)
    assert len(missing) <= len(functions) // 3, missing
    assert all("operations" in reason for _, reason in missing), missing


def test_the_library_is_all_there():
    assert len(NAMES) >= 32
    assert importlib.util.find_spec("problems.andrews") is not None
