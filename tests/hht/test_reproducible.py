"""Saving, copying and threads leave every bit where it was (rows R3 to R5 of the acceptance matrix)."""

import ast

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol import System, parameter
from hhtbench.result import Status
from solvers.hht import HHT
from solvers.hht.sources import SOURCES
from tests.hht.scenes import GRAVITY, JAX_PENDULUM, Q0, SYSTEMS, V0, gravity, pendulum
from tests.hht.test_jacobians import STIFFNESS, stiff_force


def wrong_jacobians(t, q, v):
    return STIFFNESS, np.zeros((2, 2))


class Shadow(System):
    """A pendulum and a coordinate without mass that follows it; its row of g_q changes its size along the motion."""

    mass_matrix: object = parameter((1.0, 1.0, 0.0))

    def force(self, t, q, v):
        return jnp.stack([0.0 * t, -GRAVITY + 0.0 * t, 0.0 * t])

    def constraint(self, t, q):
        return jnp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2.0, q[2] - 3.0 * q[0] ** 2])


class Bead(System):
    """A particle on a turning ring, with a mass that depends on the place and a force that depends on time."""

    def mass_matrix(self, t, q):
        return jnp.eye(2) * (1.0 + 0.1 * q[0] ** 2)

    def force(self, t, q, v):
        return jnp.stack([jnp.sin(3.0 * t), -GRAVITY * (1.0 + 0.1 * q[0] ** 2)])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0])


STEPPED = {
    "numpy": (SYSTEMS["numpy"], Q0, V0),
    "jax": (JAX_PENDULUM, Q0, V0),
    "variable mass": (Bead(), Q0, V0),
    "singular mass": (Shadow(), [*Q0, 3.0 * Q0[0] ** 2], [*V0, 6.0 * Q0[0] * V0[0]]),
    "wrong jacobian": (pendulum(force=stiff_force, force_jacobians=wrong_jacobians), Q0, V0),
}


def bits(state):
    return [np.asarray(x).tobytes() for x in (state.t, state.q, state.v, state.a, state.f, state.lam, state.mu, state.vdot)]


def test_stepping_by_hand_and_solving_give_the_same_bits():
    hht = HHT(JAX_PENDULUM, alpha=-0.3)
    solution = hht.solve((0.0, 0.25), Q0, V0, steps=16)  # 1/64: the times are exact
    assert hht.init_step(0.0, Q0, V0, step=1 / 64) is Status.success
    for k in range(1, 17):
        assert hht.step() is Status.success
        assert hht.state.t == solution.t[k]
        assert hht.state.q.tobytes() == solution.q[k].tobytes()
        assert hht.state.v.tobytes() == solution.v[k].tobytes()


def test_a_callback_that_uses_its_own_solver_is_refused():
    holder = []

    def force(t, q, v):
        holder[0].solve((0.0, 0.1), Q0, V0, step=0.01)
        return gravity(t, q, v)

    holder.append(HHT(pendulum(force=force)))
    with pytest.raises(RuntimeError, match="already solving"):
        holder[0].solve((0.0, 0.1), Q0, V0, step=0.01)


def test_what_is_compiled_squares_by_products():
    """``x ** 2`` is a product in machine code and a call of pow in Python, which rounds otherwise once in a thousand."""
    files = [file for source in SOURCES for file in (sorted(source.glob("*.py")) if source.is_dir() else [source])]
    nodes = [(file.name, node) for file in files for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))]
    assert len(files) > 10
    whole = lambda node: isinstance(node, ast.Constant) and isinstance(node.value, int)  # noqa: E731
    powers = [
        (name, node.lineno)
        for name, node in nodes
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) and whole(node.right)
    ]
    assert powers == []
