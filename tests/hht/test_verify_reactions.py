"""Joint forces at rows and as means over steps: against Lagrange's equations and beside v; ``hhtbench verify reactions``."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from solvers.hht.verify import reactions

SAMPLE = ["bead_chain", "rolling_sphere_table", "simple_pendulum"]


def double_pendulum(system, times):
    """Joint forces (k, 4) [N] of two equal uniform rods let go from the horizontal, by Lagrange's equations of the angles.

    The accelerations a of the centres give the forces: lam2 = m (g - a2), lam1 = m (g - a1) + lam2.
    """
    m, l, g = float(system.m[0]), float(system.l[0]), float(system.g)  # noqa: E741

    def bent(y):
        c, s = np.cos(y[0] - y[1]), np.sin(y[0] - y[1])
        mass = m * l * l * np.array([[4 / 3, c / 2], [c / 2, 1 / 3]])
        turning = m * l * l / 2 * s * np.array([-(y[3] ** 2), y[2] ** 2])
        weight = -m * g * l * np.array([1.5 * np.cos(y[0]), 0.5 * np.cos(y[1])])
        return np.linalg.solve(mass, turning + weight)

    start = [0.0, 0.0, 0.0, 0.0]
    solved = solve_ivp(lambda t, y: [*y[2:], *bent(y)], times[[0, -1]], start, "DOP853", times, rtol=1e-12, atol=1e-12)
    forces = []
    for y in solved.y.T:
        arm, rate, bend = l * np.exp(1j * y[:2]), y[2:], bent(y)
        a = arm * (1j * bend - rate**2)  # of the ends of the rods beyond their starts
        second = m * (-1j * g - a[0] - a[1] / 2)
        first = m * (-1j * g - a[0] / 2) + second
        forces.append([first.real, first.imag, second.real, second.imag])
    return np.array(forces)


def test_joint_forces_of_a_double_pendulum_are_those_of_lagranges_equations():
    """Rows and means over steps are of order two, the multiplier at either end of a step of order one."""
    problem, orders = hb.load_problem("planar_chain(n_links=2)"), {}
    for steps in (200, 400):
        even = double_pendulum(problem.system, np.linspace(*problem.t_span, 2 * steps + 1))
        for way, read in reactions.readings(hb.solve(problem, "hht", steps=steps)).items():
            at = np.rint(read.t * 2 * steps / problem.t_span[1]).astype(int)
            orders.setdefault(way, []).append(np.abs(read.values - even[at]).max() / np.abs(even).max())
    assert orders["rows"][1] < 3e-4  # 2e-4 found
    assert orders["means"][1] < 3e-4
    for way, order in {"rows": 2, "means": 2, "starts": 1, "ends": 1}.items():
        assert np.log2(np.divide(*orders[way])) == pytest.approx(order, abs=0.15)


def holds(spec):
    row = reactions.ratios(spec)[0]
    assert row.passed or "stiff" in row.claim or "fastest" in row.claim, row.measured
    return row


@pytest.mark.parametrize("spec", SAMPLE)
def test_relative_errors_of_multipliers_at_rows_are_at_most_ten_times_those_of_v(spec):
    holds(spec)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:redundant constraints")
@pytest.mark.parametrize("spec", [spec for spec in reactions.with_multipliers() if spec not in SAMPLE])
def test_so_they_are_on_every_smooth_problem_with_multipliers(spec):
    holds(spec)


def test_a_ratio_above_its_bound_fails_where_the_motion_is_smooth_and_is_shown_beside_radaus_where_it_is_not(monkeypatch):
    monkeypatch.setattr(reactions, "MAX_RATIO", 0.1)
    (failed,) = reactions.ratios("simple_pendulum")
    assert failed.passed is False
    monkeypatch.setattr(reactions, "FAST", 0.5)
    shown, radau = reactions.ratios("simple_pendulum")
    assert shown.passed is radau.passed is None
    assert 0.1 < float(radau.measured.split()[0]) < 2.0


def test_means_over_steps_gain_where_steps_do_not_resolve_a_vibration(monkeypatch):
    """A spring of 1e8 N/m: 1e4 rad/s, in steps of some ms; rms errors of rows are 10 times those of means."""
    monkeypatch.setattr(reactions, "RIVALS", ())
    monkeypatch.setattr(reactions, "METHODS", {alpha: reactions.METHODS[alpha] for alpha in ("-0.05", "-0.3")})
    found = reactions.measured(reactions.UNRESOLVED, {"rtol 0.0001": {"rtol": 1e-4}})
    at = found["rtol 0.0001", reactions.DEFAULT]
    assert at["means"].error < at["rows"].error / 4
    assert at["rows"].noise > at["rows"].error, "the error alternates"
    assert found["rtol 0.0001", "-0.3"]["rows"].error < at["rows"].error / 2


def test_noise_is_that_of_independent_errors_and_none_of_a_straight_line():
    rng, times = np.random.default_rng(1), np.linspace(0.0, 1.0, 20_000)[:, None]
    found = reactions.noise_of(rng.normal(size=times.shape) + 5.0 * times, 2.0)
    assert found.noise == pytest.approx(0.5, rel=0.02)
    assert reactions.noise_of(times, 1.0).noise < 1e-12
    assert np.isnan(reactions.noise_of(times[:2], 1.0).noise)


def test_errors_at_rows_are_those_of_the_rods_tension_and_of_the_closed_solutions_speeds():
    problem = hb.load_problem("simple_pendulum")
    found = hb.solve(problem, "hht", rtol=1e-4, t_eval=np.linspace(*problem.t_span, 21))
    true = [problem.exact(float(t)) for t in found.t]
    mass, length, gravity = (float(getattr(problem.system, name)) for name in ("m", "L", "g"))
    tension = np.array([mass * (at.v @ at.v - gravity * at.q[1]) / length for at in true])
    speeds = np.array([at.v for at in true])
    at = reactions.errors_at_rows("simple_pendulum", "hht", 1e-4)
    assert at.forces == pytest.approx(np.abs(2 * length * found.lam[:, 0] - tension).max() / tension.max(), rel=1e-6)
    assert at.v == pytest.approx(np.max(np.hypot(*(found.v - speeds).T)) / np.max(np.hypot(*speeds.T)), rel=1e-6)
