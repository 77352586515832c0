"""Mechanisms by name: every joint and force against closed solutions, plane against space, balances of bodies, assembly."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import hhtbench as hb
from hhtbench.mechanics import Mechanism
from hhtbench.protocol.errors import ProblemError

G = 9.81
SLOPE = np.array([0.6, 0.8])  # normal of a plane that falls towards +x at sin = 0.6
TIMES = np.linspace(0.0, 2.0, 9)


def circle(x):
    """Zero on the circle of 1 m about (16, 0), in the plane or in space."""
    round_it = (x[0] - 16) ** 2 + x[1] ** 2 - 1
    return round_it if x.size == 2 else jnp.stack([round_it, x[2]])


def many(plane):
    """Single bodies side by side, one for each kind of joint and force, moving in the x-y plane."""
    P = (lambda x, y: (x, y)) if plane else (lambda x, y: (x, y, 0.0))
    T = (lambda n: n) if plane else (lambda n: (0, 0, n))
    J = (lambda j: j) if plane else (lambda j: (0.7 * j, 0.9 * j, j))
    Z = {} if plane else {"axis": (0, 0, 1)}
    m = Mechanism(P(0, -G), plane=plane)
    m.body("driven", 2.0, J(0.3), at=P(0.5, 0))
    m.revolute("driven pin", "ground", "driven", P(0, 0), **Z)
    m.motor("angle", "driven pin", lambda t: 7 * t * t)
    m.body("spun", 2.0, J(0.3), at=P(0.5, 2), rate=T(3.0), velocity=P(0, 1.5))
    m.revolute("spun pin", "ground", "spun", P(0, 2), **Z)
    m.motor("speed", "spun pin", speed=lambda t: 3 + jnp.sin(t))
    m.body("lift", 1.5, J(0.1), at=P(5, 0))
    m.prismatic("shaft", "ground", "lift", P(5, 0), P(0, 1))
    m.motor("travel", "shaft", lambda t: 1 - jnp.cos(2 * t))
    m.body("sled", 1.0, J(0.1), at=P(7, 0))
    m.prismatic("rail", "ground", "sled", P(7.2, 0.3), P(4, -3))
    m.body("hung", 1.0, J(0.2), at=P(9, 0))
    m.weld("weld", "ground", "hung", P(8.5, 0.2))
    m.body("bob", 1.0, J(0.2), at=P(11.5, 0))
    m.distance("rod", "ground", "bob", P(10, 0), P(11.5, 0))
    m.body("bead", 1.0, J(0.2), at=P(14, 0))
    m.on_line("wire", "ground", "bead", P(14, 0), P(4, -3))
    m.body("ring", 1.0, J(0.2), at=P(17, 0))
    m.on_curve("curve", "ground", "ring", P(17, 0), circle)
    m.body("wheel", 1.0, J(0.2), at=P(20, 0))
    m.body("pinion", 1.0, J(0.05), at=P(21, 0))
    m.revolute("wheel pin", "ground", "wheel", P(20, 0), **Z)
    m.revolute("pinion pin", "ground", "pinion", P(21, 0), **Z)
    m.gear("teeth", "wheel pin", "pinion pin", (30, 10))
    m.load("drive", "wheel", torque=T(2.0))
    hub = P(*(np.array([24.0, 0.0]) + 0.5 * SLOPE))
    m.body("disc", 1.0, J(0.125), at=hub)
    m.rolling("roll", "disc", 0.5, hub, point=P(24, 0), normal=P(*SLOPE), **Z)
    m.body("mass", 2.0, J(0.1), at=P(30, -1))
    m.prismatic("guide", "ground", "mass", P(30, -1), P(0, 1))
    m.spring("coil", "ground", "mass", P(30, 0), P(30, -1), 50.0, 2.0, free=0.8)
    m.body("balance", 2.0, J(0.4), at=P(33, 0))
    m.revolute("staff", "ground", "balance", P(33, 0), **Z)
    m.torsion("hairspring", "staff", 5.0, 0.3, free=1.0)
    m.body("cushioned", 2.0, J(0.4), at=P(36, 0))
    k, c = (
        ((80.0, 50.0, 3.0), (1.0, 2.0, 0.1))
        if plane
        else ((80.0, 50.0, 60.0, 2.0, 2.5, 3.0), (1.0, 2.0, 1.0, 0.1, 0.1, 0.1))
    )
    m.bushing("cushion", "ground", "cushioned", P(36, 0), k, c)
    m.body("rocket", 2.0, J(0.4), at=P(39, 0), rate=T(2.0))
    m.load("jet", "rocket", force=P(3.0, 0.5), follows=True)
    m.body("pushed", 2.0, J(0.4), at=P(42, 0))
    m.load("push", "pushed", P(42.0, 0.1), force=lambda t: jnp.stack([3 * jnp.sin(t), 0 * t, 0 * t][: 2 if plane else 3]))
    m.body("puck", 2.0, J(0.2), at=P(50, 0.499), velocity=P(3, 0))
    m.contact(
        "floor",
        "puck",
        "ground",
        P(50, 0.499),
        1e5,
        radius=0.5,
        point=P(0, 0),
        normal=P(0, 1),
        onset=1e-5,
        loss=0.3,
        friction=(0.3, 1e-3),
    )
    m.body("marble", 1.0, J(0.01), at=P(60.2, -1.9))
    m.contact("bowl", "marble", "ground", P(60.2, -1.9), 1e4, radius=0.1, centre=P(60, 0), other=-2.0, loss=0.1, onset=1e-5)
    return m


@functools.cache
def solved(plane):
    """The mechanism and its solution; readings of both are shared by the tests."""
    m = many(plane)
    return m, hb.solve(m.problem((0, 2)), "projected", rtol=1e-8, t_eval=TIMES)


def pendulum(length, inertia=0.0, mass=1.0):
    """Angle below the level of a pendulum that starts there at rest, at TIMES."""
    gain = mass * G * length / (inertia + mass * length**2)
    found = solve_ivp(lambda t, y: [y[1], gain * np.cos(y[0])], (0, 2), [0, 0], t_eval=TIMES, rtol=1e-11, atol=1e-12)
    return found.y[0]


def oscillator(mass, c, k, start, load):
    """``mass x'' + c x' + k x = load`` from ``start`` at rest, at TIMES: the closed solution."""
    a, mean = c / (2 * mass), load / k
    w = np.sqrt(k / mass - a**2)
    return mean + (start - mean) * np.exp(-a * TIMES) * (np.cos(w * TIMES) + a / w * np.sin(w * TIMES))


def test_joints_and_forces_move_as_closed_solutions_say():
    m, solution = solved(True)
    x = {name: m.of(solution, name).position() for name in m.bodies}
    t = TIMES
    close = functools.partial(np.testing.assert_allclose, rtol=0, atol=2e-7)  # rtol = 1e-8 over 2 s
    close(m.of(solution, "driven pin").angle(), 7 * t**2)
    close(m.of(solution, "spun pin").angle(), 3 * t + 1 - np.cos(t))
    close(m.of(solution, "shaft").travel(), 1 - np.cos(2 * t))
    close(m.of(solution, "rail").travel(), 0.6 * G * t**2 / 2)
    close(x["hung"], [[9, 0]] * t.size)
    close(m.of(solution, "wire").travel(), 0.6 * G * t**2 / 2)
    angle = pendulum(1.5)
    close(x["bob"] - [10, 0], 1.5 * np.column_stack([np.cos(angle), -np.sin(angle)]))
    angle = pendulum(1.0)
    close(x["ring"] - [16, 0], np.column_stack([np.cos(angle), -np.sin(angle)]))
    close(m.of(solution, "wheel pin").angle(), 2 / (0.2 + 9 * 0.05) * t**2 / 2)
    close(m.of(solution, "pinion pin").angle(), -3 * m.of(solution, "wheel pin").angle())
    rolled = 0.6 * G / 1.5 * t**2 / 2
    close(x["disc"] - x["disc"][0], rolled[:, None] * [0.8, -0.6])
    close(m.of(solution, "disc").rotation(), -rolled / 0.5)
    close(-x["mass"][:, 1], oscillator(2.0, 2.0, 50.0, 1.0, 2 * G + 50 * 0.8))
    close(m.of(solution, "staff").angle(), oscillator(0.4, 0.3, 5.0, 0.0, 5.0))
    close(x["cushioned"][:, 1], oscillator(2.0, 2.0, 50.0, 0.0, -2 * G))
    close(x["pushed"] - [42, 0], np.column_stack([1.5 * (t - np.sin(t)), -G * t**2 / 2]))
    a = 1.5 / 2j * ((np.exp(2j * t) - 1) / 2j - t) * (1 + 0.5j / 3)  # of (3 + 0.5 i) exp(2 i t) / 2, twice integrated
    close(x["rocket"] - [39, 0], np.column_stack([a.real, a.imag - G * t**2 / 2]))


def test_puck_slows_by_friction_until_it_rolls():
    """Coulomb: ``v = v0 - mu g t`` and ``J w' = mu m g r`` until ``v = r w``."""
    m, solution = solved(True)
    v, w = m.of(solution, "puck").velocity()[:, 0], m.of(solution, "puck").rate()
    slides = TIMES < 3 / (0.3 * G * (1 + 2 * 0.25 / 0.2))
    np.testing.assert_allclose(v[slides], 3 - 0.3 * G * TIMES[slides], atol=0.02)
    lever = 0.5 + m.of(solution, "floor").measure()  # to the point of contact, which is pressed in
    np.testing.assert_allclose(v[~slides], -(lever * w)[~slides], atol=2e-3)
    np.testing.assert_allclose(v[-1], 3 / (1 + 0.2 / (2 * 0.25)), rtol=0.01)


def test_reactions_of_single_bodies_are_those_of_statics_and_of_newton():
    m, solution = solved(True)
    t = TIMES
    close = functools.partial(np.testing.assert_allclose, rtol=1e-9, atol=1e-9)
    close(m.of(solution, "weld").force(), [[0, G]] * t.size)
    close(m.of(solution, "weld").torque(), [0.5 * G] * t.size)
    lift = m.of(solution, "travel")
    close(lift.force()[:, 1], 1.5 * (G + 4 * np.cos(2 * t)))
    close(lift.power(), 1.5 * (G + 4 * np.cos(2 * t)) * 2 * np.sin(2 * t), atol=1e-6)
    drive = m.of(solution, "angle")
    moment = (0.3 + 2 * 0.25) * 14 + 2 * G * 0.5 * np.cos(7 * t**2)
    close(drive.torque(), moment, atol=1e-5)
    close(drive.power(), moment * 14 * t, atol=1e-4)
    close(m.of(solution, "speed").torque(), (0.3 + 0.5) * np.cos(t) + G * np.cos(3 * t + 1 - np.cos(t)), atol=1e-5)
    teeth = m.of(solution, "teeth")
    alpha = 2 / (0.2 + 9 * 0.05)
    close(teeth.torque(), [0.2 * alpha - 2] * t.size)
    close(teeth.torque(on="pinion"), [-3 * 0.05 * alpha] * t.size)
    roll = m.of(solution, "roll")
    close(roll.force() @ SLOPE, [0.8 * G] * t.size)
    close(roll.force() @ [0.8, -0.6], [-0.6 * G / 3] * t.size)


class At:
    """States with accelerations and multipliers from the equations of motion, solved here: read like a solution."""

    phases, layout = (), None

    def __init__(self, m, t, q, v, system=None):
        self.x = self.u = np.zeros((len(t), 0))
        system = m.system() if system is None else system

        def one(t, q, v):
            F, M = system.force(t, q, v), system.mass_matrix
            M = M(t, q) if callable(M) else jnp.diag(M)
            C, c = [], []
            if system.constraint is not None:
                C.append(jax.jacfwd(system.constraint, 1)(t, q))
                once = lambda t, q: jax.jvp(system.constraint, (t, q), (1.0, v))[1]  # noqa: E731
                c.append(jax.jvp(once, (t, q), (1.0, v))[1])
            rows = sum(x.shape[0] for x in C)
            if (k := system.velocity_constraint) is not None:
                C.append(jax.jacfwd(k, 2)(t, q, v))
                c.append(jax.jvp(lambda t, q: k(t, q, v), (t, q), (1.0, v))[1])
            C, c = jnp.concatenate(C), jnp.concatenate(c)
            return F, M, C, c, jnp.zeros(rows)

        self.system, (self.t, self.q, self.v) = system, (np.asarray(x, float) for x in (t, q, v))
        F, M, C, c, none = (np.asarray(x) for x in jax.jit(jax.vmap(one))(self.t, self.q, self.v))
        W = np.linalg.solve(M, np.concatenate([C.swapaxes(1, 2), F[..., None]], axis=2))
        both = np.stack([np.linalg.lstsq(G @ w[:, :-1], G @ w[:, -1] + b)[0] for G, w, b in zip(C, W, c, strict=True)])
        self.a = W[..., -1] - np.einsum("kij,kj->ki", W[..., :-1], both)
        self.lam, self.mu = both[:, : none.shape[1]], both[:, none.shape[1] :]

    def powers(self):
        """Change of the energy along the motion, and the power given to it, (k,) each."""

        def one(t, q, v, a, lam, mu):
            given = self.system.power(t, q, v, lam, mu) if self.system.power is not None else 0.0
            return jax.jvp(self.system.energy, (t, q, v), (1.0, v, a))[1], given

        return jax.jit(jax.vmap(one))(self.t, self.q, self.v, self.a, self.lam, self.mu)


@functools.cache
def in_space():
    """The planar solution's states as states of the same mechanism in space."""
    solution, m = solved(True)[1], many(False)
    x, v = (np.asarray(y).reshape(TIMES.size, -1, 3) for y in (solution.q, solution.v))
    half, rate = x[..., 2] / 2, v[..., 2] / 2
    none = np.zeros_like(half)
    q = np.stack([x[..., 0], x[..., 1], none, np.cos(half), none, none, np.sin(half)], axis=-1)
    v = np.stack([v[..., 0], v[..., 1], none, -np.sin(half) * rate, none, none, np.cos(half) * rate], axis=-1)
    return m, At(m, TIMES, q.reshape(TIMES.size, -1), v.reshape(TIMES.size, -1))


@pytest.mark.long  # half a minute, most of it for the equations of 19 bodies in space
def test_plane_and_space_agree():
    """Columns of both tables, by name, at the same states."""
    (m, solution), (solid, states) = solved(True), in_space()
    flat, there = m.table(At(m, TIMES, solution.q, solution.v)), solid.table(states)
    for name, values in flat.items():
        size = max(1.0, abs(values).max())
        both = there[name] if name in there else there[f"{name}.z"]
        np.testing.assert_allclose(both, values, rtol=0, atol=1e-9 * size, err_msg=name)


@pytest.mark.parametrize("plane", [True, pytest.param(False, marks=pytest.mark.long)])
def test_energy_changes_by_the_power_of_motors_dampers_friction_and_loads(plane):
    m, solution = solved(True)
    states = At(m, TIMES, solution.q, solution.v) if plane else in_space()[1]
    gain, given = states.powers()
    np.testing.assert_allclose(gain, given, rtol=0, atol=1e-9 * abs(given).max())


@pytest.mark.long  # a quarter of a minute
def test_claims_of_the_problem_hold():
    """Derivatives, start, rank, and energy against power: of motors, dampers, friction, loads."""
    m, _ = solved(True)
    report = hb.check(m.problem((0, 2)))
    assert report.passed, report.summary


def only_in_space():
    """A screw, a tube, a plate on a plane and a ball that rolls, each alone, at rest."""
    m = Mechanism((0, -G, 0))
    m.body("nut", 2.0, (0.3, 0.1, 0.4), at=(0, 0, 0))
    m.cylindrical("thread", "ground", "nut", (0, 0, 0), (0, 1, 0))
    m.screw("screw", "thread", 0.5)
    m.body("tube", 2.0, (0.3, 0.1, 0.4), at=(3, 0, 0))
    m.cylindrical("bar", "ground", "tube", (3, 0, 0), (0, 1, 0))
    m.body("plate", 1.0, (0.3, 0.4, 0.5), at=(6, 0, 0))
    m.planar("table", "ground", "plate", (6, 0, 0), (*SLOPE, 0))
    m.body("ball", 1.0, (0.1, 0.1, 0.1), at=(9 + 0.3, 0.4, 0))
    m.rolling("roll", "ball", 0.5, (9 + 0.3, 0.4, 0), point=(9, 0, 0), normal=(*SLOPE, 0))
    return m


def test_joints_of_space_accelerate_as_closed_solutions_say():
    m = only_in_space()
    q, v = m.start()
    states = At(m, [0.0], q[None], v[None])
    close = functools.partial(np.testing.assert_allclose, rtol=1e-10, atol=1e-10)
    pitch = 2 * np.pi / 0.5
    fall = -G / (1 + 0.1 * pitch**2 / 2.0)
    close(m.of(states, "nut").acceleration(), [[0, fall, 0]])
    close(m.of(states, "nut").angular_acceleration(), [[0, pitch * fall, 0]])
    close(m.of(states, "tube").acceleration(), [[0, -G, 0]])
    close(m.of(states, "plate").acceleration(), [0.6 * G * np.array([0.8, -0.6, 0])])
    close(m.of(states, "table").force(), [0.8 * G * np.array([0.6, 0.8, 0])])
    rolls = 0.6 * G / (1 + 0.1 / 0.25)
    close(m.of(states, "ball").acceleration(), [rolls * np.array([0.8, -0.6, 0])])
    close(m.of(states, "ball").angular_acceleration(), [[0, 0, -rolls / 0.5]])


def test_cardan_joint_turns_unevenly():
    """``w2 / w1 = cos(b) / (1 - sin(b)^2 sin(a)^2)`` of shafts at an angle b; a from where w2 is least."""
    b, a = 0.5, 0.7
    m = Mechanism((0, 0, 0))
    tilted = (np.cos(b), np.sin(b), 0.0)
    m.body("one", 1.0, (0.1, 0.1, 0.1), at=(-1, 0, 0))
    m.body("two", 1.0, (0.1, 0.1, 0.1), at=tilted)
    m.revolute("in", "ground", "one", (-1, 0, 0), (1, 0, 0))
    m.revolute("out", "ground", "two", tilted, tilted)
    m.universal("cross", "one", "two", (0, 0, 0), (0, 0, 1), (-np.sin(b), np.cos(b), 0))
    assert m.assemble({"in": a}, rates={"in": 2.0}).degrees_of_freedom == 1
    q, v = m.start()
    states = At(m, [0.0], q[None], v[None])
    np.testing.assert_allclose(m.of(states, "in").rate(), [2.0], rtol=1e-10)
    ratio = np.cos(b) / (1 - np.sin(b) ** 2 * np.sin(a) ** 2)  # drawn, the arm of "one" stands across the plane of both
    np.testing.assert_allclose(m.of(states, "out").rate(), [2.0 * ratio], rtol=1e-10)


def test_springs_drawings_and_bodies_are_read_by_name():
    m, solution = solved(True)
    coil, mass = m.of(solution, "coil"), m.of(solution, "mass")
    np.testing.assert_allclose(coil.measure(), -mass.position()[:, 1], rtol=1e-12)
    np.testing.assert_allclose(coil.tension(), 50 * (coil.measure() - 0.8) + 2 * coil.rate(), rtol=1e-10)
    np.testing.assert_allclose(
        m.of(solution, "cushion").measure()[:, 1], m.of(solution, "cushioned").position()[:, 1], atol=1e-12
    )
    np.testing.assert_allclose(mass.kinetic_energy(), mass.velocity()[:, 1] ** 2, atol=1e-12)
    drawn = m.sketch(solution.q[3])
    assert drawn["lines"].shape[1:] == (2, 2)
    bob = m.of(solution, "bob").position()[3]
    assert min(np.linalg.norm(drawn["points"] - bob, axis=1)) < 1e-12
    with pytest.raises(ProblemError, match="'weld' is weld: it has no angle"):
        m.of(solution, "weld").angle()
    with pytest.raises(ProblemError, match=r"coyl.*coil"):
        m.of(solution, "coyl")


def hanging():
    """A pendulum of 1 m, drawn level, on a cart that nothing moves."""
    m = Mechanism(plane=True)
    m.body("bob", 1.0, 1e-9, at=(1.0, 0.0))
    m.body("cart", 1.0, 1.0, at=(5.0, 0.0))
    m.revolute("A", "ground", "bob", at=(0.0, 0.0))
    m.weld("W", "ground", "cart", at=(5.0, 0.0))
    return m


def test_an_event_finds_the_angle_of_a_joint_by_name():
    m = hanging()
    angle = m.measure("A")
    down = hb.Event(lambda t, q, v: angle(t, q, v) + np.pi / 2, direction=-1, name="down")
    found = hb.solve(m.problem((0, 1)), "projected", rtol=1e-9, events=[down])
    quarter = float(ellipk(0.5)) / np.sqrt(9.81)  # of a pendulum from level
    assert found.t_events[0] == pytest.approx([quarter], abs=1e-8)
