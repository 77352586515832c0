"""Mechanisms from MJCF and URDF files, which MuJoCo's compiler reads: this module takes the arrays of its model.

Source: E. Todorov and others, MuJoCo documentation, chapters Computation and XML reference.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from hhtbench.mechanics.multibody import unmodelled
from hhtbench.mechanics.multibody.controls import controlled, expect_coordinate
from hhtbench.mechanics.multibody.parts import GROUND
from hhtbench.protocol.errors import ProblemError

NAMED = "body", "joint", "equality", "actuator"  # share one set of names in a mechanism
FORMATS = {"mjcf": b"<mujoco", "urdf": b"<robot"}


def read(m: Any, path: Any, wanted: str, drop: Any, controls: Any, key: str | None) -> Any:
    """Fill the mechanism ``m`` from a file of the format ``wanted``, see ``Mechanism.from_mjcf``."""
    mujoco, file = _mujoco(), Path(path)
    if not file.is_file():
        raise ProblemError(f"there is no file {str(path)!r}.")
    content = file.read_bytes()
    other = next((name for name, root in FORMATS.items() if name != wanted and root in content), None)
    if other and FORMATS[wanted] not in content:
        raise ProblemError(f"{file.name} is {other.upper()}: type Mechanism.from_{other}({str(path)!r}).")
    if wanted == "urdf":
        _expect_one_root(file)
    before, said = mujoco.get_mju_user_warning(), list[str]()
    mujoco.set_mju_user_warning(said.append)  # else it writes a log file where the process runs
    try:
        model = mujoco.MjModel.from_xml_path(str(file))
    except ValueError as e:
        raise ProblemError(f"{file.name}: {' '.join(str(e).split())}") from None
    finally:
        mujoco.set_mju_user_warning(before)
    for text in said:
        warnings.warn(f"{file.name}: {text.strip()}", stacklevel=4)
    try:
        robot = File(mujoco, model)
        unmodelled.expect_modelled(robot, file.name, drop)
        number = None if key is None else _key_number(robot, key)
        start = np.zeros(model.nactuator) if number is None else model.key_ctrl[number]
        given = {robot.given("actuator", i): float(value) for i, value in enumerate(start)}
        _fill(m, robot, given | (controls or {}))
        if number is not None:
            _start(m, robot, number)
    except ProblemError as e:
        raise ProblemError(f"{file.name}: {e}") from None
    return m


def _expect_one_root(file: Path) -> None:
    """Raise if a URDF file has several root links: MuJoCo reads one of them."""
    try:
        robot = ElementTree.parse(file).getroot()
    except ElementTree.ParseError as e:
        raise ProblemError(f"{file.name}: {e}") from None
    children = {child.get("link") for child in robot.findall("joint/child")}
    roots = [str(link.get("name")) for link in robot.findall("link") if link.get("name") not in children]
    if len(roots) > 1:
        raise ProblemError(f"{file.name}: several roots: {', '.join(roots)}; the links of a robot are one tree.")


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError as e:
        raise ImportError("files of robots are read by MuJoCo: pip install 'hhtbench[mujoco]'") from e
    return mujoco


class File:
    """A compiled model, its poses at ``qpos0``, and the names that the mechanism uses."""

    def __init__(self, mujoco: Any, model: Any) -> None:
        self.mujoco, self.model, self.data = mujoco, model, mujoco.MjData(model)
        mujoco.mj_kinematics(model, self.data)
        mujoco.mj_comPos(model, self.data)

    def name(self, kind: str, i: int) -> str:
        """Name of an element, with its kind if a body, joint or equality before has it; without one its kind and number."""
        found = self.given(kind, i)
        before = NAMED[: NAMED.index(kind)] if kind in NAMED else ()
        taken = found == GROUND or any(self.mujoco.mj_name2id(self.model, self._kind(one), found) >= 0 for one in before)
        return f"{found} {kind}" if taken else found

    def given(self, kind: str, i: int) -> str:
        """Name of an element in the file."""
        return self.mujoco.mj_id2name(self.model, self._kind(kind), int(i)) or f"{kind} {i}"

    def _kind(self, kind: str) -> Any:
        return getattr(self.mujoco.mjtObj, f"mjOBJ_{kind.upper()}")

    def body(self, i: int) -> str:
        """Name of the body that moves with body ``i``."""
        root = int(self.model.body_weldid[i])
        return self.name("body", root) if self.moves(root) else GROUND

    def moves(self, i: int) -> bool:
        """True if body ``i`` is one of the mechanism's: not part of another, and not held from outside."""
        return i > 0 and bool(self.model.body_weldid[i] == i) and bool(self.model.body_mocapid[i] < 0)

    def off(self, flag: str) -> bool:
        """True if the file disables ``flag``."""
        return bool(self.model.opt.disableflags & int(getattr(self.mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}")))

    def joints(self, i: int) -> range:
        """Numbers of the joints of body ``i``."""
        return range(self.model.body_jntadr[i], self.model.body_jntadr[i] + self.model.body_jntnum[i])

    def kind(self, j: int) -> str:
        """free, ball, slide or hinge."""
        return str(self.mujoco.mjtJoint(int(self.model.jnt_type[j])).name)[len("mjJNT_") :].lower()

    def dof(self, values: str, j: int) -> float:
        """Value of the first degree of freedom of joint ``j``."""
        return float(np.ravel(getattr(self.model, values)[self.model.jnt_dofadr[j]])[0])


def _fill(m: Any, file: File, controls: dict[str, Any]) -> None:
    model = file.model
    m.gravity = np.zeros(3) if file.off("gravity") else np.array(model.opt.gravity)
    moving = list(filter(file.moves, range(model.nbody)))
    for i in moving:
        _add_body(m, file, i)
    for i in moving:
        _add_joints(m, file, i)
    for j in range(model.njnt):
        _add_passive(m, file, j)
    controlled(m, file, controls)
    if not (file.off("equality") or file.off("constraint")):
        for number in np.flatnonzero(model.eq_active0):
            _add_equality(m, file, int(number))


def _add_body(m: Any, file: File, root: int) -> None:
    mass, local, J = _welded(file, root)
    R = file.data.xmat[root].reshape(3, 3)
    m.body(file.name("body", root), mass, J, at=file.data.xpos[root] + R @ local, turned=R)


def _welded(file: File, root: int) -> tuple[float, Any, Any]:
    """Mass, centre and inertia about it, in the frame of ``root``, of all bodies that are welded to it."""
    model, data = file.model, file.data
    parts = [i for i in np.flatnonzero(model.body_weldid == root) if model.body_mass[i] > 0]
    if not parts:
        raise ProblemError(f"body {file.name('body', root)!r} moves and has no mass.")
    masses, x, R = model.body_mass[parts], data.xipos[parts], data.xmat[root].reshape(3, 3)
    centre, J = masses @ x / masses.sum(), np.zeros((3, 3))
    for i, mass, offset in zip(parts, masses, x - centre, strict=True):
        axes = data.ximat[i].reshape(3, 3)
        J += axes @ np.diag(model.body_inertia[i]) @ axes.T + mass * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    J = R.T @ (J + J.T) @ R / 2
    return float(masses.sum()), R.T @ (centre - data.xpos[root]), (J + J.T) / 2


def _add_joints(m: Any, file: File, i: int) -> None:
    model, data, joints = file.model, file.data, list(file.joints(i))
    pair = file.body(int(model.body_parentid[i])), file.body(i)
    kinds, names = [file.kind(j) for j in joints], [file.name("joint", j) for j in joints]
    at, axes = data.xanchor[joints], data.xaxis[joints]
    if kinds == ["free"]:
        return
    if len(joints) > 1:
        given = {name: (kind, None if kind == "ball" else axis) for name, kind, axis in zip(names, kinds, axes, strict=True)}
        m.composite("+".join(names), *pair, _common(names, kinds, at, axes), given)
    elif kinds == ["hinge"]:
        m.revolute(names[0], *pair, at[0], axes[0])
    elif kinds == ["slide"]:
        m.prismatic(names[0], *pair, at[0], axes[0])
    else:
        m.spherical(names[0], *pair, at[0])


def _common(names: list[str], kinds: list[str], at: Any, axes: Any) -> Any:
    """Point on the axes of all hinges of a body."""
    turning = [i for i, kind in enumerate(kinds) if kind != "slide"]
    if not turning:
        return at[0]
    across = [np.eye(3) - (kinds[i] == "hinge") * np.outer(axes[i], axes[i]) for i in turning]
    rows, values = (
        np.concatenate(across),
        np.concatenate([P @ (at[i] - at[turning[0]]) for i, P in zip(turning, across, strict=True)]),
    )
    step = np.linalg.lstsq(rows, values, rcond=1e-9)[0]
    if np.max(np.abs(rows @ step - values)) > 1e-9 * max(1.0, float(np.max(np.abs(at)))):
        raise ProblemError(
            f"joints {', '.join(names)} of one body: axes without a common point have no rows; put a body between them."
        )
    return at[turning[0]] + step


def _add_passive(m: Any, file: File, j: int) -> None:
    """Spring, damper and armature of a joint; the free coordinate from the drawn pose."""
    model, kind, name = file.model, file.kind(j), file.name("joint", j)
    stiffness = 0.0 if file.off("spring") else float(model.jnt_stiffness[j])
    damping = 0.0 if file.off("damper") else file.dof("dof_damping", j)
    armature, a = file.dof("dof_armature", j), model.jnt_qposadr[j]
    if stiffness and kind in ("free", "ball"):
        body, turning = int(model.jnt_bodyid[j]), [stiffness] * 3
        spring = [stiffness if kind == "free" else 0.0] * 3 + turning
        m.bushing(
            f"spring of {name}", file.body(int(model.body_parentid[body])), file.body(body), file.data.xanchor[j], spring
        )
        stiffness = 0.0
    if kind == "free" and (damping or armature):
        raise ProblemError(f"joint {name!r}: damping and armature of free joints are not modelled.")
    if stiffness or damping or armature:
        passive = {"damping": damping, "armature": armature}
        if kind != "ball":
            passive |= {"stiffness": stiffness, "free": float(model.qpos_spring[a] - model.qpos0[a])}
        expect_coordinate(m, file, j)
        m.actuator(f"passive {name}", name, **passive)


def _add_equality(m: Any, file: File, i: int) -> None:
    model, data, name = file.model, file.data, file.name("equality", i)
    kind = str(file.mujoco.mjtEq(int(model.eq_type[i])).name)[len("mjEQ_") :].lower()
    one, two, values = int(model.eq_obj1id[i]), int(model.eq_obj2id[i]), model.eq_data[i]
    if kind == "joint":
        for j in (one, two):
            if j >= 0:
                expect_coordinate(m, file, j)
        m.couple(name, file.name("joint", one), file.name("joint", two) if two >= 0 else None, values[:5])
        return
    if kind not in ("connect", "weld"):
        return  # refused, or dropped
    if model.eq_objtype[i] == int(file.mujoco.mjtObj.mjOBJ_SITE):
        frames = [(data.site_xpos[k], data.site_xmat[k].reshape(3, 3)) for k in (one, two)]
        bodies = [file.body(int(model.site_bodyid[k])) for k in (one, two)]
        points = [x for x, _ in frames]
        R1, R2 = (R for _, R in frames)
    else:
        (x1, R1), (x2, R2) = ((data.xpos[k], data.xmat[k].reshape(3, 3)) for k in (one, two))
        bodies = [file.body(one), file.body(two)]
        if kind == "connect":
            points = [x1 + R1 @ values[:3], x2 + R2 @ values[3:6]]
        else:  # the anchor in the second body, the pose of the second in the first
            turned = np.zeros(9)
            file.mujoco.mju_quat2Mat(turned, values[6:10])
            points = [x1 + R1 @ (values[3:6] + turned.reshape(3, 3) @ values[:3]), x2 + R2 @ values[:3]]
            R1 = R1 @ turned.reshape(3, 3)
    if bodies[0] == bodies[1]:
        return
    if kind == "connect":
        m.spherical(name, *bodies, points[0], at_second=points[1])
    else:
        m.weld(name, *bodies, points[0], at_second=points[1], axes=R1, axes_second=R2)


def _key_number(file: File, key: str) -> int:
    names = [file.name("key", i) for i in range(file.model.nkey)]
    if key not in names:
        raise ProblemError(f"there is no keyframe {key!r}; it has {', '.join(names) or 'none'}.")
    return names.index(key)


def _start(m: Any, file: File, number: int) -> None:
    """Poses and velocities of a keyframe."""
    data = file.mujoco.MjData(file.model)
    file.mujoco.mj_resetDataKeyframe(file.model, data, number)
    place(m, file, data)


def place(m: Any, file: File, data: Any) -> None:
    """Move the bodies of ``m`` to the positions and velocities of ``data``."""
    model, mujoco = file.model, file.mujoco
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fwdVelocity(model, data)
    for i in range(1, model.nbody):
        if not file.moves(i):
            continue
        body, R = m.bodies[file.name("body", i)], data.xmat[i].reshape(3, 3).copy()
        offset = R @ _welded(file, i)[1]
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, i, velocity, 0)
        body.x, body.R, body.p = data.xpos[i] + offset, R, None
        body.rate, body.velocity = velocity[:3], velocity[3:] + np.cross(velocity[:3], offset)
