"""Faults a reader found: each was silently wrong once."""

from __future__ import annotations

import pickle

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


class FarRod(hb.System):
    x0: object = hb.parameter(0.0)

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([((q[0] - self.x0) ** 2 + q[1] ** 2 - 1) / 2])


@pytest.mark.parametrize("steps", [10, 1000])
def test_a_drive_that_starts_from_rest_is_followed_from_the_first_step(steps):
    solution = HHT(Cam()).solve((0, 1), [1, 0], [0, 0], steps=steps)
    assert solution.success
    np.testing.assert_allclose(solution.q[:, 0], 1 + solution.t**4, rtol=0, atol=1e-14)
    np.testing.assert_allclose(solution.v[:, 0], 4 * solution.t**3, rtol=0, atol=1e-14)


@pytest.mark.parametrize("x0", [1e4, 1e5, 1e6])
def test_coordinates_far_from_the_origin_cost_roundoff_and_not_the_run(x0):
    near = HHT(FarRod()).solve((0, 1), [1, 0], [0, 0], steps=100)
    far = HHT(FarRod(x0=x0)).solve((0, 1), [1 + x0, 0], [0, 0], steps=100)
    assert far.success
    np.testing.assert_allclose(far.q[-1] - [x0, 0], near.q[-1], rtol=0, atol=1e3 * np.finfo(float).eps * x0)


def pendulum(**declared):
    return hb.NumpySystem(
        force=lambda t, q, v: np.array([0.0, -9.81]), constraint=lambda t, q: np.array([(q @ q - 1) / 2]), **declared
    )


def test_a_constraint_jacobian_frozen_at_the_start_is_found_and_replaced():
    frozen = pendulum(constraint_jacobian=lambda t, q: np.array([[1.0, 0.0]]))
    right = HHT(pendulum(constraint_jacobian=lambda t, q: q[None, :])).solve((0, 1), [1, 0], [0, 0], steps=100)
    with pytest.warns(UserWarning, match="constraint_jacobian"):
        solution = HHT(frozen).solve((0, 1), [1, 0], [0, 0], steps=100)
    np.testing.assert_allclose(solution.q[-1], right.q[-1], atol=1e-7)


def test_a_pattern_without_a_true_entry_is_refused_with_its_rows():
    system = pendulum(sparsity={"constraint_jacobian": np.array([[True, False]])})
    with pytest.raises(hb.ProblemError, match=r"constraint_jacobian.*rows \[0\]"):
        HHT(system).solve((0, 1), [0.6, -0.8], [0, 0], steps=10)


@pytest.mark.parametrize(
    ("sparsity", "text"),
    [({"constraint_jacobian": np.ones((2, 2), bool)}, r"\(1, 2\)"), ({"force": np.ones((2, 2), bool)}, "force_q")],
)
def test_a_pattern_of_the_wrong_shape_or_name_is_refused(sparsity, text):
    with pytest.raises(hb.ProblemError, match=text):
        HHT(pendulum(sparsity=sparsity)).solve((0, 1), [0.6, -0.8], [0, 0], steps=10)


def test_a_right_pattern_changes_nothing():
    full = {"constraint_jacobian": np.ones((1, 2), bool), "force_q": np.zeros((2, 2), bool)}
    plain = HHT(pendulum()).solve((0, 1), [0.6, -0.8], [0, 0], steps=20)
    patterned = HHT(pendulum(sparsity=full)).solve((0, 1), [0.6, -0.8], [0, 0], steps=20)
    np.testing.assert_allclose(patterned.q, plain.q, atol=1e-11)


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


def test_a_singular_kkt_matrix_is_named_and_not_taken_for_a_callback_that_returned_nan():
    system = hb.NumpySystem(
        force=lambda t, q, v: np.zeros(2),
        mass_matrix=np.diag([1.0, 0.0]),
        constraint=lambda t, q: np.array([(q @ q - 1) / 2]),
    )
    assert HHT(system).solve((0, 1), [1, 0], [0, 0], steps=5).status is hb.Status.singular_iteration_matrix


def test_an_interval_longer_than_a_float_is_refused():
    with pytest.raises(hb.ProblemError, match="interval"):
        HHT(Cam()).solve((-1.7e308, 1.7e308), [1, 0], [0, 0], steps=5)


def test_a_saved_state_goes_on_in_a_new_object():
    first = HHT(FarRod(), alpha=-0.3)
    first.init_step(0.0, [1, 0], [0, 0], step=1 / 64)
    for _ in range(8):
        first.step()
    second = HHT(FarRod(), alpha=-0.3)
    second.restart(pickle.loads(pickle.dumps(first.state)), step=1 / 64)
    first.step()
    assert second.step() is hb.Status.success
    assert second.state.q.tobytes() == first.state.q.tobytes()
    assert second.state.v.tobytes() == first.state.v.tobytes()


def test_stepping_by_hand_tells_what_happened_and_counts():
    hht = HHT(FarRod())
    assert hht.init_step(0.0, [1.1, 0], [0, 0], step=0.01, calc_initcond=True) is hb.Status.success
    assert "moved q0 by 0.1" in hht.message
    hht.step()
    assert hht.counters.newton_iterations > 0
    assert HHT(FarRod()).init_step(0.0, [1.1, 0], [0, 0], step=0.01) is hb.Status.inconsistent_initial


def test_close_to_one_half_the_failure_names_b():
    with pytest.warns(UserWarning, match="1/2"):
        solution = HHT(FarRod(), b=0.5 + 1e-12).solve((0, 1), [1, 0], [0, 0], steps=10)
    assert not solution.success
    assert "b is close to" in solution.message


@pytest.mark.parametrize("end", [1.0, -1.0])
def test_a_run_that_fails_in_its_first_step_returns_the_reached_output_times_in_both_directions(end):
    system = hb.NumpySystem(force=lambda t, q, v: np.array([np.nan if t else 0.0]))
    solution = HHT(system).solve((0.0, end), [1.0], [0.0], steps=4, t_eval=[0.0, end / 2, end])
    assert solution.status is hb.Status.nonfinite_callback
    assert solution.t.tolist() == [0.0]
