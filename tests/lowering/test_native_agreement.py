"""Derived functions that solvers use, for every problem of the library: machine code, in lines and in loops, and XLA agree.

XLA compiles one function per problem that calls all of them, without optimisation; both routes share their traces.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench
from hhtbench.lowering import NotNative, derive, native, route_of
from hhtbench.lowering.dynamics.kkt_rows import kkt_terms
from hhtbench.lowering.dynamics.levels import level_terms
from hhtbench.lowering.flattening import flat_function, jitted
from hhtbench.lowering.scalar_compiler import native_call
from solvers.forms.form import refusal
from solvers.forms.layout import Layout as FormLayout
from solvers.forms.layout import jacobian_function, residual_function
from solvers.forms.underlying import rhs_jacobian_function
from solvers.hht.equations.coefficients import Coefficients, Method
from solvers.hht.equations.corrections import residual_of
from solvers.hht.equations.discretise import step_residual_and_matrix
from solvers.hht.equations.known import Layout
from solvers.kernel.full import force_and_inverse_mass
from tests.lowering.native import in_loops
from tests.sample import slow

NAMES = hhtbench.list_problems()
MADE = ("andrews", "fput_chain", "heavy_top", "jay_negrut_test1", "kapitza_pendulum", "knife_edge")
ROUNDOFF = 2e-13  # of the largest entry: sums of many products in another order
OF_SOLVES = 1e-9  # after a solve with a matrix of condition 1e4
LARGE = 12  # n + m + p from which the matrices are left out: XLA takes half a minute for those of andrews


def functions_of(problem, dynamics):
    """name -> (function, static options, arguments near the start, tolerance); forms take turns over the problems."""
    s, draw, turn = dynamics.structure, np.random.default_rng(1), NAMES.index(problem.name)
    t, h, moved = problem.t_span[0] + 0.1, 0.01, 1e-3 * draw.normal(size=(2, problem.q0.size))
    q, v = problem.q0 + problem.scales.q * moved[0], problem.v0 + problem.scales.v * moved[1]
    layout = Layout(s, True, s.mass == "variable")
    method = Method(coefficients=Coefficients(alpha=-0.2, b=0.0), reaction="implicit")
    head = [h, t + h, 0.7, 1.0, 0.0, t, h, 1.0, 1.0, 0.0, -1.0]
    state = draw.normal(size=3 * s.n + s.m + s.p + (s.n * s.n if s.mass == "variable" else 0))  # a, f, lam, mu, v', M^-1
    step = draw.normal(size=layout.size), np.concatenate([head, q, v, state])
    found = {
        "kkt_terms": (kkt_terms, (), (t, q, v, draw.normal(size=s.n + s.m + s.p)), ROUNDOFF),
        "force": (force_and_inverse_mass, (), (t, q, v), OF_SOLVES),
        "step": (residual_of, (method, layout), step, ROUNDOFF),
    }
    if s.constrained:
        found["levels"] = level_terms, (), (t, q, v), ROUNDOFF
    if s.n + s.m + s.p < LARGE:
        form = [form for form in ("index1", "index2", "ggl", "integrated") if refusal(form, s) is None]
        of_form = FormLayout(form[turn % len(form)], s)
        y, yp = draw.normal(size=(2, of_form.size))
        y[of_form.blocks["q"]], y[of_form.blocks["v"]] = q, v
        found["residual"] = residual_function, (of_form,), (t, y, yp), ROUNDOFF
        found["jacobian"] = jacobian_function, (of_form,), (t, y, yp, 3.0), ROUNDOFF
        previous = np.concatenate([[1.0], draw.normal(size=layout.size)])
        found["matrix"] = step_residual_and_matrix, (method, layout), (step[0], previous, step[1]), ROUNDOFF
        if s.linear_reaction and problem.name != "redundant_pendulum":  # whose KKT matrix is singular
            found["rhs"] = rhs_jacobian_function, (), (t, np.concatenate([q, v])), OF_SOLVES
    return found


@pytest.mark.parametrize("name", [x if x in MADE else slow(x) for x in NAMES])
def test_machine_code_and_xla_give_the_same_values(name):
    problem = hhtbench.load_problem(name)
    dynamics = derive(problem.system, problem.t_span[0], problem.q0, problem.v0)
    if route_of(dynamics) == "numpy" or (dynamics.inverse_mass is None and dynamics.structure.mass == "constant"):
        pytest.skip("plain callables, or a singular mass")
    functions = functions_of(problem, dynamics)
    flats = {label: flat_function(function, dynamics, *static) for label, (function, static, *_) in functions.items()}

    def everything(parameters, arguments):
        return {label: jnp.ravel(jitted(flat)(parameters, *arguments[label])) for label, flat in flats.items()}

    at = {label: [np.asarray(x, dtype=float) for x in entry[2]] for label, entry in functions.items()}
    parameters, missing = flats["kkt_terms"].parameters, []
    expected = jax.jit(everything)(parameters, at)
    for i, (label, (function, static, arguments, tolerance)) in enumerate(functions.items()):
        shapes = tuple(map(np.shape, arguments))
        made = (native, in_loops) if (i + NAMES.index(name)) % 2 else (native,)
        try:
            got, *looped = (
                native_call(make(function, dynamics, *static, shapes=shapes), shapes)(*arguments) for make in made
            )
        except NotNative as error:
            missing.append(error.reason)
            continue
        for other in looped:
            np.testing.assert_array_equal(other, got, err_msg=f"{label} in loops")
        size = np.abs(expected[label]).max(initial=0.0)
        np.testing.assert_allclose(got.ravel(), expected[label], rtol=0.0, atol=tolerance * size, err_msg=label)
    assert len(missing) <= len(functions) // 3 and all("operations" in reason for reason in missing), missing
