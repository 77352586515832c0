"""The Newton matrix is the derivative of the residual, for every layout (row M14 of the acceptance matrix)."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from solvers.hht import HHT
from solvers.hht.equations.discretise import unpack_matrix
from solvers.hht.equations.methods import equations_of
from solvers.hht.verify import rivals
from tests.lowering.xla import values

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
        *(("jay_negrut_test1", HHT, options) for options in METHODS),
        ("andrews", HHT, METHODS[2]),
        *(("jay_negrut_pendulum", HHT, {"extrapolate_reaction": True, **options}) for options in METHODS[:4]),
        ("rolling_disk3d_steady", HHT, METHODS[3]),
        *(("sundials_slider_crank", *rivals.METHODS[name]) for name in RIVALS),
        *(("heavy_top", *rivals.METHODS[name]) for name in ("ggl", "hht_i3")),
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
    unknowns, given = np.split(hht.state.factorised.at, [layout.size])
    x = jnp.asarray(unknowns) * (1 + 0.1 * np.random.default_rng(0).standard_normal(layout.size))
    equations = equations_of(method)
    assembled, whole = (
        partial(function, dynamics, method, layout)
        for function in (equations.residual_and_matrix, equations.residual_and_ends)
    )
    both, ends, wanted = values((assembled, whole, jax.jacfwd(whole)), x, jnp.asarray(given))
    residual, blocks = unpack_matrix(layout, both)
    np.testing.assert_array_equal(residual, ends[: layout.size])
    sizes = np.maximum(np.abs(wanted).max(axis=1, keepdims=True), 1e-300)
    np.testing.assert_allclose(blocks / sizes, wanted / sizes, rtol=0, atol=1e-12)
