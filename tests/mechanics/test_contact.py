"""Contact and friction against closed solutions: restitution, stopping distance, rolling, balance of forces."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

import hhtbench as hb
from hhtbench.mechanics import contact, forces, plane, space
from tests.lowering.xla import values

K, LOSS, ONSET = 1e6, 0.3, 1e-6
SLOPE = np.array([0.6, 0.0, 0.8])  # normal of the plane that the sphere hits


class Ball(hb.System):
    """A sphere of 2 kg and 0.1 m that meets a plane; no weight."""

    mass_matrix = 2.0

    def gaps(self, q):
        return contact.on_plane(q[None], 0.1, jnp.asarray([0.5, 0.2, -0.3]), SLOPE).gap

    def force(self, t, q, v):
        return forces.force_of(self.gaps, contact.hunt_crossley(K, LOSS, ONSET), q, v)


def restitution(speed):
    """Root of the energy integral of Hunt's and Crossley's equation: ``G(u) = G(-e u)`` with ``G = v - ln(1 + a v) / a``.

    From ``m v dv = -k s^n (1 + a v) ds`` with a = 1.5 c, whatever k and n.
    """
    a = 1.5 * LOSS
    G = lambda v: v - np.log1p(a * v) / a  # noqa: E731
    return brentq(lambda e: G(speed) - G(-e * speed), 0.0, 1.0, xtol=1e-14)


@pytest.mark.parametrize("speed", [0.05, 1.0])
def test_a_sphere_leaves_the_plane_as_hunt_and_crossley_say(speed):
    side = np.array([0.8, 0.0, -0.6])  # along the plane, which keeps this part
    q0 = np.array([0.5, 0.2, -0.3]) + (0.1 + 0.01 * speed) * SLOPE
    ball = hb.Problem(name="ball", system=Ball(), t_span=(0.0, 0.2), q0=q0, v0=0.3 * side - speed * SLOPE)
    found = hb.solve(ball, "scipy(method=DOP853)", rtol=1e-11)
    leaving = found.v[-1] @ SLOPE
    assert found.status.label == "success"
    np.testing.assert_allclose(found.v[-1] @ side, 0.3, rtol=1e-12)
    np.testing.assert_allclose(leaving / speed, restitution(speed), atol=2e-6)  # what acts at a gap of 2e-3 m is left out
    if speed < 0.1:  # their own formula, with an error of the order of the square
        np.testing.assert_allclose(leaving / speed, 1 - LOSS * speed, atol=(LOSS * speed) ** 2)


def test_depth_and_duration_of_an_impact_are_those_of_the_scalar_equation():
    def rhs(t, y):
        s = max(-y[0], 0.0)
        return [y[1], K / 2.0 * s**1.5 * (1 - 1.5 * LOSS * y[1])]

    t = np.linspace(0.0, 0.02, 41)
    known = solve_ivp(rhs, (0.0, 0.02), [0.005, -1.0], method="DOP853", rtol=1e-10, atol=1e-13, max_step=1e-4, t_eval=t).y
    q0 = np.array([0.5, 0.2, -0.3]) + 0.105 * SLOPE
    ball = hb.Problem(name="ball", system=Ball(), t_span=(0.0, 0.02), q0=q0, v0=-SLOPE)
    found = hb.solve(ball, "scipy(method=DOP853)", rtol=1e-10, t_eval=t)
    gap = (found.q - [0.5, 0.2, -0.3]) @ SLOPE - 0.1
    assert gap.min() < -0.005
    np.testing.assert_allclose(gap, known[0], atol=1e-7)  # the onset of 1e-6 m shifts the contact by e^2 / (4 s)
    np.testing.assert_allclose(found.v @ SLOPE, known[1], atol=1e-4)


def test_energy_of_contact_is_what_its_force_does_without_loss():
    gaps = jnp.array([-0.3, -1e-3, -1e-5, 0.0, 1e-5, 0.2])
    k, e = np.linspace(1.0, 2.0, 6), 1e-4
    for power in (1.0, 1.5, 2.0):
        law = contact.hunt_crossley(k, LOSS, e, power)
        parts = (
            lambda g, law=law: law(g, 0 * g),
            lambda g, power=power: jax.grad(lambda g: contact.contact_energy(g, k, e, power))(g),
        )
        tension, slope = values(parts, gaps)
        np.testing.assert_allclose(tension, slope, rtol=1e-12)
        np.testing.assert_allclose(tension[0], -k[0] * 0.3**power, rtol=1e-6)


def test_contact_pushes_however_fast_bodies_part():
    rates = jnp.linspace(-20.0, 20.0, 9)
    (tension,) = values([lambda r: contact.hunt_crossley(K, LOSS, ONSET)(-0.01 + 0 * r, r)], rates)
    assert (tension <= 0).all()
    assert (tension[np.asarray(rates) > 1 / (1.5 * LOSS)] == 0).all()
    assert (np.diff(tension) >= 0).all()


class Slider(hb.System):
    """A body of 2 kg in the plane on the ground y = 0, a disk of 0.1 m; ``held`` keeps it from turning: a block."""

    held: bool = False

    mass_matrix = (2.0, 2.0, 0.01)

    def contacts(self, q):
        return contact.on_plane(q[None, :2], 0.1, np.zeros(2), np.array([0.0, 1.0]))

    def force(self, t, q, v):
        gap, law = lambda q: self.contacts(q).gap, contact.hunt_crossley(K, LOSS, 1e-5)
        push = -law(*forces.rates(gap, q, v))
        drag = contact.friction_force(plane, [0], [-1], self.contacts(q), push, (0.3, 0.05), q, v)
        drag = drag * jnp.array([1.0, 1.0, 0.0 if self.held else 1.0])
        return plane.weight_of_bodies([2.0], jnp.array([0.0, -9.81])) + forces.force_of(gap, law, q, v) + drag


def resting(held, t_end):
    """The body at 1.5 m/s, as deep in the ground as its weight presses it: ``gap = e^2 / (4 s) - s``."""
    s = (2.0 * 9.81 / K) ** (2 / 3)
    q0 = [0.0, 0.1 + 1e-10 / (4 * s) - s, 0.0]
    return hb.Problem(name="slider", system=Slider(held=held), t_span=(0.0, t_end), q0=q0, v0=[1.5, 0.0, 0.0])


def test_a_sliding_block_stops_where_the_closed_solution_says():
    """``x = integral of sqrt(v^2 + w0^2) dv / (mu g)`` from 0 to 1.5, the creep w0 included."""
    found = hb.solve(resting(True, 1.6), "scipy(method=Radau)", rtol=1e-9)
    v, w = 1.5, 0.05
    expected = (v * np.hypot(v, w) + w**2 * np.arcsinh(v / w)) / (2 * 0.3 * 9.81)
    assert abs(found.v[-1, 0]) < 1e-9
    np.testing.assert_allclose(found.q[-1, 0], expected, rtol=1e-7)


def test_a_sliding_disk_rolls_in_the_end_at_about_two_thirds_of_its_speed():
    """Friction acts at the point of contact, about which the momentum stays, whatever its law; its arm is 0.7 % shorter."""
    disk = resting(False, 2.0)
    found, arm = hb.solve(disk, "scipy(method=Radau)", rtol=1e-9), disk.q0[1]
    speed = 1.5 / (1 + 0.01 / (2.0 * arm**2))
    np.testing.assert_allclose(found.v[-1], [speed, 0.0, -speed / arm], rtol=1e-7, atol=1e-9)


RANDOM = np.random.default_rng(3)
CENTRE, OTHER, AXIS = RANDOM.standard_normal((3, 4, 3))
AXIS /= np.linalg.norm(AXIS, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("made", "expected"),
    [
        (lambda x, o, n: contact.on_plane(x, 0.2, o, n), np.sum((CENTRE - OTHER) * AXIS, axis=1) - 0.2),
        (lambda x, o, n: contact.on_sphere(x, 0.2, o, 0.3), np.linalg.norm(CENTRE - OTHER, axis=1) - 0.5),
        (lambda x, o, n: contact.on_sphere(x, 0.2, o, 0.0), np.linalg.norm(CENTRE - OTHER, axis=1) - 0.2),
        (lambda x, o, n: contact.on_sphere(x, 0.2, o, -3.0), 2.8 - np.linalg.norm(CENTRE - OTHER, axis=1)),
        (
            lambda x, o, n: contact.on_cylinder(x, 0.2, o, n, 0.3),
            np.linalg.norm(np.cross(CENTRE - OTHER, AXIS), axis=1) - 0.5,
        ),
        (
            lambda x, o, n: contact.on_cylinder(x, 0.2, o, n, -3.0),
            2.8 - np.linalg.norm(np.cross(CENTRE - OTHER, AXIS), axis=1),
        ),
    ],
    ids=["plane", "sphere", "point", "inside a sphere", "cylinder", "inside a cylinder"],
)
def test_gaps_normals_and_points_are_those_of_geometry_in_every_frame(made, expected):
    turn = Rotation.from_rotvec([0.4, -1.2, 0.7])
    gap_slope = jax.jacfwd(lambda *given: made(*given).gap)
    found, slope = values([made, gap_slope], *(jnp.asarray(x) for x in (CENTRE, OTHER, AXIS)))
    (moved,) = values([made], *(jnp.asarray(turn.apply(x)) for x in (CENTRE, OTHER, AXIS)))
    np.testing.assert_allclose(found.gap, expected, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=1), 1.0)
    np.testing.assert_allclose(CENTRE - found.point, (found.gap + 0.2)[:, None] * found.normal, atol=1e-14)
    np.testing.assert_allclose(moved.gap, found.gap, atol=1e-14)
    for key in ("normal", "point"):
        np.testing.assert_allclose(getattr(moved, key), turn.apply(np.array(getattr(found, key))), atol=1e-14)
    np.testing.assert_allclose(
        np.asarray(slope)[range(4), range(4)], found.normal, atol=1e-14
    )  # the gap grows along the normal


def circles(q):
    return contact.on_sphere(q.reshape(2, 3)[:1, :2], 0.3, q.reshape(2, 3)[1:, :2], 0.5)


def spheres(q):
    return contact.on_sphere(q.reshape(2, 7)[:1, :3], 0.3, q.reshape(2, 7)[1:, :3], 0.5)


def pushed(frame, contacts, q, v):
    """Generalised force of contact and friction between bodies 0 and 1, and its power beside that of the parts."""
    gap, law = lambda q: contacts(q).gap, contact.hunt_crossley(K, LOSS, ONSET)
    push = forces.force_of(gap, law, q, v)
    drag = contact.friction_force(frame, [0], [1], contacts(q), -law(*forces.rates(gap, q, v)), (0.4, 0.01), q, v)
    return push, drag, drag @ v


def test_circles_push_and_rub_with_equal_and_opposite_forces_and_moments():
    q, v = jnp.array([0.0, 0.0, 0.3, 0.6, 0.5, -0.4]), jnp.array([0.7, 0.1, 2.0, -0.2, 0.4, -1.0])
    push, drag, power = values([lambda q, v: pushed(plane, circles, q, v)], q, v)[0]
    total = (push + drag).reshape(2, 3)
    x = np.asarray(q).reshape(2, 3)[:, :2]
    np.testing.assert_allclose(total[:, :2].sum(axis=0), 0.0, atol=1e-11 * np.abs(total).max())
    moment = total[:, 2] + x[:, 0] * total[:, 1] - x[:, 1] * total[:, 0]
    np.testing.assert_allclose(moment.sum(), 0.0, atol=1e-11 * np.abs(total).max())
    normal, drag = (x[0] - x[1]) / np.linalg.norm(x[0] - x[1]), drag.reshape(2, 3)
    assert push[:2] @ normal > 0
    np.testing.assert_allclose(
        np.hypot(*drag[0, :2]), 0.4 * push[:2] @ normal, rtol=1e-3
    )  # slides far faster than it creeps
    np.testing.assert_allclose(drag[0, :2] @ normal, 0.0, atol=1e-12 * push[:2] @ normal)
    assert power < 0


def test_spheres_push_and_rub_with_equal_and_opposite_forces_and_moments():
    p = RANDOM.standard_normal((2, 4))
    p /= np.linalg.norm(p, axis=1, keepdims=True)
    rate = np.asarray(space.quaternion_rate(p, RANDOM.standard_normal((2, 3))))
    x = np.array([[0.0, 0.0, 0.0], [0.5, 0.4, -0.4]])
    q = jnp.asarray(np.hstack([x, p]).ravel())
    v = jnp.asarray(np.hstack([RANDOM.standard_normal((2, 3)), rate]).ravel())
    push, drag, power = values([lambda q, v: pushed(space, spheres, q, v)], q, v)[0]
    total = (push + drag).reshape(2, 7)
    moment = np.einsum("kij,kj->ki", space.space_rate_matrix(p), total[:, 3:]) / 2 + np.cross(x, total[:, :3])
    size = np.abs(total).max()
    np.testing.assert_allclose(total[:, :3].sum(axis=0), 0.0, atol=1e-11 * size)
    np.testing.assert_allclose(moment.sum(axis=0), 0.0, atol=1e-11 * size)
    assert power < 0
