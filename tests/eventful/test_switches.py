"""Events that change the system, by solvers of each family: against closed solutions and a few lines of NumPy."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import hhtbench as hb
from hhtbench.mechanics import Mechanism, plane
from tests.sample import slow

SOLVERS = ["hht", "ida", "cvode", "scipy(method=Radau)", "diffrax(method=Dopri8)", "projected"]
G = 9.81


def some(*others):
    """Both engines of the house and others; `make test-slow` takes all solvers."""
    return [x if x in ("hht", "projected", *others) else slow(x) for x in SOLVERS]


class Flying(hb.System):
    """A ball of 2 kg."""

    mass_matrix = (2.0, 2.0)

    def force(self, t, q, v):
        return jnp.array([0.0, -2.0 * G])

    def energy(self, t, q, v):
        return v @ v + 2.0 * G * q[1]


class Lying(Flying):
    """The ball on the floor, pulled up by a force that grows."""

    pull: object = hb.parameter(0.0)

    def force(self, t, q, v):
        return jnp.stack([0.0, self.pull * t - 2.0 * G])

    def constraint(self, t, q):
        return q[1:]


class Lifted(Lying):
    """The lifted ball."""

    def constraint(self, t, q):
        return q[:0]


FLYING, LYING = Flying(), Lying()
BALL = hb.Problem(name="ball", system=FLYING, t_span=(0, 2), q0=[0.0, 1.0], v0=[0.3, 0.0])
FLOOR = hb.Event(lambda t, q, v: q[1], direction=-1, restitution=0.5, then=LYING, during=FLYING, name="floor")


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_ball_bounces_and_comes_to_rest(solver):
    found = hb.solve(BALL, solver, rtol=1e-9, atol=1e-11, events=[FLOOR])
    assert found.status.label == "success"
    fall = np.sqrt(2 / G)
    np.testing.assert_allclose(found.t_events[0][:3], fall * np.array([1.0, 2.0, 2.5]), atol=1e-8)
    assert [phase.event for phase in found.phases] == ["", "floor"]
    assert found.phases[1].t == pytest.approx(
        3 * fall, abs=1e-5
    )  # a rebound 1e-5 s before is as high as an error of 1e-10 m
    np.testing.assert_allclose(found.q[-1], [0.6, 0.0], atol=1e-7)
    assert found.lam[-1, 0] == pytest.approx(-2.0 * G)
    np.testing.assert_array_equal(found.lam[found.phases[0].rows], 0.0)
    first = found.impacts[0]
    assert first.contact == pytest.approx([2.0 * 1.5 * np.sqrt(2 * G)], rel=1e-7)
    np.testing.assert_allclose(first.impulse, [0.0, *first.contact], atol=1e-12)
    assert not found.verify().doubt
    assert found.q[:, 1].min() > -1e-7


class Falling(hb.System):
    def force(self, t, q, v):
        return jnp.stack([-G + 0 * t])


class Fallen(Falling):
    def constraint(self, t, q):
        return q


@pytest.mark.parametrize("restitution", [0.6, 0.8])
@pytest.mark.parametrize("solver", ["hht", "ida"])
def test_rebounds_of_any_restitution_settle(solver, restitution):
    floor = hb.Event(lambda t, q, v: q[0], direction=-1, restitution=restitution, then=Fallen(), name="floor")
    rest = np.sqrt(2 / G) * (1 + restitution) / (1 - restitution)
    ball = hb.Problem(name="ball", system=Falling(), t_span=(0, rest + 0.5), q0=[1.0], v0=[0.0], events=floor)
    found = hb.solve(ball, solver, rtol=1e-8, max_seconds=20)
    assert found.status.label == "success"
    assert found.phases[1].t == pytest.approx(rest, abs=1e-6)
    np.testing.assert_allclose(found.q[found.phases[1].rows], 0.0, atol=1e-15)


def test_a_ball_without_a_system_to_rest_in_ends_where_its_rebounds_pile_up():
    free = hb.Event(lambda t, q, v: q[1], direction=-1, restitution=0.5, name="floor")
    found = hb.solve(BALL, "projected", rtol=1e-8, events=[free])
    assert found.status.label == "time_resolution"
    assert found.t[-1] == pytest.approx(3 * np.sqrt(2 / G), abs=1e-6)


@pytest.mark.parametrize("solver", some("ida"))
def test_a_contact_ends_where_its_force_does(solver):
    lying = Lying(pull=30.0)
    lifts = hb.Event(lambda t, q, v, lam, mu: lam[0], direction=1, during=lying, then=Lifted(pull=30.0), name="lifts")
    problem = hb.Problem(name="lifted", system=lying, t_span=(0, 1), q0=[0.0, 0.0], v0=[0.0, 0.0])
    found = hb.solve(problem, solver, rtol=1e-8, events=[lifts])
    begins = 2.0 * G / 30.0
    assert found.t_events[0] == pytest.approx([begins], abs=1e-9)
    assert found.q[-1, 1] == pytest.approx(30.0 / 2.0 * (1.0 - begins) ** 3 / 6, abs=1e-7)  # 2 y'' = 30 (t - begins)
    assert not found.verify().doubt


M, K, SPEED, STATIC, KINETIC = 1.0, 100.0, 0.2, 0.6, 0.4


class Slipping(hb.System):
    """A block on a spring on a belt, slower than the belt."""

    def force(self, t, q, v):
        return jnp.stack([-K * q[0] + KINETIC * M * G])


class Sticking(hb.System):
    """The block on the belt."""

    def force(self, t, q, v):
        return -K * q

    def velocity_constraint(self, t, q, v):
        return v - SPEED


SLIPPING, STICKING = Slipping(), Sticking()
BREAKS = hb.Event(
    lambda t, q, v, lam, mu: STATIC * M * G - abs(mu[0]), direction=-1, during=STICKING, then=SLIPPING, name="breaks"
)
STICKS = hb.Event(lambda t, q, v: v[0] - SPEED, direction=1, during=SLIPPING, then=STICKING, name="sticks")


def stick_slip(rounds):
    """Times at which the block breaks away and sticks again, by the closed motion of each phase."""
    w, far, rest = np.sqrt(K / M), STATIC * M * G / K, KINETIC * M * G / K
    slip = brentq(
        lambda s: (rest - far) * w * np.sin(w * s) + SPEED * np.cos(w * s) - SPEED, np.pi / 2 / w, 1.9999 * np.pi / w
    )
    back = rest + (far - rest) * np.cos(w * slip) + SPEED / w * np.sin(w * slip)
    breaks = far / SPEED + (slip + (far - back) / SPEED) * np.arange(rounds)
    return breaks, breaks + slip


@pytest.mark.parametrize(
    ("solver", "rtol"),
    [("hht", 1e-6), ("projected", 1e-9), ("scipy(method=Radau)", 1e-9), *(slow(x, 1e-9) for x in SOLVERS[1:3])],
)
def test_a_block_on_a_belt_sticks_and_slips(solver, rtol):
    problem = hb.Problem(name="belt", system=STICKING, t_span=(0, 1.2), q0=[0.0], v0=[SPEED])
    found = hb.solve(problem, solver, rtol=rtol, events=[BREAKS, STICKS])
    breaks, sticks = stick_slip(2)
    assert found.status.label == "success"
    np.testing.assert_allclose(found.t_events[0], breaks, atol=100 * rtol)
    np.testing.assert_allclose(found.t_events[1], sticks[:1], atol=100 * rtol)
    assert [phase.event for phase in found.phases] == ["", "breaks", "sticks", "breaks"]
    held = found.phases[2].rows
    np.testing.assert_allclose(found.v[held], SPEED, rtol=1e-12)  # it sticks truly
    np.testing.assert_allclose(found.mu[held, 0], -K * found.q[held, 0], rtol=1e-6)
    assert not found.verify().doubt


MASS, LENGTH = np.array([3.0, 2.0, 1.0]), np.array([1.0, 0.8, 0.6])
INERTIA = MASS * LENGTH**2 / 12


class Arm(hb.System):
    """Two links on a pivot and a bar, which the tip grips."""

    gripped: bool = False

    def mass_matrix(self, t, q):
        return jnp.diag(plane.mass_of_bodies(jnp.array(MASS), jnp.array(INERTIA)))

    def force(self, t, q, v):
        return jnp.zeros(9)

    def constraint(self, t, q):
        at, x, h = plane.placed_with_ground(q), jnp.array([1.0, 0.0]), LENGTH / 2
        first, second, a, b = [0, 0], [-1, 1], [-h[0] * x, h[0] * x], [0 * x, -h[1] * x]
        if self.gripped:
            first, second, a, b = [*first, 1], [*second, 2], [*a, h[1] * x], [*b, -h[2] * x]
        return plane.revolute_rows(at, first, second, a, b)


ARM, GRIPPED = Arm(), Arm(gripped=True)


def arm():
    """The arm at rest; the bar's end comes to its tip after 0.5 s."""
    e = lambda angle: np.array([np.cos(angle), np.sin(angle)])  # noqa: E731
    elbow = LENGTH[0] * e(0.3)
    tip = elbow + LENGTH[1] * e(0.9)
    bar = tip + LENGTH[2] / 2 * e(1.2) + 0.5 * np.array([0.4, -0.3])
    q0 = np.r_[elbow / 2, 0.3, (elbow + tip) / 2, 0.9, bar, 1.2]
    problem = hb.Problem(name="arm", system=ARM, t_span=(0, 1.0), q0=q0, v0=np.r_[np.zeros(6), -0.4, 0.3, 0.0])
    return problem, lambda t, q, v: q[6] - LENGTH[2] / 2 * jnp.cos(q[8]) - tip[0]


def about_the_pivot(q, v):
    """Moment of momentum."""
    return sum(MASS[i] * (q[3 * i] * v[3 * i + 1] - q[3 * i + 1] * v[3 * i]) + INERTIA[i] * v[3 * i + 2] for i in range(3))


@pytest.mark.parametrize("solver", some("cvode"))
def test_a_bar_is_caught_and_let_go(solver):
    problem, gap = arm()
    grip = hb.Event(gap, direction=-1, during=ARM, then=GRIPPED, name="grip")
    lets_go = hb.Event(lambda t, q, v: t - 0.8, direction=1, during=GRIPPED, then=ARM, name="lets go")
    found = hb.solve(problem, solver, rtol=1e-7, events=[grip, lets_go])
    assert found.status.label == "success"
    assert found.t_events[0] == pytest.approx([0.5], abs=1e-8)
    before, after = (found.q_events[0][0], found.v_events[0][0]), found.phases[1]
    mass = np.diag(np.repeat(MASS, 3) * np.tile([1.0, 1.0, 0.0], 3) + np.tile([0.0, 0.0, 1.0], 3) * np.repeat(INERTIA, 3))
    rows = np.asarray(jax.jacobian(lambda q: GRIPPED.constraint(0.0, q))(jnp.asarray(before[0])))
    weighted = np.linalg.solve(mass, rows.T)
    right = before[1] - weighted @ np.linalg.solve(rows @ weighted, rows @ before[1])
    np.testing.assert_allclose(after.v, right, atol=1e-10)
    assert about_the_pivot(after.q, after.v) == pytest.approx(about_the_pivot(*before), abs=1e-10)
    impact = found.impacts[0]
    np.testing.assert_allclose(impact.impulse, -rows.T @ impact.lam, atol=1e-10)
    let = found.phases[2]
    np.testing.assert_allclose(
        let.v, found.v_events[1][0], atol=1e-7 if solver == "cvode" else 1e-12
    )  # what is let go keeps its velocity
    assert found.lam.shape[1] == 6
    np.testing.assert_allclose(found.lam[let.rows, 4:], 0.0)
    drift = found.drift()
    assert drift.position.max() < 1e-6
    assert not found.verify().doubt


def test_solvers_agree_on_the_caught_bar_ten_tolerances():
    problem, gap = arm()
    grip = hb.Event(gap, direction=-1, during=ARM, then=GRIPPED, name="grip")
    right = hb.solve(problem, "projected", rtol=1e-11, atol=1e-12, events=[grip]).q[-1]
    for solver in SOLVERS:
        np.testing.assert_allclose(hb.solve(problem, solver, rtol=1e-7, events=[grip]).q[-1], right, atol=1e-6)


def test_a_grip_that_does_not_fit_is_refused():
    problem, gap = arm()
    off = problem.starting(q0=problem.q0 + np.r_[np.zeros(7), 0.01, 0.0])
    grip = hb.Event(gap, direction=-1, during=ARM, then=GRIPPED, name="grip")
    found = hb.solve(off, "projected", rtol=1e-7, events=[grip])
    assert found.status.label == "inconsistent_initial"
    assert "event 'grip' at t = 0." in found.message
    assert "g[5] = -0.01" in found.message


def test_systems_that_begin_one_another_at_one_time_end_the_run():
    one, two = Lying(), Lying()
    there = hb.Event(lambda t, q, v, lam, mu: lam[0] + 10.0, direction=-1, during=one, then=two)
    back = hb.Event(lambda t, q, v, lam, mu: lam[0] + 10.0, direction=-1, during=two, then=one)
    lying = hb.Problem(name="lying", system=one, t_span=(0, 1), q0=[0.0, 0.0], v0=[0.0, 0.0])
    found = hb.solve(lying, "projected", rtol=1e-6, events=[there, back])
    assert found.status.label == "time_resolution"
    assert "never settle" in found.message


def test_an_event_beyond_its_zero_at_the_start_happens_there():
    problem = hb.Problem(name="belt", system=STICKING, t_span=(0, 0.1), q0=[0.08], v0=[SPEED])
    found = hb.solve(problem, "projected", rtol=1e-8, events=[BREAKS, STICKS])
    assert found.t_events[0].tolist() == [0.0]
    assert found.v[-1, 0] < SPEED


@pytest.mark.parametrize("solver", ["hht", "projected"])
def test_rows_at_asked_times_belong_to_their_phases(solver):
    times = np.array([0.0, 0.1, 0.2, 0.6, 0.7, 1.0])
    problem = hb.Problem(name="belt", system=STICKING, t_span=(0, 1.0), q0=[0.0], v0=[SPEED])
    found = hb.solve(problem, solver, rtol=1e-6, events=[BREAKS, STICKS], t_eval=times)
    (breaks, *_), (sticks, *_) = stick_slip(2)
    np.testing.assert_array_equal(found.t, times)
    counts = [int(((times >= a) & (times < b)).sum()) for a, b in [(0, breaks), (breaks, sticks)]]
    assert [phase.rows.stop - phase.rows.start for phase in found.phases][:2] == counts
    np.testing.assert_allclose(found.v[:3, 0], SPEED)


class Rod(hb.System):
    """A rod on two coordinates of its middle and an angle, its end on a rail."""

    mass_matrix = (2.0, 2.0, 2.0 / 12)

    def force(self, t, q, v):
        return jnp.array([0.0, -2.0 * G, 0.0])

    def constraint(self, t, q):
        return (q[1] - jnp.sin(q[2]) / 2)[None]  # the lower end at y = 0


@pytest.mark.parametrize("numbers", [False, True])
def test_a_bound_body_rebounds_by_its_restitution_and_its_constraints_hold(numbers):
    xp = np if numbers else jnp
    wall = hb.Event(lambda t, q, v: 2.0 - q[0] - xp.cos(q[2]) / 2, direction=-1, restitution=0.8, name="wall")
    q0 = [1.0, np.sin(0.7) / 2, 0.7]
    problem = hb.Problem(name="rod", system=Rod(), t_span=(0, 1), q0=q0, v0=[2.0, 0.0, 0.0])
    found = hb.solve(problem, "projected", rtol=1e-9, events=[wall])
    place = int(np.flatnonzero(np.diff(found.t) == 0.0)[0])
    (q, v), after = (found.q[place], found.v[place]), found.v[place + 1]
    mass, rows = np.diag([2.0, 2.0, 2.0 / 12]), np.array([[0.0, 1.0, -np.cos(q[2]) / 2], [-1.0, 0.0, np.sin(q[2]) / 2]])
    weighted = np.linalg.solve(mass, rows.T)
    right = v + weighted @ np.linalg.solve(rows @ weighted, [0.0, -1.8 * rows[1] @ v])
    np.testing.assert_allclose(after, right, atol=1e-9)
    assert found.impacts[0].contact[0] > 0.0


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"restitution": 1.5}, "from 0 to 1"),
        ({"restitution": 0.5, "change": lambda t, q, v: (q, v)}, "not both"),
        ({"then": BALL}, "must be a System"),
        ({"during": [FLYING, "lying"]}, "must be a System"),
    ],
)
def test_wrong_declarations_say_what_was_expected(options, text):
    with pytest.raises((TypeError, ValueError), match=text):
        hb.Event(lambda t, q, v: q[1], direction=-1, **options)


def test_a_solution_with_phases_is_saved_and_pickled(tmp_path):
    import pickle

    found = hb.solve(BALL, "projected", rtol=1e-6, events=[FLOOR])
    read = hb.Solution.load(found.save(tmp_path / "ball"))
    assert read.impacts[0].contact == found.impacts[0].contact
    kept = pickle.loads(pickle.dumps(found))
    for one in (kept, read):
        assert [(phase.event, phase.rows) for phase in one.phases] == [(phase.event, phase.rows) for phase in found.phases]
        with pytest.raises(ValueError, match="came without the systems of its phases"):
            hb.measure_drift(BALL, one)


def latched(caught):
    """A bar that turns about its end at 1 rad/s, and a ball at rest in its way, latched to its tip or not."""
    m = Mechanism((0.0, 0.0), plane=True)
    m.body("bar", 2.0, 2 / 12, at=(0.5, 0.0), rate=-1.0, velocity=(0.0, -0.5))
    m.body("ball", 1.0, 0.01, at=(0.0, -1.0))
    m.revolute("A", "ground", "bar", at=(0.0, 0.0))
    if caught:
        m.revolute("latch", "bar", "ball", at=(1.0, 0.0), at_second=(0.0, -1.0))
        m.assemble()
    return m


def test_a_mechanism_catches_a_body_and_is_read_by_name_in_each_phase():
    free, caught = latched(False), latched(True)
    problem, angle = free.problem((0, 2.5)), free.measure("A")
    begun = caught.problem((0, 1)).system
    latch = hb.Event(
        lambda t, q, v: angle(t, q, v) + np.pi / 2, direction=-1, during=problem.system, then=begun, name="latch"
    )
    found = hb.solve(problem, "projected", rtol=1e-9, events=[latch])
    assert found.t_events[0] == pytest.approx([np.pi / 2], abs=1e-9)
    assert found.phases[1].v[2] == pytest.approx(-0.4, abs=1e-8)  # moments of inertia 2/3 and 1 about the pivot
    before, after = free.of(found, "A"), caught.of(found, "latch")
    assert before.t[-1] == after.t[0] == pytest.approx(np.pi / 2)
    np.testing.assert_allclose(np.linalg.norm(before.force(), axis=1), 2.0 * 0.5, atol=1e-8)
    np.testing.assert_allclose(np.linalg.norm(after.force(), axis=1), 0.4**2, atol=1e-8)
    assert caught.table(found)["t"].tolist() == after.t.tolist()
    with pytest.raises(ValueError, match="no phase of this mechanism's system"):
        latched(True).of(found, "latch")


class Cart(hb.System):
    """A cart on two feet at 0.3 m on both sides: height and angle."""

    def force(self, t, q, v):
        return jnp.array([-G, 0.0])


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0])
def test_two_feet_that_land_together_push_alike_and_do_not_pull(share):
    feet = [
        hb.Event(lambda t, q, v, x=x: q[0] + x * q[1], direction=-1, restitution=share, name=name)
        for x, name in ((-0.3, "left"), (0.3, "right"))
    ]
    cart = hb.Problem(name="cart", system=Cart(), t_span=(0, 0.5), q0=[1.0, 0.0], v0=[0.0, 0.0])
    found = hb.solve(cart, "projected", rtol=1e-8, events=feet)
    speed = np.sqrt(2 * G)
    np.testing.assert_allclose(found.impacts[0].contact, [(1 + share) * speed / 2] * 2, rtol=1e-7)
    if share:
        s = 0.5 - speed / G
        np.testing.assert_allclose(found.q[-1], [share * speed * s - G * s * s / 2, 0.0], atol=1e-7)
    else:
        assert found.status.label == "time_resolution"


class Row(hb.System):
    """Balls of 1 kg on springs, which would be at their places together."""

    def force(self, t, q, v):
        return -10 * (q - 0.1 * jnp.arange(q.size))


@pytest.mark.parametrize("solver", ["projected", "cvode", slow("hht"), "ida"])
def test_balls_that_collide_at_one_time_do_not_pass_one_another(solver):
    x0 = np.array([-0.03, -0.02, 0.01, 0.02])
    touch = [
        hb.Event(lambda t, q, v, i=i: q[i + 1] - q[i] - 0.1, direction=-1, restitution=1.0, name=f"pair {i}")
        for i in range(3)
    ]
    row = hb.Problem(name="row", system=Row(), t_span=(0, 0.8), q0=x0 + 0.1 * np.arange(4), v0=np.zeros(4))
    found = hb.solve(row, solver, rtol=1e-9, atol=1e-11, events=touch)
    assert found.status.label == "success"
    assert min(np.diff(found.q, axis=1).ravel()) > 0.1 - 1e-8
    assert found.v[-1].sum() == pytest.approx(np.sqrt(10) * 0.02 * np.sin(np.sqrt(10) * 0.8), abs=1e-7)  # momentum
    energy = 5 * ((found.q - 0.1 * np.arange(4)) ** 2).sum(axis=1) + (found.v**2).sum(axis=1) / 2
    np.testing.assert_allclose(energy, energy[0], rtol=1e-6)  # which order of impacts is the limit of such a case is open


def shaken(share, rate):
    """A ball that lies on a table of 0.05 m sin(rate t), is thrown off and lands again."""

    class Off(hb.System):
        def force(self, t, q, v):
            return jnp.array([-G])

    class On(Off):
        def constraint(self, t, q):
            return q - 0.05 * jnp.sin(rate * t)

    off, on = Off(), On()
    hits = hb.Event(lambda t, q, v: q[0] - 0.05 * jnp.sin(rate * t), direction=-1, restitution=share, during=off, then=on)
    lifts = hb.Event(lambda t, q, v, lam, mu: lam[0], direction=1, during=on, then=off, name="lifts")
    return hb.Problem(name="table", system=on, t_span=(0, 1), q0=[0.0], v0=[0.05 * rate], events=[hits, lifts])


@pytest.mark.parametrize("solver", some("ida"))
@pytest.mark.parametrize("rate", [15.0, slow(20.0)])
def test_a_ball_on_a_shaken_table_is_thrown_off_and_lands_again(solver, rate):
    found = hb.solve(shaken(0.0, rate), solver, rtol=1e-8)
    assert found.status.label == "success"
    begun = np.arcsin(G / 0.05 / rate**2) / rate  # where the table falls faster than the ball
    assert found.t_events[1][0] == pytest.approx(begun, abs=1e-7)
    assert (found.q[:, 0] - 0.05 * np.sin(rate * found.t)).min() > -1e-6
    times, t = [], begun
    while t < 1.0:  # of throws, by the closed flight
        y, v = 0.05 * np.sin(rate * t), 0.05 * rate * np.cos(rate * t)
        gap = lambda s: y + v * (s - t) - G / 2 * (s - t) ** 2 - 0.05 * np.sin(rate * s)  # noqa: B023, E731
        grid = np.linspace(t + 1e-3, t + 1.0, 4000)
        i = int(np.flatnonzero(np.array([gap(s) for s in grid]) < 0)[0])
        times.append(t)
        lands = brentq(gap, grid[i - 1], grid[i])
        later = [begun + 2 * np.pi * k / rate for k in range(20)]
        presses = 0.05 * rate**2 * np.sin(rate * lands) < G
        t = next(s for s in later if s > lands) if presses else lands
    own = np.unique(found.t_events[1].round(6))  # within its error a solver may land and lift again at once
    np.testing.assert_allclose(own, times, atol=1e-6)


@pytest.mark.parametrize("solver", some("cvode"))
def test_a_ball_that_falls_onto_a_shaken_table_bounces_rests_and_is_thrown_off(solver):
    """Numbers: the closed flights, impacts and throws, in a few lines of NumPy of another hand."""
    table = shaken(0.3, 15.0)
    off = table.events[0].during
    found = hb.solve(replace(table, system=off, t_span=(0, 3), q0=np.array([0.3]), v0=np.zeros(1)), solver, rtol=1e-6)
    assert found.status.label == "success"
    assert {0.4895, 0.9084, 1.3273, 1.7461, 2.165, 2.5839} <= set(found.t_events[1].round(4))
    assert found.q[-1, 0] == pytest.approx(0.042545, abs=1e-5)
    assert (found.q[:, 0] - 0.05 * np.sin(15 * found.t)).min() > -1e-5


def test_a_change_before_a_switch_is_not_held_by_the_constraints_that_end():
    jump = hb.Event(lambda t, q, v: t - 0.5, direction=1, change=lambda t, q, v: (q, v + jnp.array([0.0, 5.0])), then=FLYING)
    lying = hb.Problem(name="lying", system=LYING, t_span=(0, 1), q0=[0.0, 0.0], v0=[0.0, 0.0])
    found = hb.solve(lying, "projected", rtol=1e-8, events=[jump])
    np.testing.assert_allclose(found.q[-1], [0.0, 5.0 * 0.5 - G / 8], atol=1e-8)


def test_an_event_in_every_system_passes_the_zero_at_which_it_switched():
    shift = hb.Event(lambda t, q, v: v[1] + 3.0, direction=-1, then=Flying(), name="shift")
    found = hb.solve(BALL, "projected", rtol=1e-8, t_span=(0, 0.4), events=[shift])
    assert found.status.label == "success"
    np.testing.assert_allclose(found.t_events[0], [3.0 / G], atol=1e-9)


def test_a_distance_that_depends_on_velocities_is_refused():
    with pytest.raises(ValueError, match="a distance, of t and q; it depends on v"):
        hb.solve(BALL, "projected", events=[hb.Event(lambda t, q, v: q[1] + 0.1 * v[1], direction=-1, restitution=0.5)])


def test_an_accuracy_is_shown_across_phases():
    problem, gap = arm()
    grip = hb.Event(gap, direction=-1, during=ARM, then=GRIPPED, name="grip")
    found = hb.solve(problem, "projected", accuracy=1e-5, events=[grip])
    assert found.status.label == "success"
    assert found.error.bound < 1e-5


@pytest.mark.parametrize("solver", ["cvode", "hht"])
def test_budgets_count_the_steps_and_not_the_rows(solver):
    problem = hb.Problem(name="belt", system=STICKING, t_span=(0, 1.2), q0=[0.0], v0=[SPEED], events=[BREAKS, STICKS])
    taken = hb.solve(problem, solver, rtol=1e-5).counters.steps_accepted
    times = np.linspace(0.0, 1.2, 41)
    found = hb.solve(problem, solver, rtol=1e-5, t_eval=times, max_num_steps=taken + 5)
    assert found.status.label == "success"
    np.testing.assert_array_equal(found.t, times)


def test_an_event_that_reads_a_multiplier_of_another_system_is_refused_by_name():
    lifts = hb.Event(lambda t, q, v, lam, mu: lam[0], direction=1, then=FLYING, name="lifts")
    with pytest.raises(hb.ProblemError, match="'lifts' reads a multiplier that is not there: Flying has lam"):
        hb.solve(BALL, rtol=1e-4, events=[lifts])


def test_a_terminal_event_that_would_begin_a_system_ends_with_one_row():
    lands = hb.Event(lambda t, q, v: q[1], direction=-1, then=LYING, terminal=True, name="lands")
    found = hb.solve(BALL, rtol=1e-4, events=[lands])
    assert found.status.label == "event"
    assert found.t[-1] > found.t[-2]
