"""Chains of rods and beads and the stiff pendulum against minimal coordinates and statics."""

import functools
import math
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from problems._minimal import (
    bead_chain,
    four_bars,
    planar_chain,
    second_along,
    slider_crank,
    stiff_spring_pendulum,
)
from tests.problems.cases import CHANGED
from tests.problems.mechanics import measured

SPRING = CHANGED["stiff_spring_pendulum"]
CRANK = CHANGED["slider_crank_equal_lengths"]

CASES = [  # problem, its parameters, the same in minimal coordinates, a state s
    ("planar_chain", {"n_links": 4, "m": 2.0, "L": 3.0, "g": 5.0}, planar_chain(4, 2.0, 3.0, 5.0), (0.4, -1.0, 2.0, 0.1)),
    (
        "bead_chain",
        {"n_beads": 3, "m": 2.0, "L": 1.5, "g": 4.0, "w": -0.7},
        bead_chain(3, 2.0, 1.5, 4.0),
        (0.4, -1.0, 0.2, 1.3, -0.2, 2.5),
    ),
    ("stiff_spring_pendulum", SPRING, stiff_spring_pendulum(50.0, [2.0, 3.0], [0.5, 0.7], 4.0), (-0.4, 0.9, 0.8)),
    (
        "stiff_spring_pendulum",
        {**SPRING, "stiffness": math.inf},
        stiff_spring_pendulum(math.inf, [2.0, 3.0], [0.5, 0.7], 4.0),
        (-0.4, 0.9),
    ),
    ("slider_crank_equal_lengths", CRANK, slider_crank(2.0, 0.3, 0.6, 4.0), (0.8,)),
    ("four_bars", {"n_windows": 3, "m": 2.0, "l": 0.5, "g": 4.0, "speed": 0.8}, four_bars(3, 2.0, 0.5, 4.0), (-2.0,)),
]


cases = pytest.mark.parametrize(("name", "parameters", "minimal", "s"), CASES)


@functools.cache
def moving_state(minimal, s):
    """A state on the constraints, with random velocities, and its accelerations: (q, v, vdot)."""

    @jax.jit
    def state(s, u):
        q, v = jax.jvp(minimal.embed, (s,), (u,))
        vdot = jax.jvp(minimal.embed, (s,), (minimal.accelerations(s, u),))[1] + second_along(minimal.embed, s, u)
        return q, v, vdot

    return state(jnp.asarray(s), jnp.asarray(np.random.default_rng(7).standard_normal(len(s))))


@cases
def test_accelerations_are_those_of_mass_points_in_minimal_coordinates(make, name, parameters, minimal, s):
    q, v, expected = moving_state(minimal, s)
    found, _, position, velocity, _ = measured(make(name, **parameters).system)(q, v)
    for rows in (position, velocity):
        np.testing.assert_allclose(rows, 0.0, atol=1e-14 * (1 + np.abs(q).max() + np.abs(v).max()))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())


@pytest.mark.parametrize(("name", "size"), [("planar_chain", "n_links"), ("bead_chain", "n_beads")])
@pytest.mark.parametrize("n", [4, 10_000])
def test_chain_of_any_length_starts_consistent_and_is_tagged_large_where_it_is(make, name, size, n):
    problem = make(name, **{size: n})
    levels = jax.jit(lambda q, v: jax.jvp(lambda x: problem.system.constraint(0.0, x), (q,), (v,)))
    for rows in levels(problem.q0, problem.v0):
        np.testing.assert_allclose(rows, 0.0, rtol=0, atol=2e-15 * (1 + np.abs(problem.v0).max()))
    assert ("large" in problem.tags) == (problem.q0.size >= 300)
    sketch = pickle.loads(pickle.dumps(problem.sketch))
    assert len(sketch(problem.q0)["lines"]) >= n


def sizes(jaxpr):
    for equation in jaxpr.eqns:
        yield from (variable.aval.size for variable in equation.outvars)
        for inner in jax.tree.leaves(list(equation.params.values()), is_leaf=lambda x: hasattr(x, "eqns")):
            yield from sizes(inner.jaxpr if hasattr(inner, "jaxpr") else inner) if hasattr(inner, "eqns") else ()


@pytest.mark.parametrize(
    ("name", "size"), [("planar_chain", "n_links"), ("bead_chain", "n_beads"), ("four_bars", "n_windows")]
)
def test_work_and_memory_of_a_chain_grow_with_its_length_alone(make, name, size):
    """No (n, n) array in any function, and no longer program for more bodies (no loop over bodies)."""
    programs = []
    for n in (50, 2000):
        problem = make(name, **{size: n})
        system, q, v = problem.system, problem.q0, problem.v0
        jaxprs = [jax.make_jaxpr(f)(0.0, q, v).jaxpr for f in (system.force, system.energy)]
        jaxprs.append(jax.make_jaxpr(system.constraint)(0.0, q).jaxpr)
        programs.append([sum(1 for _ in sizes(jaxpr)) for jaxpr in jaxprs])
        assert max(max(sizes(jaxpr)) for jaxpr in jaxprs) <= 2 * q.size
        assert system.mass_matrix.shape == (q.size,)
    assert programs[0] == programs[1]


def test_hanging_chain_carries_at_each_joint_what_hangs_below(make):
    """Statics: joint i of N rods holds (N - i + 1) / N of the weight, pulling what is before it down."""
    below, rest = 2.0 * 9.81 * np.array([1.0, 0.75, 0.5, 0.25]), np.zeros(12)
    q = jax.jit(planar_chain(4, 2.0, 1.0, 9.81).embed)(np.full(4, -math.pi / 2))
    vdot, lam, *_ = measured(make("planar_chain", n_links=4, m=2.0).system)(q, rest)
    np.testing.assert_allclose(vdot, 0.0, atol=1e-12)
    np.testing.assert_allclose(lam.reshape(-1, 2), np.column_stack([0 * below, -below]), atol=1e-12)
    q = jax.jit(bead_chain(4, 2.0, 1.0, 9.81).embed)(np.repeat([-math.pi / 2, 0.0], 4))
    np.testing.assert_allclose(measured(make("bead_chain", n_beads=4, m=2.0).system)(q, rest)[1] * 0.25, below, rtol=1e-13)


@pytest.mark.parametrize("stiffness", [1e2, 1e12, math.inf, "inf"])
def test_stiff_pendulum_hangs_at_rest_where_the_spring_carries_both_weights(make, stiffness):
    """Statics: stretch (m1 + m2) g / k, rod tension m2 g; in the limit the first multiplier takes the spring's place."""
    problem = make("stiff_spring_pendulum", stiffness=stiffness, m2=3.0)
    first = 1 + 4 * 9.81 / float(stiffness)
    vdot, lam, *_ = measured(problem.system)(np.array([0.0, -first, 0.0, -first - 1]), np.zeros(4))
    np.testing.assert_allclose(vdot, 0.0, atol=1e-11 + 1e-15 * min(float(stiffness), 1e12))
    if float(stiffness) < math.inf:
        assert "stiff" in problem.tags
        np.testing.assert_allclose(lam, [3 * 9.81], rtol=1e-4)
    else:
        np.testing.assert_allclose(lam, [4 * 9.81, 3 * 9.81], rtol=1e-14)


@pytest.mark.parametrize(
    "name", ["planar_chain", "stiff_spring_pendulum", "bead_chain", "four_bars", "slider_crank_equal_lengths"]
)
def test_observed_velocity_is_the_rate_of_what_is_observed(make, name):
    problem = make(name)
    q = problem.q0 + 0.1 * np.random.default_rng(1).standard_normal(problem.q0.size)
    v = np.random.default_rng(2).standard_normal(q.size)
    seen = {key: lambda h, f=f: np.asarray(f(0.0, q + h * v, v, None)) for key, f in problem.observables.items()}
    rates = {key: (f(1e-5) - f(-1e-5)) / 2e-5 for key, f in seen.items()}
    if name in ("planar_chain", "stiff_spring_pendulum"):
        np.testing.assert_allclose(rates["tip"][:2], seen["tip"](0.0)[2:], rtol=1e-8)
    elif name == "bead_chain":
        np.testing.assert_allclose(rates["tip"], seen["tip_velocity"](0.0), rtol=1e-8)
    else:
        np.testing.assert_allclose(rates["crank_angle"], seen["crank_rate"](0.0), rtol=1e-8)
