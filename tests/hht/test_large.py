"""Systems beyond the size of full matrices: machine code in loops without a full matrix."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench import System, load_problem
from hhtbench.lowering import NotNative, derive, flattening
from hhtbench.lowering.caching import Cache
from hhtbench.lowering.compile import compiling
from hhtbench.lowering.dynamics import matrix_free, products
from problems.planar_chain import PlanarChain
from solvers._projection import Projection
from solvers.hht import HHT
from solvers.hht.run import functions
from solvers.kernel import kkt
from tests.hht.scenes import forget_engines
from tests.sample import slow

CHAIN = "planar_chain(n_links=40)"
BAR = "clamped_bar_impact(n_elements=250)"  # its mass is sparse, and the inverse of that full
LARGE = (
    *(CHAIN, "bead_chain(n_beads=45)", "four_bars(n_windows=20)", "fekete(n_points=42)"),
    *("fput_chain(n_masses=250)", "oscillator_chain(n_masses=250)", BAR),
)


def test_rows_of_a_large_chain_have_the_multipliers_that_are_found_one_by_one(monkeypatch):
    problem = load_problem(CHAIN)
    hht, span = HHT(problem.system), (0.0, 30 * 1e-4)
    many = hht.solve(span, problem.q0, problem.v0, step=1e-4)

    def refuse(*_):
        raise NotNative("none is wanted")

    monkeypatch.setattr(kkt, "kkt_code", refuse)
    monkeypatch.setattr(kkt, "_known", Cache(16))
    forget_engines(monkeypatch)
    one_by_one = HHT(problem.system).solve(span, problem.q0, problem.v0, step=1e-4)
    assert not np.array_equal(many.lam, one_by_one.lam), "the same way was taken"
    np.testing.assert_allclose(many.lam, one_by_one.lam, rtol=0.0, atol=1e-10 * np.abs(one_by_one.lam).max())


def bar_moved(tend, **accuracy):
    problem = load_problem(BAR)
    hht = HHT(problem.system)
    return hht, hht.solve((0.0, tend), problem.q0, problem.v0, t_eval=[0.0, tend], **accuracy)


@pytest.mark.parametrize("accuracy", [slow({"step": 1e-4}), {"rtol": 1e-3}])
def test_a_bar_moves_the_same_by_the_entries_of_its_mass_and_by_full_matrices(accuracy, monkeypatch):
    hht, sparse = bar_moved(2e-3, **accuracy)
    assert "machine code, band matrix" in hht.engine_used
    monkeypatch.setattr(functions, "step_products", lambda *_: None)
    forget_engines(monkeypatch)
    hht, full = bar_moved(2e-3, **accuracy)
    assert "dense matrix" in hht.engine_used
    np.testing.assert_allclose(sparse.steps_data.t, full.steps_data.t, rtol=1e-9, atol=0.0)
    for name in ("q", "v", "lam"):
        expected = getattr(full, name)[-1]
        np.testing.assert_allclose(getattr(sparse, name)[-1], expected, rtol=0.0, atol=1e-9 * np.abs(expected).max())


class Eccentric(PlanarChain):
    """Rods whose centres of mass lie beside their middles, a fifth of a length along: M turns with them."""

    def mass_matrix(self, t, q):
        x, y, turn = (3 * jnp.arange(q.size // 3) + k for k in range(3))
        moment = 0.2 * self.l * self.m
        matrix = jnp.zeros((q.size, q.size)).at[x, x].set(self.m).at[y, y].set(self.m)
        matrix = matrix.at[turn, turn].set(self.m * self.l**2 / 12 + 0.2 * self.l * moment)
        sine, cosine = -moment * jnp.sin(q[2::3]), moment * jnp.cos(q[2::3])
        matrix = matrix.at[x, turn].set(sine).at[turn, x].set(sine)
        return matrix.at[y, turn].set(cosine).at[turn, y].set(cosine)

    def force(self, t, q, v):
        moment, outward = 0.2 * self.l * self.m, jnp.stack([jnp.cos(q[2::3]), jnp.sin(q[2::3])])
        along = moment * v[2::3] ** 2 * outward
        return jnp.stack([along[0], along[1] - self.m * self.g, -moment * self.g * outward[0]], axis=1).ravel()


class Swelling(System):
    """Masses that grow where they move to, each dragging its neighbours along; no constraints."""

    def mass_matrix(self, t, q):
        drag = jnp.full(q.size - 1, 0.1) * (2.0 + jnp.sin(t) + q[1:] * q[:-1])
        return jnp.diag(2.0 + q**2) + jnp.diag(drag, 1) + jnp.diag(drag, -1)

    def force(self, t, q, v):
        return jnp.cos(3.0 * jnp.arange(q.size)) - q - 0.1 * v


def eccentric():
    chain = load_problem("planar_chain(n_links=30)")
    return Eccentric(m=chain.system.m, l=chain.system.l), chain.q0, chain.v0


def swelling(kind=Swelling):
    places = np.sin(np.arange(1.0, 211.0))
    return kind(), places, 0.1 * places[::-1]


def variable_moved(scene, tend, **accuracy):
    system, q0, v0 = scene
    hht = HHT(system)
    return hht, hht.solve((0.0, tend), q0, v0, t_eval=[0.0, tend], **accuracy)


@pytest.mark.parametrize(
    ("make", "tend", "accuracy"),
    [
        (eccentric, 1e-3, {"steps": 5}),
        slow(eccentric, 1e-3, {"rtol": 1e-3}),
        slow(swelling, 0.1, {"steps": 5}),
        slow(swelling, 0.1, {"rtol": 1e-3}),
    ],
)
def test_a_large_system_moves_the_same_by_entries_of_a_variable_mass_and_by_full_matrices(make, tend, accuracy, monkeypatch):
    hht, sparse = variable_moved(make(), tend, **accuracy)
    assert "machine code, band matrix" in hht.engine_used
    monkeypatch.setattr(matrix_free, "entries_at", lambda *_: None)
    monkeypatch.setattr(matrix_free, "_entries", Cache(16))
    forget_engines(monkeypatch)
    hht, full = variable_moved(make(), tend, **accuracy)
    assert "dense matrix" in hht.engine_used
    assert sparse.success and full.success
    assert sparse.counters.steps_accepted == full.counters.steps_accepted
    bound = 1e-11 if "steps" in accuracy else 1e-4
    for name in ("q", "v", "lam"):
        size = np.abs(getattr(full, name)).max(initial=1e-300)
        np.testing.assert_allclose(getattr(sparse, name), getattr(full, name), rtol=0.0, atol=bound * size)


def test_projections_of_a_large_system_make_nothing_anew(monkeypatch):
    """Those of every solve had grown the process by 100 MB in a thousand (row R7 of the acceptance matrix)."""
    monkeypatch.setattr(products, "LARGE", 100)
    chain, kept = load_problem(CHAIN), []
    dynamics = derive(chain.system, chain.t_span[0], chain.q0, chain.v0)
    for _ in range(3):
        Projection(dynamics)
        kept.append([len(cache.values()) for cache in (compiling._callables, flattening._flattened, flattening._jitted)])
    assert kept[0] == kept[1] == kept[2]
