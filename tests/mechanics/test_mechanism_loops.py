"""Closed loops and redundant mechanisms: balances of bodies, reactions whatever j0, assembly from rough poses, bad input."""

from __future__ import annotations

import functools

import equinox as eqx
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.mechanics import Mechanism
from hhtbench.protocol.errors import ProblemError
from problems import bricard, heavy_top, rolling_disk3d_steady
from tests.sample import slow

X, Y, Z = np.eye(3)
G = np.array([0.0, -9.81, 0.0])


def parallelogram():
    """A beam on four parallel bars, two too many; in space the axes are redundant too."""
    m = Mechanism(G)
    m.body("beam", 2.0, (0.1, 0.5, 0.5), at=(1.5, 1, 0), velocity=(1.0, 0, 0))
    for i in range(4):
        m.body(f"bar {i}", 0.3, (0.03, 0.002, 0.03), at=(i, 0.5, 0), velocity=(0.5, 0, 0), rate=(0, 0, -1.0))
        m.revolute(f"foot {i}", "ground", f"bar {i}", (i, 0, 0), Z)
        m.revolute(f"head {i}", f"bar {i}", "beam", (i, 1, 0), Z)
    return m


def door():
    """A plate on two hinges of one axis, off its principal axes."""
    m = Mechanism(G)
    m.body(
        "door",
        3.0,
        [[0.5, 0.1, 0.05], [0.1, 0.7, 0.1], [0.05, 0.1, 0.6]],
        at=(0.4, 0.2, 0.1),
        rate=2 * Y,
        velocity=(0.2, 0, -0.8),
    )
    m.revolute("lower", "ground", "door", (0, -0.5, 0), Y)
    m.revolute("upper", "door", "ground", (0, 0.5, 0), Y)
    return m


def spatial_crank():
    """A crank drives a slider across through a rod with a Cardan and a ball joint: one degree of freedom."""
    m = Mechanism((0, 0, -9.81))
    m.body("crank", 1.0, (0.02, 0.03, 0.03), at=(0.0, 0.1, 0.3))
    m.body("rod", 2.0, (0.2, 0.25, 0.1), at=(0.5, 0.2, 0.3))
    m.body("slider", 3.0, (0.05, 0.06, 0.07), at=(1.0, 0.2, 0.0))
    m.revolute("A", "ground", "crank", (0, 0, 0.3), X)
    m.spherical("B", "crank", "rod", (0, 0.2, 0.6))
    m.universal("C", "rod", "slider", (1.0, 0.2, 0.0), Y, Z)
    m.prismatic("D", "ground", "slider", (1.0, 0.2, 0.0), X)
    return m


def four_bar():
    """In the plane."""
    m = Mechanism(plane=True)
    m.body("crank", 1.0, 0.02, at=(0.0, 0.5), turned=np.pi / 2)
    m.body("coupler", 2.0, 0.3, at=(1.0, 1.25))
    m.body("rocker", 1.5, 0.2, at=(2.25, 0.75), turned=1.0)
    m.revolute("A", "ground", "crank", (0, 0))
    m.revolute("B", "crank", "coupler", (0, 1))
    m.revolute("C", "coupler", "rocker", (2, 1.5))
    m.revolute("D", "rocker", "ground", (2.5, 0))
    return m


@functools.cache
def solved(make, solver, share, steps=None):
    """The mechanism, its solution, and j0 that is ``share`` of the one that it takes by itself."""
    m = make()
    problem = m.problem((0, 0.2))
    system = eqx.tree_at(lambda one: one.j0, problem.system, problem.system.j0 * share)
    own = hb.Problem(name="loop", system=system, t_span=(0, 0.2), q0=problem.q0, v0=problem.v0)
    settings = {"steps": steps} if steps else {"rtol": 1e-9}
    solution = hb.solve(own, solver, t_eval=[0.0, 0.1, 0.2], **settings)
    assert solution.status.label == "success", solution.message
    return m, solution


@pytest.mark.parametrize(
    "make",
    [
        *(parallelogram, spatial_crank, slow(door)),
        *(slow(x.mechanism) for x in (bricard, heavy_top, rolling_disk3d_steady)),
    ],
)
def test_forces_and_moments_on_every_body_balance(make):
    """Newton and Euler: ``m a`` and ``d(J w)/dt`` against weight and the joints' readings, below 1e-10 of the largest."""
    m, solution = solved(make, "projected", 1.0)
    joints = {name: (joint, m.of(solution, name)) for name, joint in m.joints.items()}
    for name, body in m.bodies.items():
        read = m.of(solution, name)
        x, R = read.position(), read.rotation()
        J = R @ body.inertia @ R.transpose(0, 2, 1)
        w, alpha = read.rate(), read.angular_acceleration()
        spin = np.einsum("kab,kb->ka", J, w)
        force, torque = body.mass * (read.acceleration() - m.gravity), np.einsum("kab,kb->ka", J, alpha) + np.cross(w, spin)
        size = max(abs(force).max(), abs(torque).max(), body.mass * 9.81)
        for joint, reaction in joints.values():
            if name in (joint.first, joint.second):
                sign = 1.0 if name == joint.second else -1.0
                local = joint.points[1] if joint.second == "ground" else None
                point = local if local is not None else m.of(solution, joint.second).position(joint.points[1])
                on = sign * reaction.force()
                size = max(size, abs(on).max())
                force, torque = force - on, torque - sign * reaction.torque() - np.cross(point - x, on)
        assert max(abs(force).max(), abs(torque).max()) < 1e-10 * size, name


@pytest.mark.parametrize("make", [bricard.mechanism, parallelogram, door])
def test_reactions_of_redundant_joints_do_not_depend_on_the_mass_of_quaternions(make):
    m, one = solved(make, "projected", 1.0)
    _, other = solved(make, "projected", 7.0)
    assert m.mobility().redundant
    for name in m.joints:
        for reading in ("force", "torque"):
            a, b = (getattr(m.of(solution, name), reading)() for solution in (one, other))
            np.testing.assert_allclose(b, a, rtol=0, atol=1e-10 * max(10.0, abs(a).max()), err_msg=name)


def test_hht_depends_on_the_mass_of_quaternions_by_its_own_error_only():
    """At the start not at all (1e-10); afterwards by an error of order two in the step, which falls by four."""
    m, gaps = door(), []
    for steps in (20, 40):
        one, other = (m.of(solved(door, "hht", share, steps)[1], "lower").force() for share in (1.0, 7.0))
        gaps.append(abs(one - other).max(axis=1))
    assert gaps[0][0] < 1e-10
    np.testing.assert_allclose(gaps[0][1:] / gaps[1][1:], 4.0, rtol=0.05)


def test_joints_that_share_a_load_are_named():
    assert door().mobility().redundant == 5
    assert door().mobility().sharing == (("lower", "upper"),)
    assert bricard.mechanism().mobility().degrees_of_freedom == 1
    assert parallelogram().mobility().degrees_of_freedom == 1


@pytest.mark.parametrize("poses", [40, slow(100)])
@pytest.mark.parametrize("make", [spatial_crank, four_bar])
def test_rough_poses_come_together_on_the_same_branch(make, poses):
    """Of poses off by up to 0.25 m or in each coordinate 95 % assemble, and none of them on another branch."""
    random, right = np.random.default_rng(11), 0
    m = make()
    m.assemble()
    drawn = {name: (body.x, body.R, body.angle) for name, body in m.bodies.items()}
    for _ in range(poses):
        for name, (x, R, angle) in drawn.items():
            body, off = m.bodies[name], random.uniform(-0.25, 0.25, 7)
            body.x = x + off[: m.dimension]
            if m.plane:
                body.angle = angle + off[2]
                body.R = np.array([[np.cos(body.angle), -np.sin(body.angle)], [np.sin(body.angle), np.cos(body.angle)]])
            else:
                p = np.array([1.0, 0, 0, 0]) + off[3:]
                body.R = m._rotation(name, p)[0] @ R
        try:
            m.assemble({"A": 0.0})
        except ProblemError:
            continue
        right += 1
        for name, (x, R, _) in drawn.items():
            if make is four_bar or name == "slider":
                np.testing.assert_allclose(m.bodies[name].x, x, atol=1e-7)
                np.testing.assert_allclose(m.bodies[name].R, R, atol=1e-7)
    assert right >= 0.95 * poses


def test_start_has_the_rates_asked_for_and_open_loops_are_named():
    m = four_bar()
    m.assemble({"A": 0.3}, rates={"A": 2.0})
    solution = hb.solve(m.problem((0, 0.01)), "projected", rtol=1e-6)
    np.testing.assert_allclose([m.of(solution, "A").angle()[0], m.of(solution, "A").rate()[0]], [0.3, 2.0], atol=1e-10)
    before = m.bodies["coupler"].x
    m.distance("too far", "ground", "coupler", (9, 9), m.bodies["coupler"].x, length=0.1)
    with pytest.raises(ProblemError, match="too far"):
        m.assemble()
    np.testing.assert_array_equal(m.bodies["coupler"].x, before)


def cranks(count):
    """Cranks side by side on the ground, turning about z."""
    m = Mechanism()
    for i in range(count):
        m.body(f"crank {i}", 1.0, (0.1, 0.1, 0.1), at=(i, 0, 0))
        m.revolute("AB"[i], "ground", f"crank {i}", (i, 0, 0), Z)
    return m


def shown(m, body):
    """Angle of a body about z."""
    return np.arctan2(m.bodies[body].R[1, 0], m.bodies[body].R[0, 0])


@pytest.mark.parametrize("angle", [4.0, -7.5])
def test_motor_begins_at_its_own_angle_however_far(angle):
    m = cranks(1)
    m.motor("drive", "A", lambda t: angle + t)
    if np.cos(angle) < 0:  # its row holds half a turn off, too
        with pytest.raises(ProblemError, match=r"motor 'drive' prescribes .* call m.assemble"):
            m.problem((0, 1))
    m.assemble()
    assert abs(np.exp(1j * shown(m, "crank 0")) - np.exp(1j * angle)) < 1e-8
    np.testing.assert_allclose(m.bodies["crank 0"].rate, Z, atol=1e-12)
    solution = hb.solve(m.problem((0, 0.01)), "projected", rtol=1e-8)
    np.testing.assert_allclose(m.of(solution, "A").angle()[[0, -1]], [angle, angle + 0.01], atol=1e-8)


def test_numbers_are_constant_laws_of_motors():
    m = cranks(2)
    m.motor("held", "A", 0.5)
    m.motor("driven", "B", speed=6.0)
    m.assemble()
    solution = hb.solve(m.problem((0, 0.1)), "projected", rtol=1e-8)
    np.testing.assert_allclose(m.of(solution, "A").angle(), 0.5, atol=1e-10)
    np.testing.assert_allclose(m.of(solution, "B").angle(), 6.0 * solution.t, atol=1e-8)


def test_rates_are_those_asked_for_at_any_angle():
    m = cranks(1)
    m.assemble({"A": 2.0})
    m.assemble(rates={"A": 2.0})
    np.testing.assert_allclose(m.bodies["crank 0"].rate, 2.0 * Z, atol=1e-10)
    assert abs(shown(m, "crank 0") - 2.0) < 1e-10


@pytest.mark.parametrize("teeth", [(17, 43), (-20, 60)])
def test_gears_keep_their_teeth_from_rough_poses(teeth):
    random, m = np.random.default_rng(3), cranks(2)
    m.gear("gear", "A", "B", teeth)
    m.body("cart", 1.0, (1, 1, 1))
    drawn = {name: (body.x, body.R) for name, body in m.bodies.items()}
    for _ in range(5):
        for name, (x, R) in drawn.items():
            m.bodies[name].x = x + random.uniform(-0.1, 0.1, 3)
            m.bodies[name].R = m._rotation(name, np.array([1.0, 0, 0, 0]) + random.uniform(-0.1, 0.1, 4))[0] @ R
            for joint in m.joints.values():
                joint.turns = 0
        m.assemble({"A": 1.3}, rates={"A": 2.0})
        other = -1.3 * teeth[0] / teeth[1]
        assert abs(np.exp(1j * shown(m, "crank 1")) - np.exp(1j * other)) < 1e-8
        np.testing.assert_allclose(m.bodies["crank 1"].rate[2], -2.0 * teeth[0] / teeth[1], atol=1e-8)


def test_screw_stays_in_its_thread_when_its_bodies_are_brought_together():
    m = Mechanism()
    m.body("nut", 1.0, (1, 1, 1))
    m.cylindrical("thread", "ground", "nut", (0, 0, 0), Z, at_second=(0, 0, 0.004))
    m.screw("screw", "thread", 0.01)
    m.assemble()
    angle, travel = shown(m, "nut"), m.bodies["nut"].x[2] + 0.004
    assert abs(angle - 2 * np.pi * travel / 0.01) < 1e-8


def test_two_motors_of_one_speed_share_their_load_evenly():
    m = cranks(1)
    m.motor("one", "A", speed=lambda t: 1 + t)
    m.motor("two", "A", speed=lambda t: 1 + t)
    m.assemble()
    assert m.mobility().sharing == (("one", "two"),)
    solution = hb.solve(m.problem((0, 0.1)), "projected", rtol=1e-8, t_eval=[0.0, 0.05, 0.1])
    one, two = (m.of(solution, name).torque()[:, 2] for name in ("one", "two"))
    np.testing.assert_allclose(one, two, atol=1e-9)
    np.testing.assert_allclose(one + two, 0.1, atol=1e-8)  # J dw/dt about the hinge at the centre


def test_solution_of_a_mechanism_that_was_extended_is_not_read():
    m = cranks(1)
    solution = hb.solve(m.problem((0, 0.01)), "projected", rtol=1e-6)
    m.of(solution, "A").force()
    m.body("more", 1.0, (1, 1, 1))
    with pytest.raises(ProblemError, match="other bodies or joints than the solution"):
        m.of(solution, "A").force()


BAD = {
    "'light': mass must be above 0": lambda m: m.body("light", 0.0, (1, 1, 1)),
    "'odd': no body has": lambda m: m.body("odd", 1.0, (1, 1, 3)),
    "'skew': inertia must be": lambda m: m.body("skew", 1.0, [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]]),
    "turned of body 'still' must be": lambda m: m.body("still", 1.0, (1, 1, 1), turned=(0, 0, 0, 0)),
    "at of body 'flat' must be 3": lambda m: m.body("flat", 1.0, (1, 1, 1), at=(0, 0)),
    "no body 'dor'": lambda m: m.revolute("A", "ground", "dor", (0, 0, 0), Z),
    "'door' is there already": lambda m: m.revolute("door", "ground", "door", (0, 0, 0), Z),
    "axis of joint 'A' must be": lambda m: m.revolute("A", "ground", "door", (0, 0, 0), (0, 0, 0)),
    "'A' joins 'door' to itself": lambda m: m.weld("A", "door", "door", (0, 0, 0)),
    "'A': length must be above 0": lambda m: m.distance("A", "ground", "door", (0, 0, 0), (0, 0, 0)),
    "no joint 'uper'": lambda m: m.motor("A", "uper", lambda t: t),
    "motor 'A': a law must be a number": lambda m: m.motor("A", "upper", speed=np.nan),
    "motor 'A': give either": lambda m: m.motor("A", "upper"),
    "'A': axis and axis_second": lambda m: m.universal("A", "ground", "door", (0, 0, 0), Z, Z + X),
    "both axes are parallel": lambda m: m.universal("A", "ground", "door", (0, 0, 0), Z, Z),
    "'A' acts on the ground": lambda m: m.load("A", "ground", force=(1, 2, 3)),
    "'A': stiffness must be finite": lambda m: m.spring("A", "ground", "door", (0, 0, 0), (1, 0, 0), np.nan),
    "'A': radius must be above 0": lambda m: m.rolling("A", "door", -1.0, (0, 0, 1), point=(0, 0, 0), normal=Z),
    "'A': onset must be above 0": lambda m: m.contact("A", "door", "ground", (0, 0, 0), 1.0, point=Z, normal=Z, onset=0.0),
    "axes of bushing 'A' must be": lambda m: m.bushing("A", "ground", "door", (0, 0, 0), 1.0, axes=np.ones((3, 3))),
    "'A': axis is along normal": lambda m: m.tyre(
        "A", "door", "ground", (0, 0, 1), 1.0, 1e5, axis=Z, point=(0, 0, 0), normal=Z, grip=(1, 1, 1, 1), onset=1e-3
    ),
    "load 'A': force must be 3": lambda m: m.load("A", "door", force=(1, 2)),
    "contact 'A': give either": lambda m: m.contact("A", "door", "ground", (0, 0, 0), 1.0, onset=1e-3),
}


@pytest.mark.parametrize("text", BAD)
def test_bad_input_is_refused_in_the_call_with_the_name(text):
    with pytest.raises(ProblemError, match=text.split("(")[0]):
        BAD[text](door())


def test_masses_in_another_unit_are_told_with_both_names():
    m = door()
    m.body("ship", 1e9, (1e9, 1e9, 1e9))
    with pytest.warns(UserWarning, match="'ship' has 1e.09 kg beside 3 kg of 'door'"):
        m.problem((0, 1))
