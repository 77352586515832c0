"""Actuators of files: motors, position and velocity servos on joints, whose controls are numbers or functions of time."""

from __future__ import annotations

import contextlib
import functools
import inspect
from numbers import Real
from typing import Any

import jax.numpy as jnp
import numpy as np

from hhtbench.protocol.errors import ProblemError, did_you_mean

SIDES = "joint", "jointinparent"


def controlled(m: Any, file: Any, controls: dict[str, Any]) -> None:
    """Add the actuators of ``file``; ``controls`` of those that are not given are 0."""
    names = [file.given("actuator", i) for i in range(file.model.nactuator)]
    for name in controls:
        if name not in names:
            raise ProblemError(f"there is no actuator {name!r}.{did_you_mean(name, names)}")
    if file.off("actuation"):
        return
    for i, name in enumerate(names):
        disabled = file.model.opt.disableactuator >> int(file.model.actuator_group[i]) & 1
        if not disabled and not unmodelled_reason(file, i):
            _add(m, file, i, controls.get(name, 0.0))


def expect_coordinate(m: Any, file: Any, j: int) -> None:
    """Raise if the coordinate of joint ``j`` is not known."""
    name = file.name("joint", j)
    if name not in m.joints:
        raise ProblemError(
            f"joint {name!r} is one of a composite that has no coordinates of its own (three hinges not at right angles, or "
            "a ball), so its spring, damping, armature, motor or equality is not modelled; put a body between them."
        )


def unmodelled_reason(file: Any, i: int) -> str:
    """Why actuator ``i`` is not a force that depends linearly on its control and coordinate; empty if it is one."""
    model, mujoco = file.model, file.mujoco
    side = mujoco.mjtTrn(int(model.actuator_trntype[i])).name[len("mjTRN_") :].lower()
    if side not in SIDES:
        return f"acts on a {side}"
    if model.actuator_dyntype[i] != int(mujoco.mjtDyn.mjDYN_NONE):
        return "has a state"
    if model.actuator_gaintype[i] != int(mujoco.mjtGain.mjGAIN_FIXED):
        return "has a gain of another type than fixed"
    if model.actuator_biastype[i] not in (int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)):
        return "has a bias of another type than affine"
    kind = file.kind(int(model.actuator_trnid[i, 0]))
    if kind == "free" or (kind == "ball" and (side != "joint" or _bias(file, i).any())):
        return f"is not a torque that turns with the second body of a ball joint, but acts on a {kind} joint"
    if kind == "ball" and (model.actuator_armature[i] or model.actuator_damping[i]):
        return "has armature or damping on a ball joint"
    if model.actuator_forcelimited[i] and _bias(file, i)[1:].any():
        return "has a forcerange and a bias that depends on the motion"
    if model.actuator_delay[i] or model.actuator_dampingpoly[i].any():
        return "has a delay or a damping that is not linear"
    return ""


def _bias(file: Any, i: int) -> Any:
    """Constants (3,) of the affine bias: force, by length, by velocity."""
    affine = file.model.actuator_biastype[i] == int(file.mujoco.mjtBias.mjBIAS_AFFINE)
    return file.model.actuator_biasprm[i, :3] * affine


def _add(m: Any, file: Any, i: int, control: Any) -> None:
    """``gear (gain u + b0 + b1 gear qpos + b2 gear qvel)`` on the coordinate, which is ``qpos`` less ``qpos0``."""
    model, j = file.model, int(file.model.actuator_trnid[i, 0])
    name, joint = file.name("actuator", i), file.name("joint", j)
    gear, bias = model.actuator_gear[i], _bias(file, i)
    limits = [
        model.actuator_ctrlrange[i] if model.actuator_ctrllimited[i] and not file.off("clampctrl") else (-np.inf, np.inf),
        model.actuator_forcerange[i] if model.actuator_forcelimited[i] else (-np.inf, np.inf),
    ]
    expect_coordinate(m, file, j)
    if file.kind(j) == "ball":
        law = _law(control, 1.0, model.actuator_gainprm[i, 0], 0.0, limits)
        m.actuator(name, joint, law, axis=file.data.xmat[int(model.jnt_bodyid[j])].reshape(3, 3) @ gear[:3])
        return
    r = float(gear[0])
    start = bias[0] + bias[1] * r * model.qpos0[model.jnt_qposadr[j]]
    m.actuator(
        name,
        joint,
        _law(control, r, model.actuator_gainprm[i, 0], start, limits),
        stiffness=-float(bias[1]) * r * r,
        damping=(float(model.actuator_damping[i]) - float(bias[2])) * r * r,
        armature=float(model.actuator_armature[i]) * r * r,
    )


def _law(control: Any, gear: float, gain: float, start: float, limits: Any) -> Any:
    """Effort over time; of a number that is a parameter."""
    numbers = [float(x) for x in (gear, gain, start, *limits[0], *limits[1])]
    if callable(control):
        return _EffortOf(control, numbers)
    if isinstance(control, bool) or not isinstance(control, Real) or not np.isfinite(float(control)):
        raise ProblemError(f"a control must be a number or a function of time; got {control!r}.")
    return functools.partial(_effort, float(control), *numbers)


def _effort(u: Any, gear: Any, gain: Any, start: Any, low: Any, high: Any, least: Any, most: Any, t: Any) -> Any:
    """Force of the control ``u``, clipped as MuJoCo clips it."""
    return gear * jnp.clip(gain * jnp.clip(u, low, high) + start, least, most) + 0.0 * t


class _EffortOf:
    """Force of a control that is a function of time, or of states and inputs by their names."""

    def __init__(self, control: Any, numbers: list[float]) -> None:
        self._control, self._numbers = control, numbers
        with contextlib.suppress(ValueError):  # a function of C has none, and is one of time
            self.__signature__ = inspect.signature(control)

    def __call__(self, *given: Any) -> Any:
        return _effort(*[self._control(*given), *self._numbers, 0.0])
