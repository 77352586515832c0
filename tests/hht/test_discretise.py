"""The Newton matrix is the derivative of the residual, for every layout (row M14 of the acceptance matrix)."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering import compile_function
from solvers.hht import HHT
from solvers.hht.equations.discretise import unpack_matrix
from solvers.hht.equations.methods import equations_of
from solvers.hht.verify import rivals
from tests.lowering.xla import values
from tests.sample import slow

METHODS = (
    {},
    {"b": 0.3},
    {"b": 0.3, "reaction": "predictor"},
    {"reaction": "midpoint"},
    {"reaction": "midpoint_predictor"},
)
RIVALS = ("ggl", "index3", "extended", "hht_i3", "rattle")


@pytest.mark.parametrize(
    ("name", "kind", "options"),
    [
        *(("jay_negrut_test1", HHT, METHODS[i]) for i in (2, 4)),
        *(slow("jay_negrut_test1", HHT, METHODS[i]) for i in (0, 1, 3)),
        slow("slider_crank_equal_lengths", HHT, METHODS[2]),
        *(("jay_negrut_pendulum", HHT, {"extrapolate_reaction": True, **METHODS[i]}) for i in (1, 3)),
        *(slow("jay_negrut_pendulum", HHT, {"extrapolate_reaction": True, **METHODS[i]}) for i in (0, 2)),
        ("rolling_sphere_table", HHT, METHODS[3]),
        *(("sundials_slider_crank", *rivals.METHODS[name]) for name in RIVALS),
        *(slow("heavy_top", *rivals.METHODS[name]) for name in ("ggl", "hht_i3")),
    ],
    ids=str,
)
def test_blocks_of_the_step_equal_the_derivative_of_the_whole_residual(name, kind, options):
    """Assembled from blocks against automatic differentiation of the residual as one function, at random unknowns."""
    problem = hb.load_problem(name)
    hht = kind(problem.system, **{"alpha": -0.15, **options} if kind is HHT else options)
    h = (problem.t_span[1] - problem.t_span[0]) / 100 if kind is HHT else 1e-3
    hht.init_step(problem.t_span[0], problem.q0, problem.v0, step=h, lam_guess=problem.lam_guess)
    for _ in range(2):
        assert hht.step() is hb.Status.success
    layout, dynamics, method = hht._engine.layout, hht._engine.dynamics, hht._engine.method
    unknowns, _, given = np.split(hht.state.factorised.at, [layout.size, 2 * layout.size + 1])
    x = jnp.asarray(unknowns) * (1 + 0.1 * np.random.default_rng(0).standard_normal(layout.size))
    equations = equations_of(method)
    assembled, whole = (
        partial(function, dynamics, method, layout)
        for function in (equations.residual_and_matrix, equations.to_differentiate)
    )
    both, ends, wanted = values((assembled, whole, jax.jacfwd(whole)), x, jnp.zeros(1 + layout.size), jnp.asarray(given))
    residual, blocks = unpack_matrix(layout, both)
    np.testing.assert_array_equal(residual, ends[: layout.size])
    sizes = np.maximum(np.abs(wanted).max(axis=1, keepdims=True), 1e-300)
    np.testing.assert_allclose(blocks / sizes, wanted / sizes, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "method"),
    [
        ("jay_negrut_pendulum", {"alpha": -0.3}),
        ("jay_negrut_test1", {"alpha": 0.0}),
        slow("rolling_disk3d_steady", {"alpha": -0.3}),
        ("knife_edge", {"alpha": -0.05, "b": 1.0}),
    ],
    ids=str,
)
def test_the_condition_of_newton_s_matrix_is_that_of_long_steps_in_short_ones(name, method):
    """(H13), over h = 1e-2 to 1e-7 s; a row of the velocity level without its scale, 1/h, makes it grow."""
    problem, conditions, unscaled = hb.load_problem(name), [], []
    for h in 10.0 ** -np.arange(2.0, 8.0):
        hht = HHT(problem.system, **method)
        guesses = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
        hht.init_step(problem.t_span[0], problem.q0, problem.v0, step=h, **guesses)
        assert hht.step() is hb.Status.success
        layout, dynamics, used = hht._engine.layout, hht._engine.dynamics, hht._engine.method
        function = compile_function(equations_of(used).residual_and_matrix, dynamics, used, layout)
        packed = function(*np.split(hht.state.factorised.at, [layout.size, 2 * layout.size + 1]))
        matrix = np.array(unpack_matrix(layout, packed)[1][: layout.size])
        conditions.append(np.linalg.cond(matrix))
        matrix[-1] *= h
        unscaled.append(np.linalg.cond(matrix))
    assert max(conditions) < 1.05 * min(conditions)
    assert max(unscaled) > 1e4 * max(conditions)
