"""Files of robots: closed loops hold, the page moves as its equation says, names, controls and what is refused."""

from __future__ import annotations

import re
import sys
import warnings
from pathlib import Path

import mujoco
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.mechanics import Mechanism
from hhtbench.protocol.errors import ProblemError
from tests.mechanics.loops import MODELS, gap_of_mujoco, gaps
from tests.mechanics.trees import BODY, FULL, PLANAR, POLAR, UNIVERSAL, body, joint, link, mjcf
from tests.sample import slow

PAGE = Path(__file__).parent.parent.parent / "docs" / "files.md"
FLOOR = "<geom name='floor' type='plane' size='1 1 1'/>"
BALL = '<geom size=".1"/>'


def written(folder, text):
    path = folder / "robot.xml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "seconds"),
    [*((x, 2) for x in ("four bar", "parallelogram", "geared pair")), *(slow(x, 60) for x in MODELS)],
)
@pytest.mark.filterwarnings("ignore:redundant")
def test_loops_stay_closed_where_those_of_mujoco_open(name, seconds):
    g, rate, found = gaps(name, seconds)
    assert found.success
    assert np.ptp(found.q, axis=0).max() > 0.05  # it moves
    assert max(g, rate) <= 1e-12
    assert gap_of_mujoco(name, seconds) > 1e-4


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:redundant")
def test_the_slider_crank_of_the_page_moves_as_equations_in_joint_coordinates_say(capsys, monkeypatch, tmp_path):
    """Mass matrix and bias of MuJoCo's tree, the closing row of one's own, SciPy."""
    monkeypatch.chdir(tmp_path)
    scope: dict = {}
    exec(re.search(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)[1], scope)
    shown = [float(x) for x in re.findall(r"-?\d+\.\d+(?:e[+-]\d+)?", capsys.readouterr().out.splitlines()[-1])]
    model = mujoco.MjModel.from_xml_path("crank.xml")
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data, M, J = mujoco.MjData(model), np.zeros((3, 3)), np.zeros((3, 3))
    rod, slider = model.body("rod").id, model.body("slider").id

    def closing(q, v):
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        end = data.xpos[rod] + data.xmat[rod].reshape(3, 3) @ [0.6, 0, 0]
        rows, moving = np.zeros((3, 3)), np.zeros(3)
        for i, sign in ((rod, 1.0), (slider, -1.0)):
            mujoco.mj_jac(model, data, J, None, end if i == rod else data.xpos[slider], i)
            rows += sign * J
            mujoco.mj_jacDot(model, data, J, None, end if i == rod else data.xpos[slider], i)
            moving += sign * J @ v
        return rows[[0, 2]], moving[[0, 2]], (end - data.xpos[slider])[[0, 2]]

    def rates(t, y):
        G, moving, _ = closing(y[:3], y[3:])
        mujoco.mj_fullM(model, data, M)
        force = data.qfrc_passive - data.qfrc_bias + [2 * np.sin(3 * t), 0, 0]
        matrix = np.block([[M, G.T], [G, np.zeros((2, 2))]])
        return [*y[3:], *np.linalg.solve(matrix, [*force, *-moving])[:3]]

    tilt = -np.arcsin(0.2 * np.sin(0.5) / 0.6) - 0.5
    travel = 0.2 * np.cos(0.5) + 0.6 * np.cos(0.5 + tilt) - 0.8
    assert np.abs(closing(np.array([0.5, tilt, travel]), np.zeros(3))[2]).max() < 1e-12
    y = solve_ivp(rates, (0, 2), [0.5, tilt, travel, 0, 0, 0], "DOP853", rtol=1e-8, atol=1e-9).y[:, -1]
    np.testing.assert_allclose(shown[:2], [y[0], y[2]], atol=1e-4)


def test_the_model_that_mujoco_ships_has_its_accelerations(tmp_path):
    """Ball joints, free bodies, hinges on one body, meshes, motors and servos; what is not modelled is off in both."""
    from tests.mechanics.test_files_trees import worst

    source = Path(mujoco.__file__).parent / "testdata" / "model.xml"
    text = source.read_text().replace('<flag fwdinv="enable"', '<flag equality="disable" fwdinv="enable"')
    path = written(tmp_path, text)
    with pytest.raises(ProblemError, match=r"contacts \(.*gravity compensation \(head\); fluid"):
        Mechanism.from_mjcf(path)
    m = Mechanism.from_mjcf(path, drop=True)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    model.opt.density = model.opt.viscosity = 0.0
    model.body_gravcomp[:] = 0.0
    for i in range(model.nu):
        if model.actuator_dyntype[i]:
            model.actuator_gainprm[i] = model.actuator_biasprm[i] = 0.0
    gap, rows = worst(m, model, dict.fromkeys(range(model.nu), 0.0))
    assert rows < 1e-11
    assert gap < 1e-9


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<mujoco><worldbody><bdy/></worldbody></mujoco>", "robot.xml: .*unrecognized element Element 'bdy', line 1"),
        (mjcf("<geom type='mesh' mesh='x'/>", "<asset><mesh name='x' file='nix.stl'/></asset>"), "robot.xml: .*'nix.stl'"),
        (mjcf("<body name='p'><joint/></body>"), "robot.xml: .*mass and inertia of moving bodies.*'p'"),
        ("<robot name='r'><link name='a'/></robot>", r"robot.xml is URDF: type Mechanism.from_urdf\("),
        (mjcf(body("p", f'<joint name="j" limited="true" range="0 1"/>{BALL}')), r"limits \(j\). Type drop=\['limits'\]"),
        (mjcf(body("p", f'<joint name="j" frictionloss="1"/>{BALL}')), r"frictionloss \(j\)"),
        (mjcf(FLOOR + body("p", f"<freejoint/>{BALL}")), r"contacts \(floor, geom 1\)"),
        (mjcf(body("p", f'<joint name="a" axis="0 0 1"/><joint name="b" pos=".1 0 0" axis="0 1 0"/>{BALL}')),
         "a, b of one body"),
        (mjcf(body("p", f'<joint name="a"/><joint name="b" axis="1 1 1"/><joint name="c" axis="1 0 0" damping="1"/>{BALL}')),
         "joint 'c' is one of a composite"),
        (mjcf(body("p", f'<joint name="a" axis="0 0 1"/><joint name="b" axis="0 0 1"/>{BALL}')),
         "hinges have parallel axes"),
        (mjcf(body("p", f'<joint name="j"/>{BALL}'),
          '<actuator><intvelocity name="i" joint="j" actrange="0 1"/></actuator>'),
         r"actuators \(i has a state\)"),
        (mjcf(body("p", f'<joint name="j"/>{BALL}'), '<tendon><fixed name="T"><joint joint="j" coef="1"/></fixed></tendon>'),
         r"tendons \(T\)"),
    ],
)  # fmt: skip
def test_errors_name_the_file_and_the_element(text, says, tmp_path):
    with pytest.raises(ProblemError, match=says):
        Mechanism.from_mjcf(written(tmp_path, text))


def test_options_that_do_not_fit_are_refused_by_name(tmp_path):
    path = written(tmp_path, mjcf(body("p", f'<joint name="j"/>{BALL}'), "<actuator><motor name='m' joint='j'/></actuator>"))
    with pytest.raises(ProblemError, match=r"there is no file '.*none.xml'"):
        Mechanism.from_mjcf(tmp_path / "none.xml")
    with pytest.raises(ProblemError, match=r"there is no kind 'contact'. Did you mean contacts"):
        Mechanism.from_mjcf(path, drop=["contact"])
    with pytest.raises(ProblemError, match="there is no actuator 'n'"):
        Mechanism.from_mjcf(path, controls={"n": 1.0})
    with pytest.raises(ProblemError, match="a control must be a number or a function of time; got 'on'"):
        Mechanism.from_mjcf(path, controls={"m": "on"})
    with pytest.raises(ProblemError, match="there is no keyframe 'home'; it has none"):
        Mechanism.from_mjcf(path, key="home")
    loose = "<robot name='r'>" + link("a") + link("b") + link("c") + joint("j", "continuous", "a", "b") + "</robot>"
    with pytest.raises(ProblemError, match=r"several roots: a, c"):
        Mechanism.from_urdf(written(tmp_path, loose))


def test_a_mimic_joint_follows(tmp_path):
    text = "<robot name='r'><link name='base'/>" + link("a") + link("b") + joint("j", "continuous", "base", "a")
    text += joint("k", "continuous", "a", "b", '<mimic joint="j" multiplier="-1.7" offset="0.2"/>') + "</robot>"
    m = Mechanism.from_urdf(written(tmp_path, text), drop=["contacts"])
    assert m.assemble(at={"j": 0.3}).degrees_of_freedom == 1
    run = hb.solve(m.problem((0, 1)), "projected", rtol=1e-6)
    j, k = (m.of(run, name).angle() for name in "jk")
    np.testing.assert_allclose(j[0], 0.3, atol=1e-12)
    assert np.ptp(j) > 0.1
    np.testing.assert_allclose(k, 0.2 - 1.7 * j, atol=1e-12)


def test_names_of_a_body_a_joint_and_a_motor_may_be_the_same_and_keyframes_are_starts(tmp_path):
    inside = f'<joint name="hip" axis="0 1 0"/>{BALL}'
    rest = "<actuator><motor name='hip' joint='hip'/></actuator><keyframe><key name='up' qpos='1' qvel='2'/></keyframe>"
    m = Mechanism.from_mjcf(
        written(tmp_path, mjcf(body("hip", inside), rest)), controls={"hip": lambda t: 3.0 * t}, key="up"
    )
    assert list(m.joints) == ["hip joint"]
    assert "hip actuator" in m.forces
    run = hb.solve(m.problem((0, 1.0)), "projected", rtol=1e-8)
    angle = m.of(run, "hip joint").angle()
    inertia = m.bodies["hip"].inertia[1, 1]  # gravity does not turn a ball about its centre
    np.testing.assert_allclose(angle[0], 1.0, atol=1e-12)
    np.testing.assert_allclose(angle[-1], 1 + 2 + 0.5 / inertia, rtol=1e-6)


@pytest.mark.parametrize(("tree", "at"), [
    slow(PLANAR, {"rootz": 0.3, "rooty": 1.0, "hip": 0.5}), (POLAR, {"swing": 0.7, "reach": 0.2, "c": 0.1, "d": -0.4}),
    (UNIVERSAL, {"h": 0.3, "k": 0.5, "s": 0.1, "y": -0.2}),
])  # fmt: skip
def test_joints_of_composites_are_read_and_set_by_their_names_as_in_the_file(tree, at, tmp_path):
    """Positions, readings and motion against MuJoCo's joint coordinates."""
    path = written(tmp_path, mjcf(tree))
    m = Mechanism.from_mjcf(path, drop=["contacts"])
    m.assemble(at=at)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    data = mujoco.MjData(model)

    def rates(t, y):
        data.qpos[:], data.qvel[:] = y[: model.nq], y[model.nq :]
        mujoco.mj_forward(model, data)
        return np.concatenate([data.qvel, data.qacc])

    names = [model.joint(i).name for i in range(model.njnt)]
    one = hb.solve(m.problem((0, 0.3)), "projected", rtol=1e-8)
    slides = [model.jnt_type[i] == mujoco.mjtJoint.mjJNT_SLIDE for i in range(model.njnt)]
    read = [
        m.of(one, name).travel() if slide else m.of(one, name).angle() for name, slide in zip(names, slides, strict=True)
    ]
    start = np.array([x[0] for x in read])
    np.testing.assert_allclose([start[names.index(name)] for name in at], list(at.values()), atol=1e-9)
    y = solve_ivp(rates, (0, 0.3), [*start, *np.zeros(model.nv)], rtol=1e-11, atol=1e-12).y[: model.nq, -1]
    np.testing.assert_allclose([x[-1] for x in read], y, atol=1e-5)


def test_sites_that_are_welded_or_connected_come_together(tmp_path):
    inside = "<freejoint/>" + FULL + '<site name="{}" pos=".1 .2 0" euler="30 10 {}"/>'
    bodies = body("p", inside.format("s", 5)) + body("q", inside.format("r", 40), pos=".2 .1 .3", euler="0 0 10")
    m = Mechanism.from_mjcf(written(tmp_path, mjcf(bodies, '<equality><weld site1="s" site2="r"/></equality>')))
    assert m.assemble().degrees_of_freedom == 6
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    placed = []
    for name, site in (("p", "s"), ("q", "r")):
        drawn, now = data.body(name).xmat.reshape(3, 3), m.bodies[name]
        local = drawn.T @ (data.site(site).xpos - data.body(name).xipos)
        placed.append((now.x + now.R @ local, now.R @ drawn.T @ data.site(site).xmat.reshape(3, 3)))
    np.testing.assert_allclose(placed[0][0], placed[1][0], atol=1e-9)
    np.testing.assert_allclose(placed[0][1], placed[1][1], atol=1e-9)


def test_no_log_file_is_left_and_a_warning_of_the_compiler_is_a_warning(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    limits = '<limit lower="1" upper="1" effort="1" velocity="1"/>'
    text = "<robot name='r'><link name='base'/>" + link("a") + joint("j", "prismatic", "base", "a", limits) + "</robot>"
    path = written(tmp_path, text)
    with pytest.warns(UserWarning, match="robot.xml: joint 'j' has equal lower and upper limits"):
        Mechanism.from_urdf(path, drop=True)
    assert [file.name for file in tmp_path.iterdir()] == ["robot.xml"]


def test_a_model_of_one_file_has_no_warnings(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Mechanism.from_mjcf(written(tmp_path, mjcf(body("p", '<joint name="j"/>' + BODY))))


@pytest.mark.parametrize("order", [("slide", "hinge"), slow(("hinge", "slide"))])
def test_reactions_of_a_composite_carry_its_body(order, tmp_path):
    """Newton and Euler about the centre, for slides before and behind the hinge."""
    kinds = {"slide": '<joint name="s" type="slide" axis="1 0 0"/>', "hinge": '<joint name="h" axis="0 1 0"/>'}
    m = Mechanism.from_mjcf(written(tmp_path, mjcf(body("p", kinds[order[0]] + kinds[order[1]] + FULL))))
    m.assemble(at={"s": 0.2, "h": 0.4}, rates={"s": 1.0, "h": 2.0})
    run = hb.solve(m.problem((0, 0.5)), "projected", rtol=1e-9)
    joint, read, given = m.of(run, "+".join(kind[0] for kind in order)), m.of(run, "p"), m.bodies["p"]
    R, w = read.rotation(), read.rate()
    J = R @ given.inertia @ R.transpose(0, 2, 1)
    force = given.mass * (read.acceleration() - m.gravity)
    spin = np.einsum("kab,kb->ka", J, w)
    torque = np.einsum("kab,kb->ka", J, read.angular_acceleration()) + np.cross(w, spin)
    point = m.joints["+".join(kind[0] for kind in order)].points[1]
    np.testing.assert_allclose(point, [-0.1, -0.02, -0.05], atol=1e-12)  # the joints' point, the origin of the body's frame
    at = read.position(point)
    np.testing.assert_allclose(joint.force(), force, atol=1e-9)
    np.testing.assert_allclose(joint.torque() + np.cross(at - read.position(), joint.force()), torque, atol=1e-9)


def test_without_mujoco_the_message_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ImportError, match=r"pip install 'hhtbench\[mujoco\]'"):
        Mechanism.from_mjcf(written(tmp_path, mjcf(body("p", f'<joint name="j"/>{BALL}'))))


ACTUATED = (
    '<mujoco><option gravity="0 0 0" {option}/><worldbody><body name="p"><joint name="j" axis="0 1 0"/>'
    '<geom type="capsule" size=".05" fromto="0 0 0 .5 0 0" contype="0" conaffinity="0"/></body>{more}</worldbody>'
    '<actuator><motor name="m" joint="j" group="1"/></actuator>'
    '<keyframe><key name="home" ctrl="0.2"/></keyframe></mujoco>'
)


def turned(m):
    return float(m.of(hb.solve(m.problem((0, 1)), "projected", rtol=1e-9), "j").angle()[-1])


def test_a_keyframe_has_its_controls_and_a_group_can_be_off(tmp_path):
    path = written(tmp_path, ACTUATED.format(option="", more=""))
    asked = turned(Mechanism.from_mjcf(path, controls={"m": 0.2}))
    assert asked != 0.0
    assert turned(Mechanism.from_mjcf(path, key="home")) == pytest.approx(asked)
    assert turned(Mechanism.from_mjcf(path, key="home", controls={"m": 0.4})) == pytest.approx(2 * asked)
    path = written(tmp_path, ACTUATED.format(option='actuatorgroupdisable="1"', more=""))
    assert turned(Mechanism.from_mjcf(path, controls={"m": 0.2})) == 0.0


def test_a_frame_that_is_moved_from_outside_is_left_out_where_it_is_dropped(tmp_path):
    path = written(tmp_path, ACTUATED.format(option="", more='<body name="hand" mocap="true"/>'))
    with pytest.raises(ProblemError, match="moving frames"):
        Mechanism.from_mjcf(path)
    assert list(Mechanism.from_mjcf(path, drop=["moving frames"]).bodies) == ["p"]


def test_a_spring_that_passes_half_a_turn_ends_the_run_instead_of_jumping(tmp_path):
    spring = '<joint name="j" axis="0 1 0" stiffness="1" springref="0"/>'
    geom = '<geom type="capsule" size=".05" fromto="0 0 0 .5 0 0" contype="0" conaffinity="0"/>'
    path = written(
        tmp_path, f'<mujoco><option gravity="0 0 0"/><worldbody><body name="p">{spring}{geom}</body></worldbody></mujoco>'
    )
    m = Mechanism.from_mjcf(path)
    m.assemble(rates={"j": 15.0})
    found = hb.solve(m.problem((0, 3)), "projected", rtol=1e-7)
    assert found.status.label == "nonfinite_callback"
    assert abs(m.of(found, "j").angle()).max() < np.pi
