"""The small problems against independent formulations: angles, reduced equations, quadratures, statics."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from tests.problems.published import STORED
from tests.problems.published_tables import PUBLISHED


def times(problem):
    """Inside the interval, at no special place of it."""
    start, end = problem.t_span
    return [start + x * (end - start) for x in (0.13, 0.47, 0.91)]


def kapitza_state(m, L, g, A, w, t, angle, rate):
    """State and multiplier of Kapitza's pendulum from its angle."""
    sin, cos = math.sin(angle), math.cos(angle)
    pull = m * (L * rate**2 - (g - A * w**2 * math.cos(w * t)) * cos)
    q = np.array([L * sin, A * math.cos(w * t) + L * cos])
    v = np.array([L * rate * cos, -A * w * math.sin(w * t) - L * rate * sin])
    return SimpleNamespace(t=t, q=q, v=v, lam=np.array([pull / L]), mu=np.zeros(0))


def test_equation_of_the_angle_gives_the_published_states_and_multipliers_of_kapitzas_pendulum():
    """Minimal coordinates and a Runge-Kutta method against the values of the constrained form (10 digits confirmed)."""
    published, stored = PUBLISHED["kapitza_pendulum"], STORED["kapitza_pendulum"]
    _, L, g, A, w = values = (1.0, 1.0, 9.81, 0.05, 80.0)

    def rate(t, y):
        return [y[1], (g - A * w**2 * math.cos(w * t)) / L * math.sin(y[0])]

    found = solve_ivp(rate, (0, 3), [0.1, 0.0], method="DOP853", rtol=1e-13, atol=1e-14, t_eval=stored["t"]).y.T
    for i, (t, y) in enumerate(zip(stored["t"], found, strict=True)):
        state = kapitza_state(*values, t, *y)
        for key, value in published.values.items():
            np.testing.assert_allclose(value(state), np.array(stored[key][i], dtype=float), rtol=1e-10, atol=1e-10)


def test_constrained_form_of_kapitzas_pendulum_has_the_accelerations_of_the_angle(make, mechanics):
    m, L, g, A, w = values = (2.0, 0.7, 4.0, 0.1, 30.0)
    problem = make("kapitza_pendulum", m=m, L=L, g=g, A=A, w=w)
    for t, angle, rate in ((0.01, 0.3, 2.0), (0.4, 2.5, -1.0)):
        state = kapitza_state(*values, t, angle, rate)
        vdot, lam, _ = mechanics(problem.system).accelerations(t, state.q, state.v)
        curve = (g - A * w**2 * math.cos(w * t)) / L * math.sin(angle)
        sin, cos = math.sin(angle), math.cos(angle)
        lift = -A * w**2 * math.cos(w * t)
        expected = [L * (curve * cos - rate**2 * sin), lift - L * (curve * sin + rate**2 * cos)]
        np.testing.assert_allclose(vdot, expected, rtol=1e-12)
        np.testing.assert_allclose(lam, state.lam, rtol=1e-12)
        np.testing.assert_allclose(problem.observables["angle"](t, state.q, state.v, lam), angle, rtol=1e-14)
        np.testing.assert_allclose(problem.sketch(state.q)["points"][0], [0.0, A * math.cos(w * t)], atol=1e-14)


@pytest.mark.parametrize(("A", "falls"), [(0.05, True), (0.075, False)])
def test_kapitzas_pendulum_stays_upright_only_if_shaken_fast_enough(A, falls):
    """Landau and Lifshitz, section 30: A w against sqrt(2 g L); integrated by the angle's equation."""
    speed_needed = math.sqrt(2 * 9.81)
    assert (speed_needed > A * 80.0) == falls

    def rate(t, y):
        return [y[1], (9.81 - A * 6400.0 * math.cos(80.0 * t)) * math.sin(y[0])]

    angle = solve_ivp(rate, (0, 3), [0.1, 0.0], method="DOP853", rtol=1e-8, atol=1e-8).y[0]
    assert (np.abs(angle).max() > 1.0) == falls


@pytest.mark.parametrize("u0", [0.5, -2.0])
def test_sleigh_moves_as_its_reduced_equations_say(make, u0):
    """u' = a w^2, w' = -(a / A) u w integrated; the sleigh that backs up turns round."""
    m, I, a, w0 = 1.5, 0.2, 0.3, 0.8  # noqa: E741
    A = (I + m * a**2) / m
    problem = make("chaplygin_sleigh", m=m, I=I, a=a, u0=u0, w0=w0)

    def rate(t, y):
        u, w, th = y[:3]
        sin, cos = math.sin(th), math.cos(th)
        return [a * w**2, -a / A * u * w, w, u * cos - a * w * sin, u * sin + a * w * cos]

    found = solve_ivp(rate, (0, 5), [u0, w0, 0, 0, 0], method="DOP853", rtol=1e-12, atol=1e-13, t_eval=(1.0, 5.0)).y.T
    for t, (u, w, th, x, y) in zip((1.0, 5.0), found, strict=True):
        motion = problem.exact(t)
        np.testing.assert_allclose(motion.q, [x, y, th], atol=1e-10)
        ahead = motion.v[0] * math.cos(th) + motion.v[1] * math.sin(th)
        np.testing.assert_allclose([ahead, motion.v[2]], [u, w], atol=1e-10)


@pytest.mark.parametrize("parameters", [{}, {"a": 0.02, "u0": -0.1, "w0": 3.0}, {"I": 1e-3, "u0": -3.0, "t_end": 20.0}])
def test_place_of_the_sleigh_is_its_quadrature_to_roundoff(make, parameters):
    """Against adaptive quadrature of the closed velocities."""
    problem = make("chaplygin_sleigh", **parameters)
    end = problem.t_span[1]
    for i in (0, 1):
        pieces = [
            quad(lambda t, i=i: problem.exact(t).v[i], a, b, epsabs=1e-14, epsrel=1e-13)[0]
            for a, b in zip(np.linspace(0, end, 11)[:-1], np.linspace(0, end, 11)[1:], strict=True)
        ]
        np.testing.assert_allclose(problem.exact(end).q[i], sum(pieces), rtol=0, atol=1e-13 * np.max(problem.scales.q))


def test_sleigh_comes_to_run_straight_ahead_at_its_conserved_speed(make):
    problem = make("chaplygin_sleigh")
    late = problem.exact(40.0)
    speed = math.sqrt(2 * float(problem.system.energy(0.0, problem.q0, problem.v0)))
    np.testing.assert_allclose(late.v, [speed * math.cos(late.q[2]), speed * math.sin(late.q[2]), 0.0], atol=1e-14)


def test_disk_rolls_level_on_average(make):
    """After whole turns it is back at its height and has moved by R k t / 2, k = m gs R / ((Irot + m R^2) Om)."""
    turn = 2 * math.pi / 1.5
    motion = make("rolling_disk_incline").exact(3 * turn)
    np.testing.assert_allclose(motion.q[:2], [0.0, 0.5 * (3.0 / (0.9 * 1.5)) / 2 * 3 * turn], atol=1e-14)


@pytest.mark.parametrize("amplitude", [3.0, -1e-3, 0.0])
def test_pendulum_swings_as_the_equation_of_its_angle_says(make, amplitude):
    problem = make("simple_pendulum", amplitude=amplitude, L=0.8)

    def rate(t, y):
        return [y[1], -9.81 / 0.8 * math.sin(y[0])]

    found = solve_ivp(rate, (0, 4), [amplitude, 0], method="DOP853", rtol=1e-13, atol=1e-15, t_eval=(1.3, 4.0)).y.T
    for t, (angle, speed) in zip((1.3, 4.0), found, strict=True):
        motion = problem.exact(t)
        np.testing.assert_allclose(problem.observables["angle"](t, *motion[:3]), angle, rtol=0, atol=1e-10)
        np.testing.assert_allclose(motion.v, 0.8 * speed * np.array([np.cos(angle), np.sin(angle)]), rtol=0, atol=1e-10)


def test_period_of_the_first_iftomm_problem_is_the_published_one(make):
    problem = make("simple_pendulum")
    period = 2.3678419475762374493
    np.testing.assert_allclose(problem.exact(period).q, [-1.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(problem.exact(period / 2).q, [1.0, 0.0], atol=1e-14)
    np.testing.assert_allclose(problem.exact(period / 4).lam, [3 * 9.81 / 2], rtol=1e-14)


@pytest.mark.parametrize("L", [1.0, 0.3])
def test_two_second_pendulum_is_back_at_its_start_after_ten_thousand_swings(make, L):
    problem = make("pendulum_period2", L=L, t_end=20000.0)
    np.testing.assert_allclose(problem.system.g, 13.750371636040745655 * L, rtol=1e-15)
    np.testing.assert_array_equal(problem.exact(20000.0).q, problem.exact(0.0).q)
    np.testing.assert_allclose(problem.exact(19999.5).q, [0.0, -L], atol=1e-15)


@pytest.mark.parametrize("factor", [2.0, 0.3])
def test_multipliers_of_the_redundant_pendulum_are_the_smallest_that_hold_it(make, mechanics, factor):
    """Rank one of two; the least-squares solution of the acceleration level is the pair of ``exact``."""
    problem = make("redundant_pendulum", factor=factor)
    system = mechanics(problem.system)
    assert "redundant" in problem.tags
    for t in (0.0, *times(problem)):
        q, v, lam, _ = problem.exact(t)
        rows = system.position_rows(t, q)
        assert np.linalg.matrix_rank(rows) == 1
        bias = (v @ v) * np.array([1.0, factor])
        matrix = np.block([[np.eye(2), rows.T], [rows, np.zeros((2, 2))]])
        x = np.linalg.lstsq(matrix, np.concatenate([[0.0, -9.81], -bias]), rcond=1e-12)[0]
        np.testing.assert_allclose(lam, x[2:], rtol=0, atol=1e-13 * 9.81)
        np.testing.assert_allclose(problem.observables["pull"](t, q, v, lam), v @ v - 9.81 * q[1], atol=1e-12)


@pytest.mark.parametrize("steps", [20, 200, 2000])
def test_trapezoidal_rule_of_index_3_leaves_the_same_error_of_the_multiplier_at_every_step(make, steps):
    """The claim of ``driven_coordinate``: 2/3 at t = 2, however small the step; a plain Newmark method written here."""
    problem = make("driven_coordinate")
    h, q, v, a = 2.0 / steps, problem.q0[0], problem.v0[0], -problem.exact(0.0).lam[0]
    for i in range(1, steps + 1):
        reached = problem.exact(i * h).q[0]
        last, a = a, 4 / h**2 * (reached - q - h * v) - a
        q, v = reached, v + h / 2 * (last + a)
    np.testing.assert_allclose(abs(-a - problem.exact(2.0).lam[0]), 2 / 3, atol=0.01)


@pytest.mark.parametrize("name", ["simple_pendulum", "pendulum_period2", "redundant_pendulum", "kapitza_pendulum"])
def test_rod_is_drawn_with_its_length(make, name):
    problem = make(name, L=0.6)
    rod = problem.sketch(problem.q0)["lines"][0]
    np.testing.assert_allclose(np.linalg.norm(rod[1] - rod[0]), 0.6, rtol=1e-12)


def test_drawn_disk_stands_on_its_contact_and_drawn_skate_on_the_constraint(make):
    disk = make("rolling_disk_incline")
    rim = disk.sketch(disk.exact(1.0).q)["lines"][:24, 0]
    assert 0 <= rim[:, 2].min() < 0.01 * 0.5
    sleigh = make("chaplygin_sleigh")
    (early, late), th = (sleigh.sketch(sleigh.exact(1.0 + s).q)["points"][1] for s in (-1e-5, 1e-5)), sleigh.exact(1.0).q[2]
    np.testing.assert_allclose((late - early) @ [-math.sin(th), math.cos(th)], 0.0, atol=1e-13)
