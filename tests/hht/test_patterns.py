"""Declared patterns of large systems: no full matrices for plain callables, nor for functions that cannot be read."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.sparse as sp

import hhtbench as hb
from hhtbench.lowering.caching import Cache
from hhtbench.protocol.system import NumpySystem, System
from problems.planar_chain import PlanarChain, problem, rod_ends
from solvers.hht import HHT
from solvers.hht.run import functions
from tests.hht.scenes import pendulum

LINKS = 32
CHAIN = problem(n_links=LINKS)
LENGTH, MASS = np.asarray(CHAIN.system.l), np.asarray(CHAIN.system.m)
INERTIA = np.stack([MASS, MASS, MASS * LENGTH**2 / 12], axis=1).ravel()
SIZE = 3 * LINKS
NONE = np.zeros((SIZE, SIZE), bool)


def joints(t, q):
    begins, ends = rod_ends(q, LENGTH)
    begins[1:] -= ends[:-1]
    return begins.ravel()


def joints_by_q(t, q):
    arm = LENGTH / 2 * np.array([np.sin(q[2::3]), -np.cos(q[2::3])])
    result, k = np.zeros((2 * LINKS, SIZE)), np.arange(LINKS)
    for axis in range(2):
        result[2 * k + axis, 3 * k + axis], result[2 * k + axis, 3 * k + 2] = 1.0, arm[axis]
        result[2 * k[1:] + axis, 3 * k[:-1] + axis], result[2 * k[1:] + axis, 3 * k[:-1] + 2] = -1.0, arm[axis, :-1]
    return result


WEIGHT = np.outer(-9.81 * MASS, [0.0, 1.0, 0.0]).ravel()
JOINTS = joints_by_q(0.0, np.full(SIZE, 0.7)) != 0.0
PLAIN = {"force": lambda t, q, v: WEIGHT - 0.01 * v, "constraint": joints, "mass_matrix": INERTIA}
PATTERNS = {"force_q": NONE, "force_v": np.eye(SIZE, dtype=bool), "constraint_jacobian": JOINTS}


def turning(t, q):
    """A mass that couples every angle with the place of its rod."""
    k = np.arange(2, SIZE, 3)
    result = np.diag(INERTIA)
    result[k, k - 1] = result[k - 1, k] = 1e-2 * INERTIA[k - 1] * LENGTH * np.cos(q[k])
    return result


COUPLED = np.eye(SIZE, dtype=bool)
COUPLED[np.arange(2, SIZE, 3), np.arange(1, SIZE, 3)] = True
COUPLED |= COUPLED.T
BY_ANGLE = np.zeros((SIZE, SIZE), bool)
for angle in range(2, SIZE, 3):
    BY_ANGLE[[angle - 1, angle], angle] = True
AT_ANGLE = np.eye(SIZE, dtype=bool)[-1:]
SCENES = {
    "differences": ({}, {}),
    "declared Jacobian": ({"constraint_jacobian": joints_by_q}, {}),
    "variable mass": ({"mass_matrix": turning}, {"mass_matrix": COUPLED, "mass_product_jacobian": BY_ANGLE}),
    "redundant rows": (
        {"constraint": lambda t, q: np.append(joints(t, q), joints(t, q)[-1])},
        {"constraint_jacobian": np.concatenate([JOINTS, JOINTS[-1:]])},
    ),
    "velocity constraint": (
        {"velocity_constraint": lambda t, q, v: v[-1:] * (1.0 + 0.1 * q[-1:]) - np.sin(10.0 * t)},
        {"velocity_constraint_jacobian": AT_ANGLE, "velocity_constraint_q": AT_ANGLE},
    ),
}


def moved(system, **accuracy):
    hht, place = HHT(system), (CHAIN.q0, CHAIN.v0)
    return hht, hht.solve((0.0, 2e-3), *place, t_eval=np.linspace(0.0, 2e-3, 7), **accuracy)


@pytest.mark.filterwarnings("ignore:redundant constraints")
@pytest.mark.parametrize(("scene", "accuracy"), [(x, ({"steps": 5}, {"rtol": 1e-4})[i % 2]) for i, x in enumerate(SCENES)])
def test_callables_with_patterns_move_the_same_as_by_full_matrices(scene, accuracy, monkeypatch):
    changed, more = SCENES[scene]
    declared = {**PLAIN, **changed, "sparsity": PATTERNS | more}
    hht, sparse = moved(NumpySystem(**declared), **accuracy)
    assert "machine code, band matrix" in hht.engine_used
    monkeypatch.setattr(functions, "foreign_products", lambda _: None)
    monkeypatch.setattr(functions, "_known", Cache(16))
    hht, full = moved(NumpySystem(**declared), **accuracy)  # another object: nothing is prepared for it
    assert "dense matrix" in hht.engine_used
    assert sparse.success and full.success
    for name, bound in {"q": 1e-10, "v": 1e-7, "lam": 1e-6, "mu": 1e-6}.items():
        size = np.abs(getattr(full, name)).max(initial=1e-300)
        np.testing.assert_allclose(getattr(sparse, name), getattr(full, name), rtol=0.0, atol=bound * size)


def test_a_pattern_that_is_missing_leaves_full_matrices():
    patterns = {name: pattern for name, pattern in PATTERNS.items() if name != "force_v"}
    hht, found = moved(NumpySystem(**PLAIN, sparsity=patterns), steps=1)
    assert found.success
    assert "dense matrix" in hht.engine_used


class Unreadable(PlanarChain):
    """The chain with springs between neighbouring rods' angles by a function whose sparsity nobody reads."""

    @property
    def sparsity(self):
        angles = np.zeros((SIZE, SIZE), bool)
        for k in range(2, SIZE, 6):
            angles[k, k] = angles[k + 3, k] = angles[k + 3, k + 3] = True
        return {"force_q": angles, "force_v": NONE}

    def force(self, t, q, v):
        pairs = jax.lax.cumlogsumexp(q[2::3].reshape(-1, 2), axis=1).ravel()
        return super().force(t, q, v).at[2::3].add(-1e-4 * pairs)


class Undeclared(Unreadable):
    sparsity = None


def chain(kind):
    return kind(m=CHAIN.system.m, l=CHAIN.system.l)


def test_a_declared_pattern_serves_where_none_can_be_read():
    hht, sparse = moved(chain(Unreadable), steps=3)
    assert "band matrix" in hht.engine_used
    hht, full = moved(chain(Undeclared), steps=3)
    assert "dense matrix" in hht.engine_used
    np.testing.assert_allclose(sparse.q, full.q, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(sparse.lam, full.lam, rtol=0.0, atol=1e-9 * np.abs(full.lam).max())


class Misnamed(System):
    sparsity = {"force": np.eye(2)}  # noqa: RUF012

    def force(self, t, q, v):
        return -q


class Misshapen(Misnamed):
    sparsity = {"force_q": np.eye(3)}  # noqa: RUF012


@pytest.mark.parametrize(("kind", "text"), [(Misnamed, "force_q"), (Misshapen, r"\(2, 2\)")])
def test_a_pattern_of_the_wrong_name_or_shape_is_refused(kind, text):
    with pytest.raises(hb.ProblemError, match=text):
        HHT(kind()).solve((0.0, 1.0), jnp.ones(2), jnp.zeros(2), steps=1)


def patterned(patterns):
    """A point on a circle as a JAX system that declares ``patterns``."""

    class Patterned(hb.System):
        sparsity = patterns

        def force(self, t, q, v):
            return jnp.array([0.0, -9.81])

        def constraint(self, t, q):
            return (q @ q - 1)[None] / 2

    return Patterned()


@pytest.mark.parametrize("kind", [sp.csr_matrix, sp.coo_array])
def test_a_pattern_may_be_one_of_scipys_matrices_for_jax_systems_too(kind):
    full, empty = kind(np.ones((1, 2), bool)), kind(np.zeros((2, 2), bool))
    plain = HHT(pendulum()).solve((0, 1), [0.6, -0.8], [0, 0], steps=20)
    system = patterned({"constraint_jacobian": full, "force_q": empty})
    np.testing.assert_allclose(HHT(system).solve((0, 1), [0.6, -0.8], [0, 0], steps=20).q, plain.q, atol=1e-9)
    with pytest.raises(hb.ProblemError, match=r"constraint_jacobian.*rows \[0\]"):
        HHT(patterned({"constraint_jacobian": kind([[True, False]])})).solve((0, 1), [0.6, -0.8], [0, 0], steps=10)


def test_patterns_that_are_no_mapping_are_refused_for_jax_systems_too():
    with pytest.raises(TypeError, match="sparsity must map names"):
        HHT(patterned(5)).solve((0, 1), [0.6, -0.8], [0, 0], steps=10)
