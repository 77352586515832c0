"""The car axis, the flexible slider crank and that of SUNDIALS."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import eigh

from tests.problems.mechanics import compiled, consistent_state
from tests.problems.published import STORED
from tests.problems.published_tables import PUBLISHED


def test_car_axis_reaches_the_published_state_in_minimal_coordinates():
    """Length s of the left spring and angle of the chassis; the left spring stands across the axle."""
    L, L0, K, r, w = 1.0, 0.5, 10 * 0.01**2 / 2, 0.1, 10.0

    def places(t, x):
        y = r * jnp.sin(w * t)
        base = jnp.stack([jnp.sqrt(L**2 - y**2), y])
        left = x[0] / L * jnp.stack([-base[1], base[0]])
        return left, left + L * jnp.stack([jnp.cos(x[1]), jnp.sin(x[1])]), base

    def lagrangian(t, x, u):
        (left, right, base), rates = jax.jvp(places, (t, x), (1.0, u))
        stretch = jnp.stack([x[0] - L0, jnp.linalg.norm(right - base) - L0])
        return K / 2 * (rates[0] @ rates[0] + rates[1] @ rates[1]) - stretch @ stretch / 2 - K * (left[1] + right[1])

    @jax.jit
    def rate(t, y):
        x, u = y[:2], y[2:]
        momentum = jax.grad(lagrangian, 2)
        drift = jax.jvp(lambda t, x: momentum(t, x, u), (t, x), (1.0, u))[1]
        return jnp.concatenate(
            [u, jnp.linalg.solve(jax.hessian(lagrangian, 2)(t, x, u), jax.grad(lagrangian, 1)(t, x, u) - drift)]
        )

    # left' = (-s w r, s') / L at the start: x' = -1/2 belongs to the turning axle, so s' and the angle begin at rest
    found = solve_ivp(rate, (0.0, 3.0), [L0, 0.0, 0.0, 0.0], method="DOP853", rtol=1e-10, atol=1e-11).y[:, -1]
    q, v = jax.jvp(lambda t, x: jnp.concatenate(places(t, x)[:2]), (3.0, found[:2]), (1.0, found[2:]))
    np.testing.assert_allclose(q, np.array(STORED["car_axis"]["q"], dtype=float), rtol=0, atol=1e-9)
    np.testing.assert_allclose(v, np.array(STORED["car_axis"]["v"], dtype=float), rtol=0, atol=1e-7)


def test_car_axis_draws_the_wheel_where_the_road_has_it(make, mechanics):
    problem = make("car_axis")
    t, q, _ = consistent_state(problem, mechanics(problem.system), 7)
    np.testing.assert_allclose(problem.sketch(q)["points"][1], problem.system.base(t), rtol=0, atol=1e-14)


def test_kinetic_energy_of_the_elastic_rod_is_that_of_its_points(make):
    """Gauss points along the rod; the source's mass of q3, q4 alone is not that of the shapes but 15 times as large."""
    system = make("slider_crank_flexible").system
    nodes, weights = np.polynomial.legendre.leggauss(20)
    s, weights = (nodes + 1) / 2, weights / 2
    rod = float(system.rho * system.B * system.H * system.L2)

    def points(q):
        along = system.L2 * s + 4 * s * (1 - s) * q[5] + s * (2 * s - 1) * q[6]
        across = jnp.sin(jnp.pi * s) * q[3] + jnp.sin(2 * jnp.pi * s) * q[4]
        (c, S), (c1, S1) = ((jnp.cos(a), jnp.sin(a)) for a in (q[1], q[0]))
        return jnp.stack([system.L1 * c1 + along * c - across * S, system.L1 * S1 + along * S + across * c])

    q = np.array([0.4, -0.3, 0.4, 2e-2, -1e-2, 3e-3, 1e-3])
    v = np.random.default_rng(2).standard_normal(7)
    rates = np.asarray(jax.jvp(points, (q,), (v,))[1])
    kinetic = rod / 2 * weights @ np.sum(rates**2, axis=0) + float(system.M3) * v[2] ** 2 / 2
    crank = float(system.J1) + rod * float(system.H) ** 2 / 12 * (v[1] / v[0]) ** 2  # rod's section turns with it
    kinetic += crank * v[0] ** 2 / 2
    shapes = rod * np.array([[8, 1], [1, 2]]) / 15
    kinetic += 14 / 2 * (v[5:] @ shapes @ v[5:] + v[1] ** 2 * q[5:] @ shapes @ q[5:])
    np.testing.assert_allclose(v @ system.mass_matrix(0.0, q) @ v / 2, kinetic, rtol=1e-7)  # pi has 8 digits


def test_elastic_rod_vibrates_at_the_known_frequencies_when_held(make):
    system = make("slider_crank_flexible").system
    squares = eigh(np.asarray(system.stiffness), np.asarray(system.modal_mass), eigvals_only=True)
    np.testing.assert_allclose(np.sqrt(squares), [1277, 5107, 6841, 24613], rtol=0, atol=0.5)


def test_slider_crank_starts_with_the_force_that_holds_rod_and_slider(make, mechanics):
    """lam = (0, 286.302315789, 0)."""
    problem = make("slider_crank_flexible")
    lam = mechanics(problem.system).accelerations(0.0, problem.q0, problem.v0)[1]
    np.testing.assert_allclose(lam, [0.0, 286.302315789, 0.0], rtol=1e-11, atol=1e-9)


@pytest.mark.parametrize("key", ["car_axis", "slider_crank_flexible_ini2", "sundials_slider_crank"])
def test_published_states_satisfy_constraints_and_acceleration_level(make, mechanics, key):
    """Multipliers of ours at the published places and velocities are the published ones."""
    problem = make(PUBLISHED[key].spec)
    system = mechanics(compiled(problem.system))
    stored = {k: np.array(STORED[key][k], dtype=float) for k in ("t", "q", "v", "lam")}
    rows = zip(*(np.atleast_1d(stored["t"]), *(np.atleast_2d(stored[k]) for k in ("q", "v", "lam"))), strict=True)
    for t, q, v, lam in rows:
        np.testing.assert_allclose(system.g(t, q), 0.0, rtol=0, atol=1e-14)
        np.testing.assert_allclose(system.position_rate(t, q, v), 0.0, rtol=0, atol=1e-15 * (1 + np.abs(v).max()))
        np.testing.assert_allclose(system.accelerations(t, q, v)[1], lam, rtol=1e-9)


@jax.jit
def one_coordinate_rate(k, c, y):
    """Crank angle, its rate and the integral of the kinetic energy; rod angle and slider follow from the crank."""
    a = 0.5

    def configuration(q):
        p = -jnp.arcsin(a * jnp.sin(q))
        return jnp.stack([q, jnp.cos(p) + a * jnp.cos(q), p])

    def inertia(q):
        return jnp.sum(jnp.array([1.0, 1.0, 2.0]) * jax.jvp(configuration, (q,), (1.0,))[1] ** 2)

    def length(q):  # between the middles of crank and rod
        _, x, p = configuration(q)
        middle = jnp.stack([x - jnp.cos(p) / 2, -jnp.sin(p) / 2])
        return jnp.linalg.norm(middle - a / 2 * jnp.stack([jnp.cos(q), jnp.sin(q)]))

    def potential(q):
        _, x, p = configuration(q)
        return k * (length(q) - 1.0) ** 2 / 2 - (x + jnp.cos(p))

    q, u = y[0], y[1]
    moment = -jax.grad(potential)(q) - c * jax.grad(length)(q) ** 2 * u
    return jnp.stack([u, (moment - jax.grad(inertia)(q) * u**2 / 2) / inertia(q), inertia(q) * u**2 / 2])


def test_sundials_slider_crank_agrees_with_one_coordinate_and_with_what_the_source_prints():
    """States; G = integral of the kinetic energy over [0, 10] = 3.3366 and its differences to k and c."""
    stored = STORED["sundials_slider_crank"]

    def crank(k, c, times):
        options = {"method": "DOP853", "rtol": 1e-10, "atol": 1e-11, "t_eval": times}
        return solve_ivp(lambda t, y: np.asarray(one_coordinate_rate(k, c, y)), (0, 10), [np.pi / 2, 0, 0], **options).y

    q, _, G = crank(1.0, 1.0, stored["t"])
    p = -np.arcsin(np.sin(q) / 2)
    states = np.stack([q, np.cos(p) + np.cos(q) / 2, p], axis=1)
    np.testing.assert_allclose(states, np.array(stored["q"], dtype=float), rtol=0, atol=1e-8)
    np.testing.assert_allclose(states[-1], [1.2757, 1.0236, -0.49881], rtol=0, atol=5e-5)
    np.testing.assert_allclose(G[-1], 3.3366, rtol=0, atol=5e-5)
    for step, expected in ((np.array([1e-3, 0.0]), 0.33345), (np.array([0.0, 1e-3]), -0.36375)):
        ends = [crank(*(1.0 + sign * step), [10.0])[2, -1] for sign in (1, -1)]
        np.testing.assert_allclose((ends[0] - ends[1]) / 2e-3, expected, rtol=0, atol=2e-5)


def test_sundials_spring_and_force_are_those_of_the_source(make):
    """The source writes the square of the length out and the forces term by term."""
    problem = make("sundials_slider_crank")
    (q, x, p), (qd, xd, pd) = state = np.array([[0.7, 1.1, -0.4], [0.3, -0.2, 0.5]])
    a, s, c = 0.5, np.sin(p - q), np.cos(p - q)
    length = np.sqrt(x**2 - x * (np.cos(p) + a * np.cos(q)) + (1 + a**2) / 4 + a * c / 2)
    rate = (
        x * xd - xd * (np.cos(p) + a * np.cos(q)) / 2 + x * (np.sin(p) * pd + a * np.sin(q) * qd) / 2 - a * s * (pd - qd) / 4
    )
    f = (length - 1 + rate / length) / length
    expected = [
        -f * a * (s / 2 + x * np.sin(q)) / 2,
        f * (np.cos(p) / 2 - x + a * np.cos(q) / 2) + 1,
        -f * (x * np.sin(p) - a * s / 2) / 2 - np.sin(p),
    ]
    np.testing.assert_allclose(problem.system.force(0.0, *state), expected, rtol=1e-14)
    np.testing.assert_allclose(problem.observables["kinetic_energy"](0.0, *state, None), (qd**2 + xd**2 + 2 * pd**2) / 2)
    spring = problem.sketch(problem.q0)["lines"][2]
    np.testing.assert_allclose(np.linalg.norm(spring[1] - spring[0]), problem.system.spring_length(problem.q0), rtol=1e-14)
