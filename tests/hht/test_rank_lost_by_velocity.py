"""Velocity constraints that lose rank with v: what follows is open, and no run goes on by luck (H52)."""

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import hhtbench as hb
from hhtbench.lowering import derive
from hhtbench.result import Status
from solvers.hht.run import by_velocity
from solvers.hht.run.by_velocity import poles
from solvers.hht.run.singular import Place, UnitRows


class Speed(hb.System):
    """A weight whose speed is given."""

    least: float = hb.parameter(0.0)

    def force(self, t, q, v):
        return jnp.array([0.0, -1.0])

    def velocity_constraint(self, t, q, v):
        return jnp.array([v @ v - self.least**2 - (1.0 - t) ** 2])


def moved(least=0.0, t_end=2.0, angle=0.3, **request):
    speed = np.hypot(1.0, least)
    hht = hb.HHT(Speed(least=least), events=request.pop("events", ()))
    return hht.solve((0.0, t_end), [0.0, 0.0], speed * np.array([np.cos(angle), np.sin(angle)]), **request)


REQUESTS = [*({"rtol": r} for r in (1e-2, 1e-3, 1e-4, 1e-5, 1e-6)), {"steps": 101}, {"steps": 1_000}]
ANGLES = 0.05 + np.linspace(0.0, 2.0 * np.pi, 25)[:-1]


@pytest.mark.parametrize("request_", REQUESTS, ids=str)
def test_no_step_goes_by_luck_over_a_place_where_v_has_no_direction(request_):
    """From a quarter of 24 directions each: steps turn v to where the weight falls, or to the other side."""
    solver = hb.HHT(Speed())
    for angle in ANGLES[REQUESTS.index(request_) % 4 :: 4]:
        lost(solver.solve((0.0, 2.0), [0.0, 0.0], [np.cos(angle), np.sin(angle)], **request_))


def lost(solution):
    assert solution.status is Status.singular_iteration_matrix, solution.message
    assert "rank 0 of 1 rows; for example rows [0]" in solution.message
    assert 0.5 < solution.t[-1] <= 1.0
    told = float(solution.message.split("lose rank at t = ")[1].split(":")[0])
    assert abs(told - 1.0) < 1e-4
    assert solution.t.size == solution.counters.steps_accepted + 1


def test_what_was_seen_beyond_is_no_event():
    clock = hb.Event(lambda t, q, v: t - np.array([0.5]) @ np.ones(1), name="half")
    late = hb.Event(lambda t, q, v: t - 1.01, name="late")
    solution = moved(rtol=1e-3, events=[clock, late])
    assert [times.size for times in solution.t_events] == [1, 0]


def test_a_run_that_ends_there_arrives():
    assert moved(rtol=1e-4, t_end=0.99).success


@pytest.mark.parametrize(("least", "rtol"), [(0.5, 1e-4), (0.1, 1e-4), (0.03, 1e-2), (0.03, 1e-3), (0.01, 1e-3)])
def test_speeds_that_only_become_small_are_followed(least, rtol):
    """mu has a peak there, and a step may be longer than it."""
    coarse, fine = (moved(least=least, rtol=tolerance) for tolerance in (rtol, 1e-6))
    assert coarse.success, coarse.message
    assert fine.success, fine.message
    assert np.abs(coarse.q[-1] - fine.q[-1]).max() < 1e-2


class Never(hb.System):
    """No velocity meets it, and Newton's iteration leads anywhere."""

    def force(self, t, q, v):
        return jnp.array([0.0, -1.0])

    def velocity_constraint(self, t, q, v):
        return jnp.array([v @ v + 1.0])


def test_velocities_off_the_constraints_are_not_where_rank_is_lost(monkeypatch):
    for bound, value in (("FALLS", np.inf), ("GONE", np.inf), ("LEFT", 0.0)):
        monkeypatch.setattr(by_velocity, bound, value)
    for system, found in ((Never(), False), (Speed(), True)):
        place = Place(0.5, np.zeros(2), np.array([0.3, 0.4]), np.zeros(2))
        rows = UnitRows(derive(system, place.t, place.q, place.v), place)
        assert (by_velocity._lost_within(rows, place, 1.0) is not None) is found


def test_constraints_that_are_linear_in_v_cost_no_look(monkeypatch):
    monkeypatch.setattr(by_velocity, "_lost", None)
    for name in ("knife_edge", "simple_pendulum"):
        assert hb.solve(hb.load_problem(name), "hht", rtol=1e-3).success


def test_a_pole_stands_out_from_what_is_three_steps_away():
    pole = 1.0 / (np.arange(40) - 20.3)
    assert poles(pole[:, None]).tolist() == [20]
    wave = np.sin(2.0 * np.pi * np.arange(200) / 50.0)
    assert poles(np.stack([0.0 * wave, wave], axis=1)).size == 0


class Turning(hb.System):
    """A bead on a ring, whose speed along a direction that turns is given: it ends where that points along the radius."""

    rate: float = hb.parameter(0.5)

    def force(self, t, q, v):
        return jnp.zeros(2)

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0])

    def velocity_constraint(self, t, q, v):
        return jnp.stack([v[0] * jnp.cos(self.rate * t) + v[1] * jnp.sin(self.rate * t) - 1.0])


ENDS = quad(lambda angle: 1.0 / (1.0 / np.sin(angle) - 0.5), 0.0, 1.0)[0]  # [s], from an angle of 1 between both


@pytest.mark.parametrize(
    "request_",
    [*({"rtol": 10.0**-k} for k in range(2, 8)), *({"steps": k} for k in (20, 50, 100, 200, 500, 1_000))],
    ids=str,
)
def test_no_step_goes_on_where_a_velocity_grows_beyond_all_bounds(request_):
    """Beyond it v points the other way and leads back: steps went to and fro between both sides, said a success."""
    start = [np.cos(1.0), -np.sin(1.0)], np.array([np.sin(1.0), np.cos(1.0)]) / np.sin(1.0)
    solution = hb.HHT(Turning()).solve((0.0, 2.0), *start, **request_)
    assert solution.status is Status.singular_iteration_matrix, solution.message
    assert "rank 1 of 2 rows" in solution.message
    assert solution.t[-1] < ENDS + 1e-2
    told = float(solution.message.split("lose rank at t = ")[1].split(":")[0])
    assert abs(told - ENDS) < 3 * 2.0 / request_["steps"] if "steps" in request_ else abs(told - ENDS) < 0.02
    if "steps" in request_:
        assert "v grows beyond all bounds there" in solution.message and "No motion goes on beyond" in solution.message


class Driven(hb.System):
    """A crank of 1 m, whose coupler of 2 m is moved at its other end, to 2 + reach cos t: 1 m is as far as it gets."""

    reach: float = hb.parameter(1.05)

    def force(self, t, q, v):
        return jnp.array([0.0, -1.0])

    def constraint(self, t, q):
        x = 2.0 + self.reach * jnp.cos(t)
        return jnp.stack([(q @ q - 1.0) / 2.0, ((q[0] - x) ** 2 + q[1] ** 2 - 4.0) / 2.0])

    def start(self, t):
        x, speed = 2.0 + self.reach * np.cos(t), -self.reach * np.sin(t)
        height = np.sqrt(1.0 - ((x * x - 3.0) / (2.0 * x)) ** 2)
        q = np.array([(x * x - 3.0) / (2.0 * x), height])
        return q, np.linalg.solve([[q[0], q[1]], [q[0] - x, q[1]]], [0.0, (q[0] - x) * speed])


@pytest.mark.parametrize("begin", [0.5, -2.0])
@pytest.mark.parametrize(
    "request_", [*({"rtol": 10.0**-k} for k in (3, 6)), *({"steps": k} for k in (50, 500, 5_000))], ids=str
)
def test_a_drive_beyond_reach_is_named(begin, request_):
    """With ``take a smaller step``, or ``roundoff is reached``, before."""
    solution = hb.HHT(Driven()).solve((begin, begin + 2.5), *Driven().start(begin), **request_)
    ends = (np.pi if begin > 0.0 else 0.0) - np.arccos(1.0 / 1.05)  # on the way out, to the other side and to this
    assert solution.status is Status.singular_iteration_matrix, solution.message
    told = float(solution.message.split("lose rank at t = ")[1].split(":")[0])
    assert abs(told - ends) < 3 * 2.5 / request_.get("steps", 5_000)
