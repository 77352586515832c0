"""Bodies, joints and forces in the plane: each joint leaves the freedom it should, and mechanisms move as Lagrange says."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.mechanics import forces, plane, space
from tests.lowering.xla import values
from tests.test_docs import run_page

X = np.array([[1.0, 0.0]])
O = np.zeros((1, 2))  # noqa: E741


@pytest.mark.parametrize(
    ("rows", "removed"),
    [
        (lambda at: plane.revolute_rows(at, [0], [1], X, O), 2),
        (lambda at: plane.slot_rows(at, [0], [1], O, O, X), 1),
        (lambda at: plane.angle_rows(at, [0], [1]), 1),
        (lambda at: plane.prismatic_rows(at, [0], [1], O, O, X), 2),
        (lambda at: plane.revolute_rows(at, [0, 1], [-1, -1], [[1.0, 0.0], [0.0, 1.0]], np.ones((2, 2))), 4),
    ],
)
def test_a_joint_takes_away_its_degrees_of_freedom(rows, removed):
    q = jnp.array([0.3, -0.2, 0.7, 1.1, 0.4, -1.3])
    (jacobian,) = values([jax.jacobian(lambda q: rows(plane.placed_with_ground(q)))], q)
    assert jacobian.shape == (removed, 6)
    assert np.linalg.matrix_rank(jacobian) == removed
    if removed < 4:  # a joint between two bodies does not feel where both are
        moved = np.array([[1.0, 0.0, 0.0] * 2, [0.0, 1.0, 0.0] * 2])
        np.testing.assert_allclose(jacobian @ moved.T, 0.0, atol=1e-14)


def test_rows_are_zero_where_a_joint_holds_and_distances_where_not():
    angle = 0.6
    parts = (
        lambda q: plane.revolute_rows(plane.placed_with_ground(q), [0], [-1], [[-2.0, 0.0]], O),
        lambda q: plane.slot_rows(plane.placed_with_ground(q), [0], [-1], O, O, X),
        lambda q: plane.angle_rows(plane.placed_with_ground(q), [0], [-1], [0.5]),
    )
    joined, height, turn = values(parts, jnp.array([2 * np.cos(angle), 2 * np.sin(angle), angle]))
    np.testing.assert_allclose(joined, 0.0, atol=1e-15)
    np.testing.assert_allclose(height, 2 * np.sin(angle))  # above the slot
    np.testing.assert_allclose(turn, 0.1)


def test_a_point_moves_with_its_body():
    q, v = jnp.array([0.3, -0.2, 0.7]), jnp.array([1.0, 2.0, -3.0])
    local = np.array([[0.4, -0.9]])

    def point(q):
        return plane.points_on(plane.placed_with_ground(q), [0], local)

    parts = lambda q, v: jax.jvp(point, (q,), (v,))[1], lambda q, v: plane.velocity_at(v, [0], point(q) - q[:2])
    moving, found = values(parts, q, v)
    np.testing.assert_allclose(found, moving, atol=1e-14)


def test_forces_do_the_work_of_their_elements():
    q, v = jnp.array([0.5, 1.0, 0.2, 2.0, -0.5, 1.0]), jnp.array([0.3, -0.2, 0.9, 0.1, 0.4, -0.6])

    def length(q):
        at = plane.placed_with_ground(q)
        return forces.distances(plane.points_on(at, [0, 1], [[0.1, 0.2], [0.0, 0.3]]), plane.points_on(at, [1, -1], O))

    k, c, free = np.array([3.0, 5.0]), np.array([0.7, 0.2]), np.array([0.4, 0.9])
    parts = (
        lambda q, v: jax.jvp(length, (q,), (v,)),
        lambda q, v: forces.force_of(length, forces.spring_damper(k, c, free), q, v),
        lambda q, v: forces.force_of(length, forces.spring_damper(k, 0.0, free), q, v),
        lambda q, v: jax.grad(lambda q: jnp.sum(jnp.asarray(k) * (length(q) - free) ** 2) / 2)(q),
    )
    (value, rate), found, undamped, slope = values(parts, q, v)
    np.testing.assert_allclose(found @ v, -np.sum((k * (value - free) + c * rate) * rate), rtol=1e-13)
    np.testing.assert_allclose(undamped, -slope, atol=1e-13)


def test_a_load_at_a_point_is_a_force_and_a_moment():
    q = jnp.array([0.5, 1.0, 0.7])

    def point(q):
        return plane.points_on(plane.placed_with_ground(q), [0], [[0.3, -0.4]])

    place, found = values((point, lambda q: forces.force_at(point, [[2.0, -1.0]], q)), q)
    arm = np.asarray(place)[0] - np.asarray(q)[:2]
    np.testing.assert_allclose(found, [2.0, -1.0, arm[0] * -1.0 - arm[1] * 2.0], atol=1e-14)


def test_both_slider_cranks_of_the_page_move_as_one_angle_says(capsys):
    scope = run_page("mechanisms.md")
    assert "claims hold" in capsys.readouterr().out
    a, b, masses, k, c, g = 0.5, 1.2, np.array([1.0, 2.0, 3.0]), 40.0, 2.0, 9.81

    def positions(angle):  # centres and angles of crank, rod and slider
        pin = a * jnp.stack([jnp.cos(angle), jnp.sin(angle)])
        tilt = -jnp.arcsin(pin[1] / b)
        end = pin + b * jnp.stack([jnp.cos(tilt), jnp.sin(tilt)])
        return jnp.concatenate([pin / 2, angle[None], (pin + end) / 2, tilt[None], end, jnp.zeros(1)])

    J = masses * np.array([a**2 / 12, b**2 / 12, 0.01])
    mass = np.column_stack([masses, masses, J]).ravel()

    def kinetic(angle, rate):
        _, v = jax.jvp(positions, (angle,), (rate,))
        return jnp.sum(mass * v**2) / 2

    def potential(angle):
        q = positions(angle)
        return g * (masses @ q[1::3]) + k * (3.0 - q[6] - 1.5) ** 2 / 2

    @jax.jit
    def rhs(t, y):
        angle, rate = y
        inertia = jax.grad(jax.grad(kinetic, 1), 1)(angle, rate)
        gyroscopic = jax.grad(jax.grad(kinetic, 1), 0)(angle, rate) * rate - jax.grad(kinetic, 0)(angle, rate)
        slide = jax.grad(lambda angle: positions(angle)[6])(angle)
        return jnp.stack([rate, (-gyroscopic - jax.grad(potential)(angle) - c * slide**2 * rate) / inertia])

    known = solve_ivp(rhs, (0.0, 2.0), [1.0, 0.0], method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    solution = scope["solution"]
    assert abs(solution.q[-1, 2] - known[0]) < 2e-4
    np.testing.assert_allclose(solution.q[-1], positions(jnp.array(known[0])), atol=3e-4)
    by_name = scope["m"].of(scope["run"], "A").angle()[-1]
    assert abs(by_name - known[0]) < 2e-4


def test_a_wheel_rolls_down_an_incline():
    class Wheel(hb.System):
        mass_matrix: object = hb.parameter([2.0, 2.0, 0.09])

        def force(self, t, q, v):
            return plane.weight_of_bodies([2.0], 9.81 * np.array([np.sin(0.3), -np.cos(0.3)]))

        def velocity_constraint(self, t, q, v):
            return plane.velocity_at(v, [0], [[0.0, -0.3]])[0]

    wheel = hb.Problem(name="wheel", system=Wheel(), t_span=(0.0, 1.0), q0=[0.0, 0.3, 0.0], v0=[0.0, 0.0, 0.0])
    found = hb.solve(wheel, "hht", steps=50)
    expected = 9.81 * np.sin(0.3) / (1 + 0.09 / (2.0 * 0.3**2))  # a disk: two thirds of sliding
    np.testing.assert_allclose(found.v[-1], [expected, 0.0, -expected / 0.3], rtol=1e-10, atol=1e-12)


def test_a_wrong_shape_names_the_argument():
    at = plane.placed_with_ground(jnp.zeros(6))
    for call, reason in (
        (lambda: plane.revolute_rows(at, [0], [1], [0.5, 0.0], O), r"a must have the shape \(1, 2\).*got \(2,\)"),
        (lambda: plane.revolute_rows(at, [0], [1], X, [[0.0, 0.0, 1.0]]), r"b must have the shape \(1, 2\).*got \(1, 3\)"),
        (lambda: plane.revolute_rows(at, [0, 1, 0], [1, 0], X, O), r"first and second .* \(3,\) and \(2,\)"),
        (lambda: plane.slot_rows(at, [0], [1], O, O, [1.0, 0.0]), "along must have"),
        (lambda: plane.velocity_at(jnp.zeros(6), [0, 1], np.zeros((3, 2))), r"offset must have the shape \(2, 2\)"),
    ):
        with pytest.raises(ValueError, match=reason):
            call()


def test_a_body_that_does_not_exist_is_refused():
    """JAX takes the last body for a number beyond it, which would be another mechanism."""
    at = plane.placed_with_ground(jnp.zeros(6))
    for call in (lambda: plane.revolute_rows(at, [0], [3], X, O), lambda: plane.points_on(at, [-2], O)):
        with pytest.raises(ValueError, match=r"names body (3|-2); there are bodies 0 to 1, and the ground is -1 or 2"):
            call()
    with pytest.raises(ValueError, match=r"names body -1; there are bodies 0 to 1\."):
        plane.velocity_at(jnp.zeros(6), [-1], O)  # the ground has no velocity in v
    with pytest.raises(ValueError, match=r"names body 1; there are bodies 0 to 0\."):
        space.velocity_at(jnp.zeros(7), jnp.zeros(7), [1], np.zeros((1, 3)))


def test_sizes_that_are_no_bodies_are_refused():
    for call, reason in (
        (lambda: plane.placed_with_ground(jnp.zeros(4)), "q must hold 3 numbers for each body"),
        (lambda: plane.mass_of_bodies([1.0, 2.0], [1.0]), "m and J must hold a number for each body"),
        (lambda: plane.weight_of_bodies([1.0], [0.0, 0.0, -9.81]), "gravity must have the shape"),
    ):
        with pytest.raises(ValueError, match=reason):
            call()
