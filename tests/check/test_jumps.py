"""Where prescribed velocities jump: found exactly, with the impulse of a pendulum that is struck at its pivot."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.checks.jumps import find_jumps

TIMES, PLACES = np.array([0.0, 1.0, 2.5, 4.0, 6.0]), np.array([0.0, 0.0, 3.0, 2.0, 2.0])
STARTS = {"t_span": (0.0, 6.0), "q0": [0.0, 0.0, -2.0], "v0": [0.0, 0.0, 0.0]}


class Crane(hb.System):
    """A trolley on a rail that follows ``place``, and a load on a rope of 2 m: (trolley x, load x, load y)."""

    def mass_matrix(self, t, q):
        return jnp.diag(jnp.array([20.0, 5.0, 5.0]))

    def force(self, t, q, v):
        return jnp.stack([0.0, 0.0, -49.05])

    def place(self, t):
        return jnp.interp(t, TIMES, PLACES)

    def constraint(self, t, q):
        return jnp.stack([q[0] - self.place(t), ((q[1] - q[0]) ** 2 + q[2] ** 2 - 4.0) / 2.0])


class Smooth(Crane):
    """The trolley's acceleration jumps at 1 s, and its velocity does not."""

    def place(self, t):
        return jnp.where(t < 1.0, 0.0, (t - 1.0) ** 2) + 0.1 * jnp.sin(20.0 * t)


class Bounced(Crane):
    """Its velocity changes its sign, and is zero at the time itself."""

    def place(self, t):
        return jnp.abs(t - 1.3)


class Turned(Crane):
    """The rail is turned, so that its normal jumps."""

    def constraint(self, t, q):
        return jnp.where(t < 0.1, q[:1], q[1:2] + q[:1])


class Sticky(Crane):
    """A reaction that is no linear function of the multipliers."""

    def reaction(self, t, q, lam):
        return jnp.stack([lam[0] ** 3, 0.0, lam[1]])


class Belt(hb.System):
    """A belt whose speed jumps: a velocity constraint, whose jump acts like a collision."""

    def force(self, t, q, v):
        return 0.0 * q

    def velocity_constraint(self, t, q, v):
        return v - jnp.where(t < 2.0, 1.0, 3.0)


def problem(system, **changes):
    return hb.Problem(name="driven", system=system, **{**STARTS, **changes})


def test_kinks_of_a_table_are_found_exactly():
    found = find_jumps(problem(Crane()))
    assert found.times.tolist() == [1.0, 2.5, 4.0]
    assert not found.declined
    assert np.all(found.after > found.before)
    assert np.all(found.after - found.before <= np.spacing(found.times))


def test_backwards_the_last_kink_comes_first():
    found = find_jumps(problem(Crane(), t_span=(6.0, 0.0)))
    assert found.times.tolist() == [4.0, 2.5, 1.0]
    assert np.all(found.after < found.before)


def test_a_jump_that_is_zero_at_its_own_time_is_one():
    assert find_jumps(problem(Bounced())).times.tolist() == [1.3]


class Fast(Crane):
    """The trolley vibrates: a hundred turns a second over the whole interval, for which no grid is fine."""

    def place(self, t):
        return 0.01 * jnp.sin(200.0 * jnp.pi * t)


class Steep(Crane):
    """A speed that rises within a microsecond: steep, and smooth."""

    def place(self, t):
        return jnp.logaddexp(0.0, 1e6 * (t - 2.0)) * 1e-6


class Fine(Crane):
    """A table of 500 intervals of a sine."""

    def place(self, t):
        times = jnp.linspace(0.0, 6.0, 501)
        return jnp.interp(t, times, jnp.sin(times))


class Small(Crane):
    """A kink of a hundred-millionth of the speed."""

    def place(self, t):
        return t + 1e-8 * jnp.maximum(t - 1.7, 0.0)


def test_every_kink_of_a_fine_table_is_found():
    found = find_jumps(problem(Fine()))
    np.testing.assert_allclose(found.times, np.linspace(0.0, 6.0, 501)[1:-1], rtol=0.0, atol=4e-15)
    assert not found.declined


def test_a_small_kink_is_found():
    np.testing.assert_allclose(find_jumps(problem(Small(), v0=[1.0, 0.0, 0.0])).times, [1.7], atol=1e-6)


@pytest.mark.parametrize("scene", [problem(Smooth()), problem(Fast()), problem(Steep()), hb.load_problem("simple_pendulum")])
def test_smooth_velocities_do_not_jump(scene):
    found = find_jumps(scene)
    assert (found.times.size, found.declined) == (0, "")


@pytest.mark.parametrize(
    ("scene", "reason"),
    [
        (problem(Turned()), "g_q jumps at t = 0.1"),
        (problem(Belt(), q0=[0.0], v0=[1.0]), "k jumps at t = 2"),
        (problem(Sticky()), "the velocities jump at t = 1, and the declared reaction is nonlinear"),
    ],
)
def test_what_has_no_known_impulse_is_declined_by_name(scene, reason):
    assert find_jumps(scene).declined.startswith(reason)


def numpy_crane(**declared):
    def constraint(t, q):
        return np.array([q[0] - np.interp(t, TIMES, PLACES), ((q[1] - q[0]) ** 2 + q[2] ** 2 - 4.0) / 2.0])

    mass = np.diag([20.0, 5.0, 5.0])
    force = lambda t, q, v: np.array([0.0, 0.0, -49.05])  # noqa: E731
    return hb.NumpySystem(force=force, mass_matrix=mass, constraint=constraint, **declared)


def test_differences_across_a_kink_are_declined_and_declared_derivatives_are_exact():
    found = find_jumps(problem(numpy_crane()))
    np.testing.assert_allclose(found.times, [1.0, 2.5, 4.0], atol=1e-6)
    assert "declare constraint_time_derivative" in found.declined

    slopes = np.diff(PLACES) / np.diff(TIMES)
    rates = {
        "constraint_time_derivative": lambda t, q: np.array([-slopes[min(np.searchsorted(TIMES, t, "right") - 1, 3)], 0.0]),
        "constraint_acceleration": lambda t, q, v: np.array([0.0, (v[1] - v[0]) ** 2 + v[2] ** 2]),
    }
    found = find_jumps(problem(numpy_crane(**rates)))
    assert (found.times.tolist(), found.declined) == ([1.0, 2.5, 4.0], "")


@pytest.mark.parametrize("twice", [False, True])
def test_impulse_along_the_rope_turns_the_load(twice):
    """theta' falls by dV cos(theta) / l, since the impulse acts along the rope only (momentum balance)."""

    class Double(Crane):
        def constraint(self, t, q):
            g = super().constraint(t, q)
            return jnp.concatenate([g, g]) if twice else g

    theta, rate = 0.4, 0.7
    q = np.array([0.0, 2.0 * np.sin(theta), -2.0 * np.cos(theta)])
    v = np.array([0.0, 2.0 * rate * np.cos(theta), 2.0 * rate * np.sin(theta)])
    after, impulse = find_jumps(problem(Double())).velocities(0, q, v)
    rate -= 2.0 * np.cos(theta) / 2.0  # the trolley gets 2 m/s
    np.testing.assert_allclose(after, [2.0, 2.0 + 2.0 * rate * np.cos(theta), 2.0 * rate * np.sin(theta)], rtol=1e-13)
    rope = 5.0 * (after - v)[1] / (0.0 - q[1])  # m dv = -G^T p, by the load's row
    np.testing.assert_allclose(impulse[1::2].sum(), rope, rtol=1e-12)


def test_a_table_of_many_places_is_searched_whole_in_plain_functions():
    times = np.linspace(0.0, 12.0, 122)
    places, slopes = np.sin(times), np.diff(np.sin(times)) / np.diff(times)
    system = hb.NumpySystem(
        force=lambda t, q, v: np.zeros(1),
        constraint=lambda t, q: q - np.interp(t, times, places),
        constraint_jacobian=lambda t, q: np.ones((1, 1)),
        constraint_time_derivative=lambda t, q: -slopes[[np.clip(np.searchsorted(times, t, "right") - 1, 0, 120)]],
        constraint_acceleration=lambda t, q, v: np.zeros(1),
    )
    found = find_jumps(hb.Problem(name="table", system=system, t_span=(0.0, 12.0), q0=[0.0], v0=[slopes[0]]))
    np.testing.assert_allclose(found.times, times[1:-1], atol=1e-9)
