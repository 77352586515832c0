"""Multipliers of rows between steps, (H60): as good as those of the steps."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import hhtbench as hb
from hhtbench.lowering import derive
from solvers._start import of_dynamics
from solvers.hht import HHT
from tests.hht.event_scenes import RESTITUTION, impacts, wall
from tests.hht.scenes import ANGLE, GRAVITY, Q0, SPEED, SYSTEMS, V0
from tests.hht.test_friction import SPEED as SPEED_OF_BEAD
from tests.hht.test_friction import Held, bead_at
from tests.sample import slow

WAY, FREQUENCY = 0.005, 10 * np.pi  # of the driven end: WAY (1 - cos(FREQUENCY t)) [m]


class Driven(hb.System):
    """M q'' = -K q - C q' + what moves q[0] as prescribed."""

    mass_matrix: object = hb.parameter(...)
    K: object = hb.parameter(...)
    C: object = hb.parameter(...)

    def force(self, t, q, v):
        return -self.K @ q - self.C @ v

    def constraint(self, t, q):
        return q[:1] - WAY * (1 - jnp.cos(FREQUENCY * t))


def rod(masses=20):
    """A steel rod, 1 m long and 20 by 20 mm thick, pushed at its end."""
    differences = np.diff(np.eye(masses), axis=0)
    springs = differences.T @ differences
    return Driven(mass_matrix=3.14 / masses * np.eye(masses), K=8.4e7 * masses * springs, C=8.4e3 * springs)


def reaction_of(system, times):
    """lam[0] of ``system`` from rest at the even ``times``, by the matrix exponential of [free q, free v, 1, cos, sin]."""
    M, K, C = (np.asarray(getattr(system, name)) for name in ("mass_matrix", "K", "C"))
    free, n = slice(1, None), len(M) - 1
    turn = np.array([[0, 0, 0], [0, 0, -FREQUENCY], [0, FREQUENCY, 0]])
    way = np.array([WAY, -WAY, 0.0])
    speed = way @ turn
    push = np.outer(M[:, 0], speed @ turn) + np.outer(C[:, 0], speed) + np.outer(K[:, 0], way)
    rates = np.zeros((2 * n + 3, 2 * n + 3))
    rates[:n, n : 2 * n] = np.eye(n)
    rates[n : 2 * n] = np.linalg.solve(M[free, free], -np.hstack([K[free, free], C[free, free], push[free]]))
    rates[2 * n :, 2 * n :] = turn
    lam = -np.concatenate([K[0, free], C[0, free], push[0]]) - M[0, free] @ rates[n : 2 * n]
    y, over, found = np.r_[np.zeros(2 * n), 1, 1, 0], expm(rates * (times[1] - times[0])), []
    for _ in times:
        found.append(lam @ y)
        y = over @ y
    return np.array(found)


@pytest.mark.parametrize(
    ("solver", "how", "within"),
    [
        ("hht", {"rtol": 1e-3}, 5.0),
        ("hht", {"rtol": 1e-4}, 3.5),
        ("hht(alpha=-0.3)", {"step": 4e-3}, 5.5),
    ],
)
def test_the_reaction_of_a_stiff_body_between_steps_is_as_good_as_at_them(solver, how, within):
    """It is some 20 N; that of the interpolated state is off by 50 to 4,000 N."""
    system, rows, early = rod(), np.linspace(0.0, 0.4, 401), 20
    still = np.zeros(len(system.K))
    problem = hb.Problem(name="driven", system=system, t_span=(0.0, 0.4), q0=still, v0=still)
    between, steps = hb.solve(problem, solver, t_eval=rows, **how), hb.solve(problem, solver, **how)
    right = reaction_of(system, rows)
    off = np.abs(between.lam[:, 0] - right)[early:].max()
    off_steps = np.abs(np.interp(rows, steps.t, steps.lam[:, 0]) - right)[early:].max()
    assert off < min(within, 1.5 * off_steps)


def multipliers(rows):
    return np.concatenate([rows.lam, rows.mu], axis=1)


def tight(problem, times, span=None):
    return multipliers(hb.solve(problem, "scipy(method=Radau)", t_span=span, t_eval=times, rtol=1e-10, atol=1e-11))


class Swinging(hb.System):
    """Two unit masses, the first held and the second at a distance of one by a spring of 1e7 N/m."""

    def force(self, t, q, v):
        apart = q[2:] - q[:2]
        length = jnp.sqrt(apart @ apart)
        pull = 1e7 * (length - 1.0) * apart / length
        return jnp.concatenate([pull, jnp.array([0.0, -GRAVITY]) - pull])

    def constraint(self, t, q):
        return q[:2]


@pytest.mark.parametrize("how", [{"rtol": 1e-3}, slow({"steps": 50})], ids=str)
def test_so_is_that_of_a_stiff_spring_that_turns(how):
    """It is up to 9 N; that of the interpolated state is off by 20 to 90 N."""
    start = {"q0": [0.0, 0.0, 1.0 + 9e-7, 0.0], "v0": [0.0, 0.0, 0.0, 3.0]}  # strained as far as it pulls inwards
    problem = hb.Problem(name="swinging", system=Swinging(), t_span=(0.0, 0.5), **start)
    rows = np.linspace(0.0, 0.5, 103)[1:-1]
    between, steps = hb.solve(problem, "hht", t_eval=rows, **how), hb.solve(problem, "hht", **how)
    times = np.union1d(rows, steps.t[1:])
    right = tight(problem, times)
    off = np.abs(multipliers(between) - right[np.isin(times, rows)]).max()
    off_steps = np.abs(multipliers(steps)[1:] - right[np.isin(times, steps.t[1:])]).max()
    assert off < 1.5 * off_steps < 3.0


FLEXIBLE = "slider_crank_flexible"  # a tenth of its interval: a tight reference of the whole takes a minute
SMOOTH = [
    "simple_pendulum",
    "sundials_slider_crank",
    FLEXIBLE,
    "bead_chain",
    "nonholonomic_particle",
    "rolling_disk_incline",
]


@pytest.mark.parametrize(
    ("name", "how"),
    [
        (name, how) if (i + j) % 2 else slow(name, how)
        for i, name in enumerate(SMOOTH)
        for j, how in enumerate(({"rtol": 1e-3}, {"steps": 200}))
    ],
    ids=str,
)
def test_smooth_motions_lose_nothing_against_the_multipliers_of_the_interpolated_state(name, how):
    """A straight line between the two ends of a step would lose up to 14 times."""
    problem = hb.load_problem(name)
    span = (0.0, 0.01) if name == FLEXIBLE else problem.t_span
    rows = np.linspace(*span, 104)[1:-1]
    found, right = hb.solve(problem, "hht", t_span=span, t_eval=rows, **how), tight(problem, rows, span)
    level = of_dynamics(derive(problem.system, problem.t_span[0], problem.q0, problem.v0)).acceleration
    there = [level.solve(*row) for row in zip(rows.tolist(), found.q, found.v, found.lam, found.mu, strict=True)]
    of_states = np.array([np.concatenate([at.lam, at.mu]) for at in there])
    assert np.abs(multipliers(found) - right).max() < 1.5 * np.abs(of_states - right).max()


def test_reactions_that_are_not_linear_in_the_multiplier_are_as_good_as_at_steps():
    """Friction by |lam| on a ring; that of the interpolated state is off by several times as much."""
    solve = lambda times: HHT(Held()).solve((0.0, 2.0), [1.0, 0.0], [0.0, SPEED_OF_BEAD], steps=200, t_eval=times)  # noqa: E731
    steps, rows = solve(None), solve(np.linspace(0.0, 2.0, 302))
    off, off_steps = (np.abs(x.lam - [bead_at(t)["lam"] for t in x.t]).max() for x in (rows, steps))
    assert off < 1.1 * off_steps


def tension_at(times):
    """lam (k,) of the unit pendulum that hits the :func:`~tests.hht.event_scenes.wall`, and its first impact's time."""
    hits, _ = impacts(2)
    rate = lambda _, y: [y[1], -GRAVITY * np.sin(y[0])]  # noqa: E731
    options = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-13, "dense_output": True}
    first = solve_ivp(rate, (0.0, hits[0]), [ANGLE, SPEED], **options).sol
    after = solve_ivp(rate, (hits[0], hits[1]), [0.0, -RESTITUTION * first(hits[0])[1]], **options).sol
    angle, speed = np.where(times < hits[0], first(np.minimum(times, hits[0])), after(np.maximum(times, hits[0])))
    return speed**2 + GRAVITY * np.cos(angle), hits[0]


@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize("how", [{"step": 0.02}, {"rtol": 1e-5}], ids=str)
def test_rows_beside_a_change_of_state_know_nothing_of_its_other_side(route, how):
    """The impact halves the part of the tension that comes from the speed.  The row at the impact is the one after it."""
    solver, (_, hit) = HHT(SYSTEMS[route], events=wall()), tension_at(np.zeros(1))
    end = impacts(2)[0][1] - 0.01
    found = solver.solve((0.0, end), Q0, V0, **how)
    event = found.t_events[0][0]
    assert abs(event - hit) < 1e-3
    beside = np.linspace(0.001, 0.03, 30)
    rows = np.concatenate([event - beside[::-1], [event], event + beside])
    between = solver.solve((0.0, end), Q0, V0, t_eval=rows, **how).lam[:, 0]
    right = tension_at(rows + np.where(rows < event, -1.0, 1.0) * abs(event - hit))[0]
    steps = np.abs(found.lam[:, 0] - tension_at(found.t)[0])[np.abs(found.t - event) > 1e-9].max()
    assert np.abs(between - right).max() < 1.5 * steps + 0.05


@pytest.mark.parametrize("span", [(0.0, 0.8), (0.8, 0.0)])
def test_rows_by_machine_code_are_those_by_functions_in_python_in_both_directions(span):
    rows = np.linspace(*span, 38)
    found = [HHT(SYSTEMS[route]).solve(span, Q0, V0, steps=20, t_eval=rows).lam for route in ("jax", "numpy")]
    found.append(HHT(SYSTEMS["jax"], engine="python").solve(span, Q0, V0, steps=20, t_eval=rows).lam)
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], rtol=1e-11)
