"""The Newton matrix is the derivative of the residual, for every layout (row M14 of the acceptance matrix)."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from solvers.hht import HHT
from solvers.hht.equations.corrections import residual_of
from solvers.hht.equations.discretise import step_residual_and_ends, step_residual_and_matrix, unpack_matrix
from tests.lowering.xla import values

METHODS = (
    {},
    {"b": 0.3},
    {"b": 0.3, "reaction": "predictor"},
    {"reaction": "midpoint"},
    {"reaction": "midpoint_predictor"},
)


@pytest.mark.parametrize(
    ("name", "method"),
    [
        *(("jay_negrut_test1", method) for method in METHODS),
        ("andrews", METHODS[2]),
        *(("jay_negrut_pendulum", {"extrapolate_reaction": True, **method}) for method in METHODS[:4]),
        ("rolling_disk3d_steady", METHODS[3]),
    ],
    ids=str,
)
def test_blocks_of_the_step_equal_the_derivative_of_the_whole_residual(name, method):
    """Assembled from blocks against automatic differentiation of the residual as one function, at random unknowns."""
    problem = hb.load_problem(name)
    hht = HHT(problem.system, alpha=-0.15, **method)
    h = (problem.t_span[1] - problem.t_span[0]) / 100
    hht.init_step(problem.t_span[0], problem.q0, problem.v0, step=h, lam_guess=problem.lam_guess)
    assert hht.step() is hb.Status.success
    layout, dynamics, method = hht._engine.layout, hht._engine.dynamics, hht._engine.method
    unknowns, given = np.split(hht.state.factorised.at, [layout.size])
    static, given = (dynamics, method, layout), jnp.asarray(given)
    x = jnp.asarray(unknowns) * (1 + 0.1 * np.random.default_rng(0).standard_normal(layout.size))
    assembled, whole, with_ends = (
        partial(function, *static) for function in (step_residual_and_matrix, residual_of, step_residual_and_ends)
    )
    both, alone, matrix, ends = values((assembled, whole, jax.jacfwd(whole), jax.jacfwd(with_ends)), x, given)
    residual, blocks = unpack_matrix(layout, both)
    wanted = np.concatenate([matrix, ends[layout.size :]])
    np.testing.assert_array_equal(residual, alone)
    np.testing.assert_allclose(
        blocks / np.abs(wanted).max(axis=1, keepdims=True),
        wanted / np.abs(wanted).max(axis=1, keepdims=True),
        rtol=0,
        atol=1e-12,
    )


def test_levels_hold_to_roundoff_also_at_steps_that_are_far_too_long():
    """Andrews' mechanism in 40 steps: Newton works hard, and what it accepts is converged."""
    problem = hb.load_problem("andrews")
    solution = HHT(problem.system, alpha=-0.05).solve(problem.t_span, problem.q0, problem.v0, steps=40)
    constraint = problem.system.constraint
    residual = max(float(np.abs(np.asarray(constraint(0.0, jnp.asarray(q)))).max()) for q in solution.q)
    assert residual < 1e-14
