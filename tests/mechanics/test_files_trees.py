"""Accelerations of trees from files equal MuJoCo's, which has joint coordinates."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from hhtbench.mechanics import Mechanism
from hhtbench.mechanics.multibody.files import File, place
from tests.mechanics.trees import TREES
from tests.sample import slow

STATES = 100
PARTS = (  # what other trees have, too
    *("two hinges, full inertia, springref and ref", "cart and pole", "ball joints"),
    *("two slides and a hinge on one body", "hinge and slide, fused body, cylinder"),
)


def accelerations(system):
    """Of the equations ``M a + G^T lam = F``, ``G a = -(G v)' v``; rows of full rank, as trees have them."""

    @jax.jit
    def solved(q, v):
        G = jax.jacfwd(lambda y: system.constraint(0.0, y))
        moving = jax.jvp(lambda y: G(y) @ v, (q,), (v,))[1]
        M, J = system.mass_matrix(0.0, q), G(q)
        matrix = jnp.block([[M, J.T], [J, jnp.zeros((len(J), len(J)))]])
        a = jnp.linalg.solve(matrix, jnp.concatenate([system.force(0.0, q, v), -moving]))[: len(q)]
        return a, system.constraint(0.0, q), J @ v

    return solved


def moved(model, data, random):
    """A random state; the middle one of three hinges within a quarter of a turn, springs within half a turn."""
    data.qpos[:] = model.qpos0
    data.qvel[:] = random.uniform(-1.2, 1.2, model.nv)
    mujoco.mj_integratePos(model, data.qpos, data.qvel, 1.0)
    data.qvel[:] = random.normal(size=model.nv)


def of_centre(model, data, i, point):
    """Acceleration of MuJoCo at the centre of mass ``point`` (3,) of a body and its angular acceleration."""
    J, turning = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    dot, dot_turning = np.zeros_like(J), np.zeros_like(J)
    mujoco.mj_jac(model, data, J, turning, point, i)
    mujoco.mj_jacDot(model, data, dot, dot_turning, point, i)
    return J @ data.qacc + dot @ data.qvel, turning @ data.qacc + dot_turning @ data.qvel


def worst(m, model, controls):
    """Largest relative difference of accelerations at random states, and the largest residuals of rows."""
    file, system, random = File(mujoco, model), m.system(), np.random.default_rng(5)
    for i, value in enumerate(controls.values()):
        file.data.ctrl[i] = value
    solved, data, gap, rows = accelerations(system), mujoco.MjData(model), 0.0, 0.0
    data.ctrl[:] = list(controls.values())
    bodies = [i for i in range(1, model.nbody) if model.body_weldid[i] == i]
    for _ in range(STATES):
        moved(model, data, random)
        mujoco.mj_forward(model, data)
        place(m, file, data)
        q, v = m.start()
        a, g, gv = (np.asarray(x) for x in solved(q, v))
        rates = np.asarray(m.frame.rates(jnp.asarray(q), jnp.asarray(a)))  # R w' = 2 E p'' as E(p') p' = 0
        theirs = [of_centre(model, data, i, m.bodies[file.body(i)].x) for i in bodies]
        size = max(np.abs(theirs).max(), 1.0)
        for k, (linear, turning) in enumerate(theirs):
            gap = max(gap, np.abs(a[7 * k : 7 * k + 3] - linear).max() / size, np.abs(rates[k] - turning).max() / size)
        rows = max(rows, np.abs(g).max(), np.abs(gv).max())
    return gap, rows


@pytest.mark.parametrize("tree", [slow(x) if x in PARTS else x for x in TREES])
def test_accelerations_equal_those_of_mujoco(tree, tmp_path):
    text, controls = TREES[tree]
    path = tmp_path / "tree.xml"
    path.write_text(text)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    read = Mechanism.from_urdf if "<robot" in text else Mechanism.from_mjcf
    m = read(path, drop=["contacts", "limits"], **({} if "<robot" in text else {"controls": controls}))
    gap, rows = worst(m, model, controls)
    assert rows < 1e-12
    assert gap < 1e-9
