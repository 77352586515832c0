"""Velocity constraints hold no position: large systems with constraints of both kinds are moved as small ones are."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering import derive
from hhtbench.lowering.caching import Cache
from solvers._projection import OneByOne
from solvers.hht.run.projecting import smallest_changes
from solvers.kernel import kkt
from solvers.kernel.full import of_full_matrices
from solvers.kernel.memory import copied
from solvers.kernel.projection import project
from tests.sample import slow


class Circles(hb.System):
    """Points on circles whose height is z = sin t, which a velocity constraint says together with what holds already."""

    share: object = hb.parameter(0.1)

    def force(self, t, q, v):
        return jnp.zeros_like(q.reshape(-1, 3)).at[:, 1].set(-9.81).ravel()

    def constraint(self, t, q):
        x = q.reshape(-1, 3)
        return x[:, 0] ** 2 + x[:, 1] ** 2 - 1

    def velocity_constraint(self, t, q, v):
        x, u = q.reshape(-1, 3), v.reshape(-1, 3)
        return x[:, 0] * u[:, 0] + x[:, 1] * u[:, 1] + self.share * (u[:, 2] - jnp.cos(t))


@pytest.mark.parametrize("count", [2, 9])
def test_heights_of_few_and_of_many_points_are_as_right(count):
    angle = np.linspace(0.3, 1.0, count)
    q0 = np.column_stack([np.sin(angle), -np.cos(angle), 0 * angle]).ravel()
    v0 = np.tile([0.0, 0.0, 1.0], count)
    circles = hb.Problem(name="circles", system=Circles(), t_span=(0.0, 2.0), q0=q0, v0=v0)
    found = hb.solve(circles, "projected", rtol=1e-3, t_eval=np.linspace(0.0, 2.0, 21))
    assert found.success
    np.testing.assert_allclose(found.q[:, 2::3], np.sin(found.t)[:, None] * np.ones(count), atol=1e-9)


COUNT = 16  # points, so that a mass that varies is taken by its entries: 64 unknowns and more
BAND = np.eye(3 * COUNT) + 0.2 * (np.eye(3 * COUNT, k=1) + np.eye(3 * COUNT, k=-1))
MASSES = {
    "full": np.eye(3 * COUNT) + 0.01,
    "diagonal": np.diag(np.linspace(0.5, 2.0, 3 * COUNT)),
    "sparse": BAND,
    "variable": lambda self, t, q: jnp.asarray(BAND) * (1.0 + 0.1 * jnp.cos(q[:, None] + q)),
}


def on_spheres(self, t, q):
    x = q.reshape(-1, 3)
    return (x**2).sum(axis=1) - 1 + 0.1 * x[:, 2] * jnp.roll(x[:, 1], 1)


def geared(self, t, q, v):
    x, u = q.reshape(-1, 3), v.reshape(-1, 3)
    return u[:, 2] - (1.0 + 0.3 * x[:, 0]) * u[:, 1] - 0.2 * jnp.cos(t) * jnp.roll(u[:, 0], 1)


def across(self, t, q, lam):
    return -jax.vjp(lambda x: self.constraint(t, x), q)[1](lam)[0] - 0.1 * jnp.repeat(lam, 3)


def velocity_across(self, t, q, v, mu):
    return -jax.vjp(lambda u: self.velocity_constraint(t, q, u), v)[1](mu)[0] - 0.1 * jnp.repeat(mu, 3)


def points(kinds, reaction, mass):
    """The dynamics of points with constraints of ``kinds``, "m" on the position and "p" on the velocity level."""
    functions = {"force": lambda self, t, q, v: -q, "mass_matrix": MASSES[mass]}
    if "m" in kinds:
        functions |= {"constraint": on_spheres} | ({"reaction": across} if reaction == "declared" else {})
    if "p" in kinds:
        functions |= {"velocity_constraint": geared}
        functions |= {"velocity_reaction": velocity_across} if reaction == "declared" else {}
    draw = np.random.default_rng(0)
    q = draw.normal(size=(COUNT, 3))
    q /= np.linalg.norm(q, axis=1)[:, None]
    return derive(type("Points", (hb.System,), functions)(), 0.0, q.ravel(), draw.normal(size=3 * COUNT)), q.ravel()


def moved_by(places, rows, sizes):
    found, done = rows.copy(), np.zeros(len(rows), dtype=bool)
    project.following(copied(places.memory), places.mass.copy(), sizes)(found, done)
    assert done.all()
    return found


def moved_one_by_one(dynamics, rows, sizes):
    t, (q, v) = rows[:, 0].copy(), np.split(rows[:, 1:].copy(), 2, axis=1)
    assert not OneByOne(dynamics).project_all(t, q, v, sizes).times
    return np.column_stack([t, q, v])


WAYS = [
    (kinds, reaction, mass, "auto") for kinds in ("m", "p", "mp") for reaction in ("plain", "declared") for mass in MASSES
]
WAYS += [(kinds, "plain", "variable", algebra) for kinds in ("m", "p", "mp") for algebra in ("dense", "band")]
WAYS += [("mp", "declared", mass, algebra) for mass in ("diagonal", "sparse") for algebra in ("dense", "band")]


@pytest.mark.parametrize(("kinds", "reaction", "mass", "algebra"), [slow(*x) if i % 3 else x for i, x in enumerate(WAYS)])
def test_a_state_is_moved_to_the_same_place_by_every_way(kinds, reaction, mass, algebra, monkeypatch):
    """By the entries of the KKT matrix, by full matrices, and in Python one after the other; to the square of a move."""
    if algebra != "auto":
        chosen = kkt.chosen
        monkeypatch.setattr(kkt, "chosen", lambda found, _, measured: chosen(found, algebra, measured=measured))
        monkeypatch.setattr(kkt, "_known", Cache(1))
    dynamics, q = points(kinds, reaction, mass)
    sizes, draw = np.ones(6 * COUNT), np.random.default_rng(1)
    near = np.concatenate([[0.3], q, np.zeros(3 * COUNT)])[None]
    held = moved_one_by_one(dynamics, near, sizes)
    off = held + 1e-4 * np.pad(draw.normal(size=(3, 6 * COUNT)), ((0, 0), (1, 0)))
    expected = moved_one_by_one(dynamics, off, sizes)
    entries, full = smallest_changes(dynamics), of_full_matrices(dynamics)
    assert (entries.mass.size == 0) == (mass != "full"), "the same way was taken"
    assert np.abs(expected - off).max() > 1e-5
    for places in (entries, full):
        np.testing.assert_allclose(moved_by(places, off, sizes), expected, rtol=0.0, atol=1e-6)


def test_a_pattern_that_holds_at_the_start_alone_is_refused():
    def force(t, q, v):
        return -q + np.roll(q * (q - 1.0), 1)  # no coupling has a slope of zero but where q is a half

    q0, n = np.full(4, 0.5), 4
    system = hb.NumpySystem(
        force=force, sparsity={"force_q": np.eye(n, dtype=bool), "force_v": np.zeros((n, n), dtype=bool)}
    )
    frozen = hb.Problem(name="frozen", system=system, t_span=(0.0, 1.0), q0=q0, v0=np.zeros(n))
    with pytest.raises(hb.ProblemError, match="sparsity\\['force_q'\\] lacks entries"):
        hb.solve(frozen, "hht", steps=10)
