"""Newton's matrix with predicted tensions, (H61), beside derivatives by hand and on beams in large steps."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering import derive
from hhtbench.lowering.dynamics.mixed import Predicted, mixed
from hhtbench.mechanics.forces import force_of, spring_damper
from tests.sample import slow

K, C, FREE = 300.0, 4.0, 1.0
Q, V = np.array([0.9, 0.7]), np.array([0.4, -0.2])
BEFORE, SPEED = np.array([1.1, 0.3]), np.array([0.1, 0.5])


class Spring(hb.System):
    """A point of 1 kg on a spring and damper from the origin."""

    each: bool = False  # the force is computed by a vmap of one's own

    def force(self, t, q, v):
        def pull(q, v):
            return force_of(lambda x: jnp.sqrt(x @ x)[None], spring_damper(K, C, FREE), q, v)

        return jax.vmap(pull)(q[None], v[None])[0] if self.each else pull(q, v)


def tension(q, v):
    """Tension and its derivatives by q and v."""
    length = np.linalg.norm(q)
    along = q / length
    across = (np.eye(2) - np.outer(along, along)) / length
    return K * (length - FREE) + C * along @ v, K * along + C * across @ v, C * along


def stiffness(tension_there):
    """F_q by hand, with the turn of the spring's direction at ``tension_there``."""
    length = np.linalg.norm(Q)
    along = Q / length
    across = (np.eye(2) - np.outer(along, along)) / length
    return -np.outer(along, tension(Q, V)[1]) - tension_there * across


def jacobian(system, place):
    dynamics = derive(system, 0.0, Q, V)
    with mixed(dynamics, place):
        value = dynamics.force(0.0, Q, V)
        return value, jax.jacfwd(lambda q: dynamics.force(0.0, q, V))(jnp.asarray(Q))


def test_the_derivative_takes_tensions_continued_along_the_last_increment():
    """s(q_p, v_p) + s_q dq + s_v dv, computed by hand."""
    value, found = jacobian(Spring(), Predicted(0.0, BEFORE, SPEED, Q - BEFORE, V - SPEED))
    there, by_q, by_v = tension(BEFORE, SPEED)
    np.testing.assert_allclose(found, stiffness(there + by_q @ (Q - BEFORE) + by_v @ (V - SPEED)), rtol=1e-13)
    assert np.abs(found - stiffness(tension(Q, V)[0])).max() > 10.0
    np.testing.assert_array_equal(value, derive(Spring(), 0.0, Q, V).force(0.0, Q, V))


@pytest.mark.parametrize("each", [False, True])
def test_the_derivative_is_the_plain_one_outside_and_where_tensions_are_computed_in_a_vmap(each):
    place = Predicted(0.0, BEFORE, SPEED, Q - BEFORE, V - SPEED)
    plain = jax.jacfwd(lambda q: derive(Spring(each=each), 0.0, Q, V).force(0.0, q, V))(jnp.asarray(Q))
    np.testing.assert_allclose(plain, stiffness(tension(Q, V)[0]), rtol=1e-13)
    if each:
        np.testing.assert_allclose(jacobian(Spring(each=True), place)[1], plain, rtol=1e-13)


def test_a_beam_turns_by_0_6_rad_a_step():
    """Steps of 0.1 s, up to 6 rad/s; with tensions of the iterate Newton's iteration fails after 3 s."""
    solution = hb.solve(hb.load_problem("spinup_beam"), "hht(alpha=-0.3)", steps=200)
    assert solution.success, solution.message
    assert solution.counters.steps_rejected_newton == 0
    tip = solution.q[-1].reshape(-1, 3)[-1, :2]
    assert np.linalg.norm(tip) == pytest.approx(10.0 + 5.143e-4, abs=3e-4)


@pytest.mark.parametrize(
    ("spec", "rtol"),
    [
        ("spinup_beam", 1e-2),
        ("spinup_beam", 1e-3),
        ("flexible_crank", 1e-2),
        slow("cable_pendulum", 1e-2),
        slow("mooring_line", 1e-3),
    ],
)
def test_beams_and_cables_take_at_most_four_evaluations_a_step(spec, rtol):
    c = hb.solve(hb.load_problem(spec), "hht", rtol=rtol).counters
    assert c.residual_evaluations <= 4.0 * c.steps_accepted
    assert c.steps_rejected_newton <= 0.02 * c.steps_accepted
