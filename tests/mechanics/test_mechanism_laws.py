"""Laws of time, whose numbers are parameters, and contacts with cylinders."""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.mechanics import Mechanism


def angle(rate, bend, t):
    return rate * t + bend * jnp.sin(t)


def push(size, t):
    return size * jnp.stack([jnp.cos(t), t])


def twist(size, t):
    return size * t


def driven(law, pull, torque):
    """A body on a motor under a force and a torque."""
    m = Mechanism((0.0, -9.81), plane=True)
    m.body("bar", 2.0, 0.3, at=(1.0, 0.0))
    m.revolute("pin", "ground", "bar", (0.0, 0.0))
    m.motor("drive", "pin", law)
    m.load("pull", "bar", force=pull, torque=torque)
    return m.system()


def by_numbers(rate, size):
    return driven(partial(angle, rate, 1), partial(push, size), partial(twist, np.float64(size)))


def both(system, t, q):
    return system.force(t, q, 0 * q), system.constraint(t, q)


def test_new_numbers_of_laws_take_effect_without_tracing_again():
    traced = []

    @eqx.filter_jit
    def compiled(system, t, q):
        traced.append(1)
        return both(system, t, q)

    q = np.array([1.1, 0.2, 0.3])
    for rate, size in ((2.0, 3.0), (-4.0, 0.5)):
        plain = driven(lambda t, r=rate: angle(r, 1, t), lambda t, s=size: push(s, t), lambda t, s=size: twist(s, t))
        for found, expected in zip(compiled(by_numbers(rate, size), 0.7, q), both(plain, 0.7, q), strict=True):
            np.testing.assert_allclose(found, expected, rtol=1e-14)
    assert len(traced) == 1
    assert all(leaf.dtype == np.float64 for leaf in jax.tree.leaves(by_numbers(2.0, 3.0)))


def test_what_is_no_number_stays_as_it_is():
    """A partial of another function, as before."""
    scaled = partial(lambda law, t: 2 * law(t), jnp.sin)
    system = driven(scaled, (0.0, 0.0), 0.0)
    found = system.constraint(0.7, np.array([1.0, 0.0, 0.0]))[-1]
    np.testing.assert_allclose(found, -2 * np.sin(0.7), rtol=1e-15)


@pytest.mark.parametrize("plane", [False, True])
def test_cylinders_and_strips_touch_at_their_distance_from_the_axis(plane):
    """A ball of 0.1 m between walls 0.5 m from a slanted axis, and beside a pillar of 0.2 m along it, 0.3 m off the axis."""
    d = 2 if plane else 3
    along, across = np.array([0.6, 0.8, 0.0])[:d], np.array([0.8, -0.6, 0.0])[:d]
    m = Mechanism(plane=plane)
    m.body("pipe", 5.0, 1.0 if plane else np.ones(3), at=np.ones(d))
    m.body("ball", 1.0, 0.1 if plane else np.full(3, 0.1), at=np.ones(d) + 0.3 * across + 0.7 * along)
    for name, radius in (("pipe wall", -0.5), ("pillar", 0.2)):
        given = {"radius": 0.1, "centre": np.ones(d), "other": radius, "axis": 3 * along, "onset": 1e-5}
        m.contact(name, "ball", "pipe", m.bodies["ball"].x, 1e4, **given)
    q, _ = m.start()
    v = m.frame.velocities(q, [np.zeros(d), across + 2 * along], np.zeros(2) if plane else np.zeros((2, 3)))
    gaps, rates, _ = m.system().measured("ball", q, v)
    np.testing.assert_allclose(gaps, [0.1, 0.0], atol=1e-14)
    np.testing.assert_allclose(rates, [-1.0, 1.0], atol=1e-14)
