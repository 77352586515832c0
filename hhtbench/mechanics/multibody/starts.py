"""Checks of the pose and the velocities in which a mechanism starts."""

from __future__ import annotations

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.mechanics.multibody.motion import moves
from hhtbench.mechanics.multibody.rows import of_time
from hhtbench.protocol.errors import ProblemError
from hhtbench.runtime.disk_cache import use_disk_cache

STARTED = 1e-6  # misfit of a motor's start, over its value, which assemble would have removed


def slides(m: Any, name: str) -> int:
    """1 if a joint is prismatic or a motor prescribes its travel, else 0."""
    joint = m.joints[name]
    return int(joint.kind == "prismatic" or (joint.kind == "motor" and joint.rows[0][0] == "slide"))


def expect_signs(m: Any) -> None:
    """Raise if the axis of a joint is reversed: its rows hold there too."""
    for joint in () if m.plane else m.joints.values():
        e = [m.pose(body)[1] @ frame for body, frame in zip((joint.first, joint.second), joint.frames, strict=True)]
        axes = [2] if joint.kind in ("revolute", "cylindrical", "prismatic", "planar") else []
        axes += [0, 1, 2] if joint.kind in ("weld", "prismatic") else []
        if any(e[0][:, i] @ e[1][:, i] < 0.0 for i in axes):
            raise ProblemError(f"joint {joint.name!r} has its axis reversed. Give a better pose.")


def expect_motors(m: Any, t: float) -> None:
    """Raise if the bodies are not where motors prescribe at time ``t``, or do not move so."""
    motors = {name: joint for name, joint in m.joints.items() if joint.kind == "motor"}
    if not motors:
        return
    use_disk_cache()
    now = [x[0, [list(m.joints).index(name) for name in motors]] for x in moves(m, *m.start())]
    angle, travel, turning, speed = ([float(x) for x in np.atleast_1d(row)] for row in now)
    for i, (name, joint) in enumerate(motors.items()):
        row = m.rows[joint.rows[0][0]][joint.rows[0][1]]
        value, rate = (float(x) for x in _law_and_rate(of_time(row.law), t))
        sliding, unit = slides(m, name), "m" if slides(m, name) else "rad"
        here, moving = (travel[i], speed[i]) if sliding else (angle[i], turning[i])
        if joint.rows[0][0] == "speed":
            rate = value
        else:
            off = value - here if sliding or m.plane else math.remainder(value - here, 2 * math.pi)
            _expect_close(name, off, value, here, unit, t)
        _expect_close(name, rate - moving, rate, moving, f"{unit}/s", t)


def _expect_close(name: str, off: float, value: float, here: float, unit: str, t: float) -> None:
    if abs(off) > STARTED * max(1.0, abs(value)):
        raise ProblemError(
            f"motor {name!r} prescribes {value:.6g} {unit} at {t:g} s, the bodies are at {here:.6g} {unit}: call "
            f"m.assemble({f't={t:g}' if t else ''}), which sets positions and rates."
        )


@eqx.filter_jit
def _law_and_rate(law: Any, t: Any) -> Any:
    return jax.jvp(law, (jnp.asarray(t, float),), (jnp.ones(()),))
