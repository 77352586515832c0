"""Systems for which the routes of larger systems have no code: functions that cannot be read, dependent rows."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import System
from hhtbench.solution.result import Status
from tests.sample import slow

SOLVERS = ("hht", "ida(form=ggl)", "cvode", "scipy(method=Radau)", "projected")


class Unreadable(System):
    """No sparsity is known of cumlogsumexp; one constraint among 48 coordinates."""

    def force(self, t, q, v):
        return jnp.sin(t) - q + 0.01 * jax.lax.cumlogsumexp(q)

    def constraint(self, t, q):
        return jnp.stack([q[20] - q[30] * (1.0 + 0.1 * q[3])])


class Doubled(System):
    """A chain of 140 masses; its first rod is there twice."""

    def mass_matrix(self, t, q):
        return jnp.eye(q.size)

    def force(self, t, q, v):
        return jnp.tile(jnp.array([0.0, -9.81]), q.size // 2)

    def constraint(self, t, q):
        places = jnp.concatenate([jnp.zeros((1, 2)), q.reshape(-1, 2)])
        rods = places[1:] - places[:-1]
        level = (jnp.sum(rods * rods, axis=1) - 1.0) / 2.0
        return jnp.concatenate([level, level[:1]])


class Once(Doubled):
    """The same without that."""

    def constraint(self, t, q):
        return super().constraint(t, q)[:-1]


PLACES = np.stack([np.arange(1.0, 141.0), np.zeros(140)], axis=1).ravel()
DOUBLED = Problem(name="doubled", system=Doubled(), t_span=(0.0, 0.01), q0=PLACES, v0=np.zeros(280))


@pytest.mark.parametrize("solver", SOLVERS)
def test_functions_whose_sparsity_cannot_be_read_are_solved_with_full_matrices(solver):
    problem = Problem(name="unreadable", system=Unreadable(), t_span=(0.0, 1.0), q0=np.zeros(48), v0=np.zeros(48))
    found = hb.solve(problem, solver, rtol=1e-4, t_eval=np.linspace(0.0, 1.0, 30))
    assert found.success
    assert np.isfinite(found.lam).all()


@pytest.mark.parametrize("solver", [slow("hht"), "cvode", "ida(form=ggl)"])
def test_large_systems_move_without_their_redundant_rows(solver):
    with pytest.warns(UserWarning, match=r"rank 140 of 141 rows; dependent on the others: rows \[140\]"):
        found = hb.solve(DOUBLED, solver, rtol=1e-3)
    assert found.status is Status.success
    once = hb.solve(replace(DOUBLED, system=Once()), solver, rtol=1e-3)
    np.testing.assert_allclose(found.q[-1], once.q[-1], rtol=0.0, atol=1e-7)
    size = np.abs(once.lam[-1]).max()
    np.testing.assert_allclose(found.lam[-1, 140], found.lam[-1, 0], rtol=0.0, atol=1e-12 * size)
    np.testing.assert_allclose(found.lam[-1, 0], once.lam[-1, 0] / 2.0, rtol=0.0, atol=1e-3 * size)


@pytest.mark.parametrize("solver", ["hht", "ida(form=ggl)"])
def test_redundant_rows_of_a_large_system_with_a_declared_reaction_are_named(solver):
    class Own(Doubled):
        def reaction(self, t, q, lam):
            return -jax.vjp(lambda x: self.constraint(t, x), q)[1](lam)[0]

    found = hb.solve(replace(DOUBLED, system=Own()), solver, rtol=1e-3)
    assert found.status is Status.redundant_constraints
    assert "rank 140 of 141 rows; dependent on the others: rows [140]" in found.message
