"""Motions whose prescribed velocities jump: right runs are believed, those that miss the impulse are not."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.checks.result.judge import judge
from tests.check.test_jumps import PLACES, TIMES, Crane, Sticky, numpy_crane, problem

RATES = np.diff(PLACES) / np.diff(TIMES)
ROPE, G = 2.0, 9.81


def swung(share, t):
    """q, v (k, 3) of the crane in its one angle, theta'' = -(g / l) sin(theta): each jump dV of the trolley changes theta'
    by -dV cos(theta) / l, of which a ``share`` is kept."""
    y, before, found = np.zeros(2), 0.0, []
    for rate, start, end in zip(RATES, TIMES[:-1], TIMES[1:], strict=True):
        y = y - [0.0, share * (rate - before) * np.cos(y[0]) / ROPE]
        inside = t[(t >= start) & ((t < end) | (end == TIMES[-1]))]
        rates = lambda _, y: [y[1], -G / ROPE * np.sin(y[0])]  # noqa: E731
        run = solve_ivp(rates, (start, end), y, "DOP853", dense_output=True, rtol=1e-12, atol=1e-13)
        y, before, found = run.y[:, -1], rate, [*found, (rate, run.sol(inside).T)]
    trolley = np.interp(t, TIMES, PLACES)
    rate = np.concatenate([np.full(len(states), rate) for rate, states in found])
    theta, turning = np.concatenate([states for _, states in found]).T
    s, c = ROPE * np.sin(theta), ROPE * np.cos(theta)
    return np.column_stack([trolley, trolley + s, -c]), np.column_stack([rate, rate + c * turning, s * turning])


class Keeping:
    """A solver that keeps a ``share`` of each impulse of the rope."""

    name = "keeping"

    def __init__(self, share):
        self.share = share

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        t = np.linspace(*problem.t_span, 301) if request.t_eval is None else request.t_eval
        q, v = swung(self.share, t)
        return hb.Solution(
            t=t, q=q, v=v, lam=multipliers(q, v), mu=np.zeros((t.size, 0)), status=hb.Status.success, message=""
        )


def multipliers(q, v):
    """lam of the rows: the rope pulls with m (g cos(theta) + l theta'^2), and the trolley is not accelerated."""
    along, across = q[:, 1] - q[:, 0], v[:, 1] - v[:, 0]
    rope = 5.0 * (across**2 + v[:, 2] ** 2 - G * q[:, 2]) / ROPE**2
    return np.column_stack([rope * along, rope])


@pytest.mark.parametrize("rows", [51, 61], ids=["beside the jumps", "on them"])
@pytest.mark.parametrize(
    ("solver", "asked"),
    [("hht", {"rtol": 1e-3}), ("hht", {"rtol": 1e-8}), ("rattle", {"step": 0.011}), ("generalised_alpha", {"step": 0.01})],
)
def test_runs_that_take_the_impulse_are_believed(solver, asked, rows):
    found = hb.solve(problem(Crane()), solver, t_eval=np.linspace(0.0, 6.0, rows), keep_steps=True, **asked)
    assert found.success, found.message
    judgement = found.verify()
    assert (judgement.doubt, judgement.not_judged, judgement.jumps) == ("", "", (1.0, 2.5, 4.0))
    assert judgement.metrics()["motion"] < 0.5
    assert judgement.metrics()["jumps"] == [1.0, 2.5, 4.0]
    right, _ = swung(1.0, found.t)
    np.testing.assert_allclose(found.q, right, rtol=0, atol=1e-3 if asked.get("rtol") == 1e-8 else 0.1)


@pytest.mark.parametrize("rows", [51, 61])
@pytest.mark.parametrize("asked", [{"rtol": 1e-6}, {"rtol": 1e-3}, {"steps": 2000}], ids=str)
def test_runs_that_miss_an_impulse_are_not(asked, rows):
    asked = {"t_eval": np.linspace(0.0, 6.0, rows), **asked}
    scene = problem(Crane())
    assert hb.solve(scene, Keeping(1.0), **asked).verify().doubt == ""
    for share in (0.0, 0.01, *((0.99,) if asked.get("rtol") == 1e-6 else ())):
        judgement = hb.solve(scene, Keeping(share), **asked).verify()
        assert judgement.doubt.startswith("equations of motion: from the row at t = "), (share, judgement)
        assert "The prescribed velocities jump at t = " in judgement.doubt


@pytest.mark.parametrize("place", range(3), ids=["in the first piece", "in the middle", "in the last"])
def test_a_fault_between_jumps_is_not_hidden_by_them(place):
    t = np.linspace(0.0, 6.0, 301)
    found = hb.solve(problem(Crane()), Keeping(1.0), rtol=1e-6, t_eval=t)
    at = (1.7, 3.3, 5.1)[place]
    q, v = (np.where((t > at)[:, None], np.roll(x, -2, axis=0), x) for x in (found.q, found.v))
    q[:, :1], v[:, :1] = found.q[:, :1], found.v[:, :1]
    q[:, 1] += found.q[:, 0] - np.where(t > at, np.roll(found.q[:, 0], -2), found.q[:, 0])
    wrong = found.but(q=q[:-2], v=v[:-2], **{name: getattr(found, name)[:-2] for name in ("t", "lam", "mu")})
    scene = problem(Crane(), t_span=(0.0, float(t[-3])))
    assert judge(scene, hb.Request(rtol=1e-6, t_eval=t[:-2]), wrong).doubt.startswith("equations of motion: ")


def test_a_last_row_on_a_jump_is_judged():
    scene = problem(Crane(), t_span=(0.0, 4.0))
    found = hb.solve(scene, "hht", rtol=1e-6, t_eval=np.linspace(0.0, 4.0, 41))
    assert (found.verify().doubt, found.verify().not_judged) == ("", "")
    q, v = found.q.copy(), found.v.copy()
    angle, speed = np.arctan2(q[-1, 1] - q[-1, 0], -q[-1, 2]) + 0.2, np.hypot(v[-1, 1] - v[-1, 0], v[-1, 2])
    q[-1, 1:] = q[-1, 0] + ROPE * np.sin(angle), -ROPE * np.cos(angle)
    v[-1, 1:] = v[-1, 0] - speed * np.cos(angle), -speed * np.sin(angle)
    assert "to the row at t = 4" in judge(scene, hb.Request(rtol=1e-6, t_eval=found.t), found.but(q=q, v=v)).doubt


def test_a_kink_of_a_millionth_of_the_speed_accuses_nobody():
    class Bent(Crane):
        def place(self, t):
            return t + 1e-6 * jnp.maximum(t - 1.0, 0.0)

    scene = problem(Bent(), t_span=(0.0, 2.0), v0=[1.0, 1.0, 0.0])
    found = hb.solve(scene, "hht", rtol=1e-9, t_eval=np.linspace(0.0, 2.0, 42))
    assert (found.verify().doubt, found.verify().jumps) == ("", (1.0,))


def test_a_fast_smooth_drive_is_judged():
    class Shaken(Crane):
        def place(self, t):
            return 0.01 * jnp.sin(100.0 * t)

    found = hb.solve(problem(Shaken(), v0=[1.0, 1.0, 0.0]), "hht", rtol=1e-5)
    assert (found.verify().doubt, found.verify().not_judged, found.verify().jumps) == ("", "", ())


@pytest.mark.parametrize(("system", "reason"), [(numpy_crane(), "declare"), (Sticky(), "nonlinear")])
def test_jumps_without_a_known_impulse_are_not_judged_and_named(system, reason):
    found = hb.solve(problem(Crane()), rtol=1e-4, t_eval=np.linspace(0.0, 6.0, 51))
    judgement = judge(problem(system), hb.Request(rtol=1e-4, t_eval=found.t), found)
    assert judgement.doubt == ""
    assert reason in judgement.not_judged
    assert "t = 1" in judgement.not_judged


def test_a_campaign_believes_hht_on_a_table_of_positions(tmp_path):
    scene = tmp_path / "crane.py"
    scene.write_text("from tests.check.test_jumps import Crane, problem\ndriven = problem(Crane())\n")
    rows = hb.run(f"{scene}:driven", ["hht", "rattle"], rtol=[1e-6], steps=[600], jobs=1, timing=False).rows
    verdicts = {(row.solver, row.status) for row in rows if row.status != "declined"}
    assert verdicts == {("hht", "success"), ("rattle", "success")}


class Drive(hb.System):
    """A pendulum of 1 m whose pivot moves at 1 m/s, and from ``turn`` on back at 0.5 m/s: (pivot x, bob x, bob y)."""

    turn: object = hb.parameter(1.0)

    def mass_matrix(self, t, q):
        return jnp.diag(jnp.array([1.0, 2.0, 2.0]))

    def force(self, t, q, v):
        return jnp.array([0.0, 0.0, -2.0 * G])

    def constraint(self, t, q):
        pivot = jnp.where(t < self.turn, t, 1.5 * self.turn - 0.5 * t)
        return jnp.stack([q[0] - pivot, ((q[1] - q[0]) ** 2 + q[2] ** 2 - 1.0) / 2.0])


DRIVE = hb.Problem(name="drive", system=Drive(), t_span=(0.0, 2.0), q0=[0.0, 0.0, -1.0], v0=[1.0, 1.0, 0.0])


@pytest.mark.parametrize(
    ("solver", "asked"),
    [
        *(("hht", one) for one in ({"rtol": 1e-4}, {"step": 0.011}, {"accuracy": 1e-2})),
        *(("rattle", {"step": 0.01}), ("projected", {"rtol": 1e-8}), ("projected", {"accuracy": 1e-2})),
    ],
)
def test_a_pivot_that_turns_back_is_right_and_believed(solver, asked):
    """It hangs at rest until 1 s, when its angle a gets a' = 1.5 rad/s; then a'' = -g sin(a)."""
    swing = solve_ivp(lambda _, y: [y[1], -G * np.sin(y[0])], (1.0, 2.0), [0.0, 1.5], "DOP853", rtol=1e-12, atol=1e-13)
    a = swing.y[0, -1]
    found = hb.solve(DRIVE, solver, **asked)
    assert found.success, found.message
    np.testing.assert_allclose(found.q[-1], [0.5, 0.5 + np.sin(a), -np.cos(a)], rtol=0, atol=1e-2)
    if "accuracy" not in asked:
        judgement = found.verify()
        assert (judgement.doubt, judgement.not_judged, judgement.jumps) == ("", "", (1.0,))
