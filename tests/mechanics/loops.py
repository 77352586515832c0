"""Closed loops of files, their gaps at the rows of a solution, and MuJoCo's own:

python -m tests.mechanics.loops [seconds]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import jax
import mujoco
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import Mechanism


def bar(name, pos, length, inside="", joint="", along="x"):
    """A bar along x or z of its body from its hinge."""
    end = f"{length} 0 0" if along == "x" else f"0 0 {length}"
    axis = joint or f'<joint name="{name}" axis="0 1 0"/>'
    return f'<body name="{name} bar" pos="{pos}">{axis}<geom type="capsule" size=".02" fromto="0 0 0 {end}"/>{inside}</body>'


def model(bodies, equality):
    option = "<option timestep='.001' gravity='3 1 -9'/>"
    return f"<mujoco>{option}<worldbody>{bodies}</worldbody><equality>{equality}</equality></mujoco>"


FOUR_BAR = model(
    bar("crank", "0 0 0", 0.4, bar("coupler", "0 0 .4", 1.0, bar("rocker", "1 0 0", -0.7, along="z")), along="z"),
    '<connect name="pin" body1="rocker bar" body2="world" anchor="0 0 -.7"/>',
)
PARALLELOGRAM = model(
    bar("left", "0 0 0", 0.5, bar("beam", "0 0 .5", 0.8), along="z")
    + bar("right", ".8 0 0", 0.5, bar("tip", "0 0 .5", 0.1), along="z"),
    '<weld name="head" body1="beam bar" body2="tip bar"/>',
)
SLIDER_CRANK = model(
    bar("crank", "0 0 0", 0.2, bar("rod", ".2 0 0", 0.6))
    + bar("slider", ".8 0 0", 0.1, joint='<joint name="slider" type="slide" axis="1 0 0"/>'),
    '<connect name="pin" body1="rod bar" body2="slider bar" anchor=".6 0 0"/>',
)
GEARS = model(
    bar("fast", "0 0 0", 0.2) + bar("slow", "0 1 0", 0.5),
    '<joint name="mesh" joint1="fast" joint2="slow" polycoef="0 -2.5 0 0 0"/>',
)


def delta():
    arms, pins = "", ""
    for i in range(3):
        elbow = f'<joint name="ball{i}" type="ball" damping=".01"/>'
        rod = f'<body name="rod{i}" pos=".3 0 0">{elbow}<geom type="capsule" size=".01" fromto="0 0 0 -.25 0 -.6"/></body>'
        beam = '<geom type="capsule" size=".02" fromto="0 0 0 .3 0 0"/>'
        arm = f'<body pos=".2 0 0"><joint name="arm{i}" axis="0 1 0" stiffness="{20 + 10 * i}"/>{beam}{rod}</body>'
        arms += f'<body euler="0 0 {120 * i}">{arm}</body>'
        pins += f'<connect name="pin{i}" body1="rod{i}" body2="plate" anchor="-.25 0 -.6"/>'
    slides = "".join(
        f'<joint name="p{a}" type="slide" axis="{v}"/>' for a, v in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True)
    )
    plate = f'<body name="plate" pos="0 0 -.6">{slides}<geom type="cylinder" size=".25 .01"/></body>'
    return model(arms + plate, pins)


MODELS = {
    "four bar": FOUR_BAR,
    "parallelogram": PARALLELOGRAM,
    "slider crank": SLIDER_CRANK,
    "geared pair": GEARS,
    "delta": delta(),
}


def read(name):
    """The mechanism of a model, and the file."""
    path = Path(tempfile.mkdtemp()) / f"{name}.xml"
    path.write_text(MODELS[name])
    return Mechanism.from_mjcf(path, drop=["contacts"]), path


def gaps(name, seconds, rtol=1e-6):
    """Largest |g| and |G v| at the rows of a solution over ``seconds``, and the solution."""
    m, _ = read(name)
    problem = m.problem((0, seconds))
    found = hb.solve(problem, t_eval=np.linspace(0, seconds, 10 * int(seconds) + 1), rtol=rtol)
    g = jax.jit(jax.vmap(lambda t, q: problem.system.constraint(t, q)))(found.t, found.q)
    rate = jax.jit(jax.vmap(lambda t, q, v: jax.jvp(lambda y: problem.system.constraint(t, y), (q,), (v,))[1]))(
        found.t, found.q, found.v
    )
    return float(np.abs(g).max()), float(np.abs(rate).max()), found


def gap_of_mujoco(name, seconds):
    """Largest residual [m, rad] of the equalities in MuJoCo's own run."""
    _, path = read(name)
    one = mujoco.MjModel.from_xml_path(str(path))
    one.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data, largest = mujoco.MjData(one), 0.0
    while data.time < seconds:
        mujoco.mj_step(one, data)
        largest = max(largest, np.abs(data.efc_pos[: data.ne]).max())
    return largest


if __name__ == "__main__":
    span = float(sys.argv[1]) if len(sys.argv) > 1 else 60.0
    for name in MODELS:
        g, rate, found = gaps(name, span)
        text = f"{name:15} {found.status.label} |g| {g:.1e} |Gv| {rate:.1e}  MuJoCo {gap_of_mujoco(name, span):.1e}"
        sys.stdout.write(text + "\n")
        sys.stdout.flush()
