"""A step from the state in straight lines, for the compiled loops, against the host engine's parts of a step."""

import numpy as np
import pytest
from solvers.hht.native.engine import NativeEngine
from solvers.hht.sparse import BandFactor

import hhtbench as hb
from solvers.hht import HHT
from solvers.hht.equations.corrections import (
    SMALL,
    fresh_correction,
    kept_correction_and_end,
    residual_and_end,
    residual_and_matrix,
    state_size,
)
from solvers.hht.equations.discretise import step_end, step_residual_and_matrix, unpack_matrix
from solvers.hht.linear import InverseFactor

SCENES = {  # constraints on both levels and none, constant and variable masses, linear and nonlinear reactions
    "jay_negrut_pendulum": {"alpha": -0.3},
    "jay_negrut_test1": {"alpha": -0.1, "reaction": "midpoint"},
    "knife_edge": {"alpha": -0.2, "rescale_a": False},
    "andrews": {"alpha": -0.05},
}


def begun(name, steps, **options):
    """An integrator with the native engine, its state after ``steps`` steps and the length of the next one [s]."""
    problem = hb.load_problem(name)
    h = 1e-3 * (problem.t_span[1] - problem.t_span[0])
    hht = HHT(problem.system, engine="native", **options)
    hht.init_step(problem.t_span[0], problem.q0, problem.v0, step=h, lam_guess=problem.lam_guess)
    for _ in range(steps):
        hht.step()
    return hht, hht.state, h


def given_of(state, h, weights):
    """What the straight lines take, written down from what packed_known says of it."""
    inverse = [] if state.inverse_mass is None else [state.inverse_mass.ravel()]
    head = [h, state.t + h, *weights, state.t, state.h or 0.0, state.size_q, state.size_v, 0.0, -1.0]
    vectors = state.q, state.v, state.a, state.f, state.lam, state.mu, state.vdot
    return np.concatenate([head, *vectors, *inverse])


def cases():
    for name, options in SCENES.items():
        for steps, shorter in ((0, 1.0), (3, 1.0), (3, 0.6)):
            yield pytest.param(name, options, steps, shorter, id=f"{name}-{steps}-{shorter}")


@pytest.mark.parametrize(("name", "options", "steps", "shorter"), list(cases()))
def test_known_values_residual_matrix_and_state_are_those_of_the_host_engine(name, options, steps, shorter):
    hht, state, h = begun(name, steps, **options)
    engine = hht._engine
    h, rescaled = shorter * h, steps > 0 and options.get("rescale_a", True)
    weights = (shorter if rescaled else 1.0, 1.0, 0.0)
    given, packed = given_of(state, h, weights), engine._packed(state, h, state.t + h)
    dynamics, layout, size = engine.dynamics, engine.kernel.layout, engine.layout.size
    x = engine._plain_guess(state) * (1 + 0.1 * np.random.default_rng(0).standard_normal(size))
    static = engine.kernel.method, layout
    wanted = np.asarray(step_residual_and_matrix(dynamics, engine.layout, x, packed))
    found = np.asarray(residual_and_matrix(dynamics, *static, x, given))
    np.testing.assert_allclose(found, wanted, rtol=1e-11, atol=1e-12 * np.abs(wanted).max())
    after = np.asarray(residual_and_end(dynamics, *static, x, given))
    np.testing.assert_allclose(after[:size], wanted[:size], rtol=1e-11, atol=1e-12 * np.abs(wanted[:size]).max())
    end, n = np.asarray(step_end(dynamics, engine.layout, x, packed)), layout.structure.n
    q, v, a, f = np.split(after[size : size + 4 * n], 4)
    np.testing.assert_allclose(np.concatenate([q, v]), end[: 2 * n], rtol=1e-13, atol=1e-14)
    np.testing.assert_array_equal(a, x[:n])
    alpha = engine.method.coefficients.alpha
    np.testing.assert_allclose((1 + alpha) * f - alpha * state.f, a, rtol=1e-12, atol=1e-12 * np.abs(a).max())
    unknown, at = layout.split(x), size + 4 * n
    kept = np.concatenate([unknown.get(name, np.zeros(0)) for name in ("lam1", "mu")])
    np.testing.assert_array_equal(after[at : at + kept.size], kept)
    rate = (end[n : 2 * n] - state.v) / h
    np.testing.assert_allclose(after[at + kept.size :][:n], rate, rtol=1e-9, atol=1e-9 * np.abs(rate).max(initial=1.0))
    np.testing.assert_allclose(after[size + state_size(layout) :], end[2 * n :], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", [name for name in SCENES if name != "andrews"])
def test_a_correction_is_that_of_numpys_solver_and_what_is_kept_serves_another_iterate(name):
    hht, state, h = begun(name, 2, **SCENES[name])
    engine = hht._engine
    layout, dynamics, size = engine.kernel.layout, engine.dynamics, engine.layout.size
    assert size <= SMALL
    analysis, static = engine.kernel.analysis, (engine.kernel.method, layout)
    entries = tuple((analysis.flat[analysis.own :] - size * size).tolist())
    given, lots = given_of(state, h, (1.0, 1.0, 0.0)), np.random.default_rng(1)
    x, other = (engine._plain_guess(state) * (1 + 0.05 * lots.standard_normal(size)) for _ in range(2))
    packed, n = engine._packed(state, h, state.t + h), layout.structure.n
    residual, blocks = unpack_matrix(layout, np.asarray(step_residual_and_matrix(dynamics, engine.layout, x, packed)))
    fresh = np.asarray(fresh_correction(dynamics, *static, entries, x, given))
    matrix, maps = blocks[:size], blocks[size:]

    def agrees(found, residual):
        wanted = np.linalg.solve(matrix, residual)
        moved = np.abs(maps @ wanted)
        sizes = [*wanted, moved[:n].max(), moved[n:].max()]
        np.testing.assert_allclose(found, sizes, rtol=1e-8, atol=1e-10 * np.abs(wanted).max())

    agrees(fresh[: size + 2], residual)
    inverse, kept = np.split(fresh[size + 2 :], [size * size])
    np.testing.assert_allclose(inverse.reshape(size, size).T @ matrix, np.eye(size), atol=1e-9)
    later = np.asarray(kept_correction_and_end(dynamics, *static, entries, other, inverse, kept, given))
    both = np.asarray(residual_and_end(dynamics, *static, other, given))
    agrees(later[: size + 2], both[:size])
    np.testing.assert_allclose(later[size + 2 :], both[size:], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(("name", "kind"), [("jay_negrut_pendulum", InverseFactor), ("andrews", BandFactor)])
def test_what_the_loops_keep_of_a_matrix_serves_the_host_engine(name, kind):
    hht, state, h = begun(name, 3, **SCENES[name])
    engine = hht._engine
    assert isinstance(engine, NativeEngine)
    assert isinstance(state.factor, kind)
    hosts = engine.step(state, h, state.t + h).state
    hht.step()
    for name in ("q", "v", "lam"):
        ours, theirs = getattr(hht.state, name), getattr(hosts, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())
    z = engine.kernel.memory({}, 0)
    engine.kernel.load(z, state)
    right = np.random.default_rng(0).standard_normal(engine.layout.size)
    again = engine.kernel.store(z, state).factor
    np.testing.assert_array_equal(again.solve(right), state.factor.solve(right))
    np.testing.assert_array_equal(again.maps.toarray(), state.factor.maps.toarray())
    assert (again.h, again.rate, again.uses) == (state.factor.h, state.factor.rate, state.factor.uses)
