"""Faults a reader found: each was silently wrong once."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp

import hhtbench as hb
from solvers.hht import HHT


class Cam(hb.System):
    """A free mass beside one driven from rest as t^4: v and the acceleration are zero at the start."""

    def force(self, t, q, v):
        return jnp.zeros(2)

    def constraint(self, t, q):
        return jnp.stack([q[0] - 1 - t**4])


def pendulum(**declared):
    return hb.NumpySystem(
        force=lambda t, q, v: np.array([0.0, -9.81]), constraint=lambda t, q: np.array([(q @ q - 1) / 2]), **declared
    )


def test_a_pattern_without_a_true_entry_is_refused_with_its_rows():
    system = pendulum(sparsity={"constraint_jacobian": np.array([[True, False]])})
    with pytest.raises(hb.ProblemError, match=r"constraint_jacobian.*rows \[0\]"):
        HHT(system).solve((0, 1), [0.6, -0.8], [0, 0], steps=10)


def patterned(patterns):
    """A point on a circle as a JAX system that declares ``patterns``."""

    class Patterned(hb.System):
        sparsity = patterns

        def force(self, t, q, v):
            return jnp.array([0.0, -9.81])

        def constraint(self, t, q):
            return (q @ q - 1)[None] / 2

    return Patterned()


@pytest.mark.parametrize("kind", [sp.csr_matrix, sp.coo_array])
def test_a_pattern_may_be_one_of_scipys_matrices_for_jax_systems_too(kind):
    full, empty = kind(np.ones((1, 2), bool)), kind(np.zeros((2, 2), bool))
    plain = HHT(pendulum()).solve((0, 1), [0.6, -0.8], [0, 0], steps=20)
    system = patterned({"constraint_jacobian": full, "force_q": empty})
    np.testing.assert_allclose(HHT(system).solve((0, 1), [0.6, -0.8], [0, 0], steps=20).q, plain.q, atol=1e-9)
    with pytest.raises(hb.ProblemError, match=r"constraint_jacobian.*rows \[0\]"):
        HHT(patterned({"constraint_jacobian": kind([[True, False]])})).solve((0, 1), [0.6, -0.8], [0, 0], steps=10)


def test_patterns_that_are_no_mapping_are_refused_for_jax_systems_too():
    with pytest.raises(TypeError, match="sparsity must map names"):
        HHT(patterned(5)).solve((0, 1), [0.6, -0.8], [0, 0], steps=10)


def test_options_in_the_wrong_place_are_refused():
    with pytest.raises(TypeError, match="when it is made"):
        HHT(Cam()).solve((0, 1), [1, 0], [0, 0], steps=2, options={"alpha": -0.2})
    with pytest.raises(TypeError, match="calc_initcond"):
        HHT(Cam(), calc_initcond=True)


@pytest.mark.parametrize("end", [1.0, -1.0])
def test_a_run_that_fails_in_its_first_step_returns_the_reached_output_times_in_both_directions(end):
    system = hb.NumpySystem(force=lambda t, q, v: np.array([np.nan if t else 0.0]))
    solution = HHT(system).solve((0.0, end), [1.0], [0.0], steps=4, t_eval=[0.0, end / 2, end])
    assert solution.status is hb.Status.nonfinite_callback
    assert solution.t.tolist() == [0.0]
