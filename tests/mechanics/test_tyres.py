"""Tyres against closed solutions: sinkage, locked and spinning wheels, slip angles, a steady turn."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.mechanics import Mechanism, space, tyres
from tests.lowering.xla import values
from tests.sample import slow

K, RADIUS, MASS = 2e5, 0.3, 20.0
X, Y, Z = np.eye(3)
GRIP = (0.8, 12.0, 9.0, 0.01)
SINKAGE = MASS * 9.81 / K


def wheel(plane, velocity=0.0, rate=0.0, R=None):
    """A wheel that its weight presses into the road y = 0 or z = 0, or one turned by ``R``; it rolls along x."""
    R = np.eye(3) if R is None else R
    side = (lambda v: np.array([v[0], v[2]])) if plane else (lambda v: R @ v)
    m = Mechanism(gravity=side(-9.81 * Z), plane=plane)
    kept = {"turned": None if plane else R, "rate": -rate if plane else R @ (rate * Y)}
    inertia = 0.9 if plane else (0.5, 0.9, 0.5)
    at = (RADIUS - SINKAGE) * Z
    m.body("wheel", MASS, inertia, at=side(at), velocity=side(np.multiply(velocity, X)), **kept)
    axis = {} if plane else {"axis": side(Y)}
    road = {"point": side(0 * Z), "normal": side(Z), "grip": GRIP, "onset": 1e-9}
    m.tyre("tyre", "wheel", "ground", side(at), RADIUS, K, loss=0.5, **axis, **road)
    return m, side


@pytest.mark.parametrize("plane", [True, False])
def test_standing_wheel_sinks_by_its_weight_over_the_stiffness(plane):
    m, side = wheel(plane)
    found = hb.solve(m.problem((0, 0.5)), "projected", rtol=1e-8)
    assert found.status.label == "success"
    np.testing.assert_allclose(found.q[-1, : 2 if plane else 3], side((RADIUS - SINKAGE) * Z), atol=1e-8)
    np.testing.assert_allclose(m.of(found, "tyre").measure(), -SINKAGE, rtol=1e-5)


@pytest.mark.parametrize("plane", [True, slow(False)])
def test_spinning_wheel_begins_to_roll_with_its_moment_of_momentum_about_the_road(plane):
    turned = np.asarray(space.rotation(jnp.array([0.5, 0.1, -0.7, 0.5])))
    m, side = wheel(plane, rate=30.0, R=None if plane else turned)
    found = hb.solve(m.problem((0, 6)), "scipy(method=Radau)", rtol=1e-8)
    lever = RADIUS - SINKAGE
    rolling = 0.9 * 30.0 / (0.9 + MASS * lever**2)  # whatever the law of friction
    reading = m.of(found, "wheel")
    pulled = m.of(found, "tyre").friction() + m.of(found, "tyre").tension()[:, None] * -side(Z) - MASS * 9.81 * side(Z)
    np.testing.assert_allclose(pulled, MASS * reading.acceleration(), atol=1e-9 * MASS * 9.81)
    np.testing.assert_allclose(reading.velocity()[-1], side(rolling * lever * X), atol=1e-5)
    rate = -reading.rate()[-1] if plane else reading.rate()[-1] @ side(Y)
    np.testing.assert_allclose(rate, rolling, rtol=1e-5)


def test_locked_wheel_brakes_by_the_friction_of_full_slip():
    m, _ = wheel(plane=True, velocity=10.0)
    system = m.system()
    q, v = m.start()
    force = values([lambda q, v: system.force(0.0, q, v)], q, v)[0]
    along, mu = GRIP[1], GRIP[0]
    np.testing.assert_allclose(force[0], -MASS * 9.81 * along / np.hypot(1.0, along / mu), rtol=1e-5)
    np.testing.assert_allclose(force[2], force[0] * (RADIUS - SINKAGE), rtol=1e-9)


@pytest.mark.parametrize("angle", [1e-4, 0.05, 0.5])
def test_rolling_wheel_at_a_slip_angle_is_pushed_aside_alone(angle):
    speed, mu, across = 10.0, GRIP[0], GRIP[2]
    travel = speed * np.array([[np.cos(angle), np.sin(angle), 0.0]])
    rolls = travel * [[0.0, 1.0, 0.0]]  # where it touches it moves aside only
    (found,) = values([lambda w: tyres.slip_force(jnp.array([500.0]), w, travel, X[None], jnp.array(GRIP))], rolls)
    slip = across * np.sin(angle) / mu
    np.testing.assert_allclose(found, [[0.0, -mu * 500.0 * slip / np.hypot(1.0, slip), 0.0]], rtol=1e-5)


@pytest.mark.long
def test_car_turns_at_the_rate_of_the_single_track_model():
    """Rate ``V d / (L + m V^2 (b / C1 - a / C2) / L)`` at the steering angle d, axles a and b from the centre."""
    mass, speed, steer, ahead, behind, height = 800.0, 12.0, 0.01, 1.1, 1.6, 0.5
    loads = {"front": 4500.0, "rear": 3300.0}
    m = Mechanism(gravity=(0, 0, 0))
    m.body("car", mass, (300.0, 900.0, 1000.0), at=(0, 0, height), velocity=(speed, 0, 0))
    m.planar("level", "ground", "car", (0, 0, height), Z)
    for name, x, d in (("front", ahead, steer), ("rear", -behind, 0.0)):
        radius = 0.3 + loads[name] / K
        axle = np.array([-np.sin(d), np.cos(d), 0.0])
        at = (x, 0, 0.3)
        m.body(name, 1e-2, (1e-2, 1e-2, 1e-2), at=at, velocity=(speed, 0, 0), rate=speed / 0.3 * axle)
        m.revolute(f"axle {name}", "car", name, at, axle)
        m.tyre(f"tyre {name}", name, "ground", at, radius, K, axis=axle, point=0 * Z, normal=Z, grip=GRIP, onset=1e-6)
    m.assemble()
    found = hb.solve(m.problem((0, 4)), "hht", rtol=1e-4)
    V = np.linalg.norm(m.of(found, "car").velocity()[-1])
    stiffness = {name: GRIP[2] * load for name, load in loads.items()}
    L = ahead + behind
    under = mass / L * (behind / stiffness["front"] - ahead / stiffness["rear"])
    expected = V * steer / (L + under * V**2)
    assert abs(under * V**2 / L) > 0.02  # the tyres matter
    np.testing.assert_allclose(m.of(found, "car").rate()[-1, 2], expected, rtol=2e-3)
