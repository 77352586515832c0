"""Bushings against vector mechanics written a second time, differences, SciPy's rotations and the frame's rotation."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hhtbench.mechanics import Mechanism, bushings, forces, plane, space
from tests.lowering.xla import values

FIRST, SECOND = [0, -1], [1, 0]  # a bushing between two bodies and one to the ground
A2, B2 = np.array([[0.4, -0.1], [0.0, 0.3]]), np.array([[-0.2, 0.5], [0.1, 0.1]])
A3, B3 = np.column_stack([A2, [0.2, -0.3]]), np.column_stack([B2, [-0.4, 0.6]])
K3, C3 = np.array([3.0, 5.0, 0.7]), np.array([0.3, 0.2, 0.4])
K6, C6 = np.array([3.0, 5.0, 4.0, 0.7, 0.9, 1.1]), np.array([0.3, 0.2, 0.1, 0.4, 0.5, 0.6])


def in_plane(q):
    return bushings.offsets_in_plane(plane.placed_with_ground(q), FIRST, SECOND, A2, B2)


def in_space(q):
    return bushings.offsets_in_space(space.placed_with_ground(q), FIRST, SECOND, A3, B3)


def state_in_plane():
    return jnp.array([0.3, -0.2, 0.7, 1.1, 0.4, -1.3]), jnp.array([1.0, 2.0, -3.0, 0.4, -0.6, 0.9])


def state_in_space():
    """Two bodies (centre, unit quaternion) and velocities that keep the quaternions' length."""
    random = np.random.default_rng(5)
    p = random.standard_normal((2, 4))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    rate = np.asarray(space.quaternion_rate(p, random.standard_normal((2, 3))))
    x, xdot = random.standard_normal((2, 2, 3))
    return jnp.asarray(np.hstack([x, p]).ravel()), jnp.asarray(np.hstack([xdot, rate]).ravel())


def forces_and_moments(q, force):
    """Forces (2, 3) and moments (2, 3) about the centres, in space: a turn w changes p by ``E^T w / 2``."""
    p, generalised = q.reshape(2, 7)[:, 3:], force.reshape(2, 7)
    return generalised[:, :3], np.einsum("kij,kj->ki", space.space_rate_matrix(p), generalised[:, 3:]) / 2


def test_planar_bushings_push_and_turn_as_vector_mechanics_says():
    q, v = state_in_plane()
    law = forces.spring_damper(K3, C3, 0.0)
    found, offsets = values((lambda q, v: forces.force_of(in_plane, law, q, v), lambda q, v: in_plane(q)), q, v)
    np.testing.assert_allclose(offsets[:, 2], [-1.3 - 0.7, 0.7])  # of the second to the first
    bodies, speeds = (np.vstack([np.asarray(x).reshape(2, 3), np.zeros(3)]) for x in (q, v))
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    expected = np.zeros((3, 3))
    for i, j, a, b in zip(FIRST, SECOND, A2, B2, strict=True):
        R1, R2 = (np.cos(x[2]) * np.eye(2) + np.sin(x[2]) * turn for x in (bodies[i], bodies[j]))
        apart = bodies[j, :2] + R2 @ b - bodies[i, :2] - R1 @ a
        rate = speeds[j, :2] + speeds[j, 2] * turn @ R2 @ b - speeds[i, :2] - speeds[i, 2] * turn @ R1 @ a
        local = R1.T @ (rate - speeds[i, 2] * turn @ apart)  # the rate that the first body sees
        force = -R1 @ (K3[:2] * (R1.T @ apart) + C3[:2] * local)  # on the second
        moment = -K3[2] * (bodies[j, 2] - bodies[i, 2]) - C3[2] * (speeds[j, 2] - speeds[i, 2])
        at = bodies[j, :2] + R2 @ b  # both feel it where the second is held
        for body, sign in ((i, -1.0), (j, 1.0)):
            arm = at - bodies[body, :2]
            expected[body] += sign * np.append(force, moment + arm[0] * force[1] - arm[1] * force[0])
    np.testing.assert_allclose(found, expected[:2].ravel(), rtol=1e-12)


def test_forces_and_moments_in_space_are_in_balance_between_two_bodies():
    """Without the bushing to the ground: no force and no moment in all."""
    q, v = state_in_space()

    def offsets(q):
        return bushings.offsets_in_space(space.placed_with_ground(q), [0], [1], A3[:1], B3[:1])

    (force,) = values([lambda q, v: forces.force_of(offsets, forces.spring_damper(K6, C6, 0.0), q, v)], q, v)
    push, moment = forces_and_moments(q, force)
    assert np.abs(push).min() > 0.1
    np.testing.assert_allclose(push.sum(axis=0), 0.0, atol=1e-13)
    total = moment + np.cross(np.asarray(q).reshape(2, 7)[:, :3], push)
    np.testing.assert_allclose(total.sum(axis=0), 0.0, atol=1e-13)


def test_energy_of_bushings_falls_by_what_their_dampers_take():
    def rate_of_energy(q, v):
        return jax.jvp(lambda q: jnp.sum(jnp.asarray(K6) * in_space(q) ** 2) / 2, (q,), (v,))[1]

    law = forces.spring_damper(K6, C6, 0.0)
    parts = (
        lambda q, v: forces.force_of(in_space, law, q, v) @ v,
        rate_of_energy,
        lambda q, v: forces.power_lost(in_space, law, q, v),
        lambda q, v: jax.jvp(in_space, (q,), (v,))[1],
    )
    power, rate, lost, rates = values(parts, *state_in_space())
    np.testing.assert_allclose(lost, -np.sum(C6 * rates**2), rtol=1e-13)
    np.testing.assert_allclose(power, lost - rate, rtol=1e-12)


def test_small_offsets_of_a_free_bushing_meet_its_six_stiffnesses():
    """Central differences of 1e-4: their own error is of the order of 1e-8."""
    step, centre = 1e-4, np.array([0.1, 0.2, 0.3])

    def force(q):
        at = lambda q: bushings.offsets_in_space(space.placed_with_ground(q), [-1], [0], centre[None], np.zeros((1, 3)))  # noqa: E731
        return forces.force_of(at, forces.spring_damper(K6, C6, 0.0), q, jnp.zeros(7))

    moved = step * np.concatenate([np.eye(3), -np.eye(3)])  # three ways forward, three back
    p = np.roll(Rotation.from_rotvec(moved).as_quat(), 1, axis=1)
    (found,) = values([jax.vmap(force)], jnp.asarray(np.hstack([centre + moved, p])))
    moments = np.einsum("kij,kj->ki", space.space_rate_matrix(p), found[:, 3:]) / 2
    for forward, stiffness in ((np.asarray(found[:, :3]), K6[:3]), (moments, K6[3:])):
        np.testing.assert_allclose((forward[:3] - forward[3:]) / (2 * step), -np.diag(stiffness), atol=1e-7)


@pytest.mark.parametrize("turn", [Rotation.from_rotvec([0.3, -0.8, 0.5]), Rotation.from_rotvec([-2.0, 0.4, 1.1])])
def test_offsets_do_not_feel_a_common_motion_of_both_bodies(turn):
    q, _ = state_in_space()
    bodies = np.array(q).reshape(2, 7)
    moved = turn.apply(bodies[:, :3]) + np.array([0.5, -1.0, 2.0])
    p = np.roll((turn * Rotation.from_quat(np.roll(bodies[:, 3:], -1, axis=1))).as_quat(), 1, axis=1)

    def offsets(q):
        return bushings.offsets_in_space(space.placed_with_ground(q), [0], [1], A3[:1], B3[:1])

    (before,), (after,) = values([offsets], q), values([offsets], jnp.asarray(np.hstack([moved, p]).ravel()))
    np.testing.assert_allclose(after, before, atol=1e-14)


def test_rotation_vectors_are_those_of_scipy_and_smooth_at_rest():
    random = np.random.default_rng(1)
    axes = random.standard_normal((7, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    vectors = axes * np.array([0.0, 1e-9, 1e-3, 0.0632, 0.0633, 1.5, 3.0])[:, None]  # the series ends between
    R = Rotation.from_rotvec(vectors).as_matrix()
    found, slope = values((bushings.rotation_vector, lambda R: jax.jacfwd(bushings.rotation_vector)(R[0])), jnp.asarray(R))
    np.testing.assert_allclose(found, vectors, atol=3e-15 / np.sin(3.0))
    expected = np.zeros((3, 3, 3))  # the axial vector of a matrix
    for i, (j, k) in enumerate(((2, 1), (0, 2), (1, 0))):
        expected[i, j, k], expected[i, k, j] = 0.5, -0.5
    np.testing.assert_allclose(slope, expected, atol=1e-15)


def test_a_bushing_by_name_pushes_towards_its_free_offsets():
    """Drawn without offsets: force and moment are the stiffness times what is missing."""
    free = np.array([0.1, -0.2, 0.3, 0.04, 0.05, -0.06])
    m = Mechanism(np.zeros(3))
    m.body("block", 2.0, (0.3, 0.4, 0.5))
    m.bushing("mount", "ground", "block", np.zeros(3), K6, free=free)
    (force,) = values([partial(m.system().force, 0.0)], *m.start())
    turning = space.space_rate_matrix(m.start()[0][3:][None])[0] @ force[3:] / 2
    np.testing.assert_allclose(np.concatenate([force[:3], turning]), K6 * free, rtol=1e-12)


@pytest.mark.parametrize("first", ["ground", "block"])
def test_a_planar_bushing_acts_along_its_axes(first):
    angle, drawn = 0.5, 0.3
    m = Mechanism((0.0, 0.0), plane=True)
    m.body("block", 2.0, 0.1, at=(1.0, 0.0), turned=drawn)
    second = "block" if first == "ground" else "ground"
    m.bushing("B", first, second, (1.0, 0.0), (100.0, 10.0, 3.0), axes=angle)
    system = m.system()
    force_of = jax.jit(lambda *state: system.force(*state))
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    move = np.array([0.02, 0.01])
    force = np.asarray(force_of(0.0, jnp.array([1.0 + move[0], move[1], drawn]), jnp.zeros(3)))
    right = -100.0 * along * (along @ move) - 10.0 * across * (across @ move)
    np.testing.assert_allclose(force[:2], right, atol=1e-12)
    turned = np.asarray(force_of(0.0, jnp.array([1.0, 0.0, drawn + 0.2]), jnp.zeros(3)))
    np.testing.assert_allclose(turned, [0.0, 0.0, -0.6], atol=1e-12)
