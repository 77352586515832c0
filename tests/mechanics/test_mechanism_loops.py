"""Mechanisms with loops: starts from rough poses, redundant joints, balances of forces, and what is refused."""

import dataclasses

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.mechanics import Mechanism
from hhtbench.mechanics.multibody.assembly import _place
from hhtbench.protocol.errors import ProblemError

X, Y, Z = np.eye(3)


def bricard():
    """Bricard's loop of five rods on six hinges, one of its 35 rows too many."""
    along, axes = np.stack([X, -Y, Z, -X, Y]), np.stack([Y, Z, X, Y, Z, X])
    points = np.concatenate([[0 * X], np.cumsum(along, axis=0)])
    m = Mechanism(gravity=(0, -9.81, 0))
    for i in range(5):
        moments = np.where(np.abs(along[i]) > 0.5, 0.01 / 6, 1.01 / 12)
        m.body(f"rod {i}", 1.0, moments, at=(points[i] + points[i + 1]) / 2)
    names = ["ground", *m.bodies, "ground"]
    for i in range(6):
        m.revolute(f"P{i}", names[i], names[i + 1], at=points[i], axis=axes[i])
    return m


def parallelogram():
    """A beam on three parallel bars in space."""
    m = Mechanism()
    m.body("beam", 2.0, (0.01, 0.7, 0.7), at=(1, 0, -1))
    for i in range(3):
        m.body(f"bar {i}", 1.0, (0.09, 0.09, 0.01), at=(i, 0, -0.5))
        m.revolute(f"top {i}", "ground", f"bar {i}", at=(i, 0, 0), axis=Y)
        m.revolute(f"low {i}", f"bar {i}", "beam", at=(i, 0, -1), axis=Y)
    m.assemble(rates={"top 0": 1.0})
    return m


def door():
    """A door that turns on two hinges."""
    m = Mechanism()
    m.body("door", 10.0, (2.0, 1.0, 1.0), at=(0.5, 0, 0), rate=Z, velocity=(0, 0.5, 0))
    m.revolute("upper", "ground", "door", at=(0, 0, 1), axis=Z)
    m.revolute("lower", "ground", "door", at=(0, 0, -1), axis=Z)
    return m


def four_bar():
    """A four-bar linkage in the plane, crank 1, coupler 2, rocker 2, ground 2 m."""
    m = Mechanism(plane=True)
    m.body("crank", 1.0, 0.1, at=(0, 0.5), turned=np.pi / 2)
    top = _meeting(np.array([0.0, 1.0]), 2.0, np.array([2.0, 0.0]), 2.0)
    m.body("coupler", 1.0, 0.3, at=(np.array([0, 1]) + top) / 2)
    m.body("rocker", 1.0, 0.3, at=(np.array([2, 0]) + top) / 2)
    m.revolute("A", "ground", "crank", at=(0, 0))
    m.revolute("B", "crank", "coupler", at=(0, 1))
    m.revolute("C", "coupler", "rocker", at=top)
    m.revolute("D", "ground", "rocker", at=(2, 0))
    return m


def _meeting(a, r, b, s):
    """The upper point at distance ``r`` from ``a`` and ``s`` from ``b``."""
    d = np.linalg.norm(b - a)
    along, up = (b - a) / d, np.array([-(b - a)[1], (b - a)[0]]) / d
    x = (d**2 + r**2 - s**2) / (2 * d)
    return a + x * along + np.sqrt(r**2 - x**2) * up


def reactions(m, solution):
    return np.concatenate(
        [part for name in m.joints for part in (m.of(solution, name).force(), m.of(solution, name).torque())], 1
    )


@pytest.mark.parametrize(
    "make, redundant, names",
    [(bricard, 1, 6), (parallelogram, 7, 6), (door, 5, 2)],
    ids=["bricard", "parallelogram", "door"],
)
def test_reactions_of_redundant_joints_do_not_depend_on_the_inertia_along_quaternions(make, redundant, names):
    m = make()
    found = m.mobility()
    assert (found.degrees_of_freedom, found.redundant, [len(one) for one in found.sharing]) == (1, redundant, [names])
    problem, both = m.problem((0.0, 0.6)), []
    for j0 in (0.0566, 0.5):
        system = dataclasses.replace(problem.system, j0=np.full(len(m.bodies), j0))
        with pytest.warns(UserWarning, match="redundant constraints"):
            solution = hb.solve(dataclasses.replace(problem, system=system), "projected", rtol=1e-8, t_eval=[0.0, 0.3, 0.6])
        both.append(reactions(m, solution))
    np.testing.assert_allclose(*both, rtol=0, atol=1e-10 * np.abs(both[0]).max())


@pytest.mark.parametrize("make", [bricard, parallelogram, door, four_bar])
def test_forces_and_moments_on_every_body_balance_its_motion(make):
    """Newton's and Euler's equations of each body from accelerations and joint forces, by sums of our own."""
    m = make()
    solution = hb.solve(m.problem((0.0, 0.5)), "projected", rtol=1e-8, t_eval=[0.0, 0.2, 0.5])
    for name, body in m.bodies.items():
        of, joints = m.of(solution, name), m.joints.items()
        centre, force = of.position(), body.mass * (m.gravity - of.acceleration())
        moment = np.zeros((3, 3)) if not m.plane else np.zeros(3)
        for joint, made in joints:
            sign = (made.second == name) - (made.first == name)
            if sign:
                other = made.second
                point = made.points[1] if other == "ground" else m.of(solution, other).position(made.points[1])
                F = sign * m.of(solution, joint).force()
                force = force + F
                moment = moment + sign * m.of(solution, joint).torque() + np.cross(point - centre, F)
        size = body.mass * 9.81
        np.testing.assert_allclose(force, 0.0, atol=1e-10 * size * 10)
        if m.plane:
            turning = body.inertia * of.angular_acceleration()
        else:
            w, R = of.rate(name), of.rotation()
            own = of.angular_acceleration(name) @ body.inertia + np.cross(w, w @ body.inertia)
            turning = np.einsum("kab,kb->ka", R, own)
        np.testing.assert_allclose(moment, turning, atol=1e-10 * size * 10)


@pytest.mark.parametrize("make", [bricard, four_bar])
def test_rough_poses_come_together_or_say_that_they_do_not(make):
    rng, right = np.random.default_rng(7), 0
    m = make()
    drawn, start = {name: dataclasses.replace(body) for name, body in m.bodies.items()}, m.start()[0]
    system = m.system()
    for _ in range(100):
        m.bodies = {name: dataclasses.replace(body) for name, body in drawn.items()}
        _place(m, start + rng.uniform(-0.25, 0.25, start.size), 0 * start)
        try:
            m.assemble()
        except ProblemError as refused:
            assert "better pose" in str(refused)
            continue
        q = m.start()[0]
        assert np.abs(np.asarray(system.constraint(0.0, q))).max() < 1e-9
        signs = [made.frames[0] for made in m.joints.values()]
        right += 1
        for made in () if m.plane else m.joints.values():
            axes = [
                m.pose(body)[1] @ frame[:, 2] for body, frame in zip((made.first, made.second), made.frames, strict=True)
            ]
            assert axes[0] @ axes[1] > 0.0, signs
    assert right >= 95


def test_a_start_at_an_angle_and_a_rate():
    m = four_bar()
    assert m.assemble({"A": 0.7}, rates={"A": 3.0}).degrees_of_freedom == 1
    crank = np.array([np.cos(np.pi / 2 + 0.7), np.sin(np.pi / 2 + 0.7)])
    top = _meeting(crank, 2.0, np.array([2.0, 0.0]), 2.0)
    np.testing.assert_allclose(m.bodies["rocker"].x, (np.array([2, 0]) + top) / 2, atol=1e-9)
    np.testing.assert_allclose(m.bodies["crank"].rate, 3.0, atol=1e-12)
    with pytest.raises(ProblemError, match=r"cannot be brought together.*'C'"):
        far = four_bar()
        far.joints["C"].points[0][0] += 5.0
        far.rows["point"][2].points[0][0] += 5.0
        far.assemble()


@pytest.mark.parametrize(
    "wrong, text",
    [
        (lambda m: m.body("a", 0.0, 1.0), r"body 'a': mass must be above 0 kg; got 0\.0"),
        (lambda m: m.body("crank", 1.0, 1.0), "'crank' is there already"),
        (lambda m: m.revolute("E", "crank", "rokcer", at=(0, 0)), r"no body 'rokcer'\. Did you mean rocker\?"),
        (lambda m: m.motor("M", "Q", lambda t: t), "there is no joint 'Q'"),
        (lambda m: m.spherical("S", "crank", "rocker", at=(0, 0)), "a spherical joint needs space"),
        (lambda m: m.distance("S", "crank", "rocker", (0, 0), (0, 0)), "length must be above 0 m"),
        (lambda m: m.gear("G", "A", "D", (1.5, 2)), "two whole numbers"),
        (lambda m: Mechanism().body("a", 1.0, (1, 1, 3)), "no body has the principal moments 1, 1, 3"),
        (lambda m: Mechanism().problem((0, 1)), "a mechanism needs a body"),
        (lambda m: m.body("a", 1.0, 1.0, at=(0, 0, 0)), "must be 2 numbers"),
    ],
)
def test_what_is_wrong_is_said_with_its_name(wrong, text):
    with pytest.raises(ProblemError, match=text):
        wrong(four_bar())


def test_masses_of_different_units_are_named():
    m = four_bar()
    m.body("train", 1e8, 1.0)
    m.body("gram", 1e-3, 1.0)
    with pytest.warns(UserWarning, match=r"body 'train' has 1e\+08 kg beside 0\.001 kg of 'gram': are both in kg\?"):
        m.problem((0, 1))
