"""A step from the state in straight lines, as the loops take it, against the equations of a step with known values."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from solvers.hht import HHT
from solvers.hht.equations.corrections import (
    SMALL,
    fresh_correction,
    lagged_correction_and_end,
    residual_and_end,
    state_size,
)
from solvers.hht.equations.discretise import residual_and_matrix, stages, step_residual_and_matrix, unpack_matrix
from solvers.hht.equations.known import weighted
from solvers.hht.run.functions import layout_of
from tests.lowering.xla import values

SCENES = {  # constraints on both levels and none, constant and variable masses, linear and nonlinear reactions
    "jay_negrut_pendulum": {"alpha": -0.3},
    "jay_negrut_test1": {"alpha": -0.1, "reaction": "midpoint"},
    "knife_edge": {"alpha": -0.2, "rescale_a": False},
    "andrews": {"alpha": -0.05},
}


def begun(name, steps, **options):
    """An integrator, its state after ``steps`` steps and the length of the next one [s]."""
    problem = hb.load_problem(name)
    h = 1e-3 * (problem.t_span[1] - problem.t_span[0])
    hht = HHT(problem.system, **options)
    hht.init_step(problem.t_span[0], problem.q0, problem.v0, step=h, lam_guess=problem.lam_guess)
    for _ in range(steps):
        hht.step()
    return hht, hht.state, h


def given_of(state, h, weights):
    """What the straight lines take, written down from what start_of says of it."""
    inverse = [] if state.inverse_mass is None else [state.inverse_mass.ravel()]
    head = [h, state.t + h, *weights, state.t, state.h or 0.0, state.size_q, state.size_v, 0.0, -1.0]
    vectors = state.q, state.v, state.a, state.f, state.lam, state.mu, state.vdot
    return np.concatenate([head, *vectors, *inverse])


def known_of(hht, state, h, a0):
    """The known values of the step, from the state by name; no reaction here needs a mass elsewhere."""
    dynamics, method = hht._engine.dynamics, hht._engine.functions.method
    layout, start = layout_of(dynamics, method), {"t": state.t, "h": h, "t1": state.t + h, "from_end": 0.0, "a0": a0}
    start |= {name: getattr(state, name) for name in ("q", "v", "f", "inverse_mass")}
    return layout, weighted(method, layout, None, start)


def end_of(place):
    """Of the step, in one row."""
    parts = place.q1, place.v1, place.start_reaction, place.end_reaction
    return jnp.concatenate([part for part in parts if part is not None])


def near(state, size, spread):
    """Unknowns like those of the last step (size,), or of the size of one."""
    lots = np.random.default_rng(0).standard_normal(size)
    return lots if state.unknowns is None else state.unknowns * (1 + spread * lots)


def constraint_rows(layout, residual):
    """``residual`` without the rows of forces and reactions."""
    rows = layout.split(residual)
    return np.concatenate([rows[name] if name in ("lam0", "lam1", "mu") else 0 * rows[name] for name in rows])


def cases():
    for name, options in SCENES.items():
        for steps, shorter in ((0, 1.0), (3, 1.0), (3, 0.6)):
            yield pytest.param(name, options, steps, shorter, id=f"{name}-{steps}-{shorter}")


@pytest.mark.parametrize(("name", "options", "steps", "shorter"), list(cases()))
def test_known_values_residual_matrix_and_state_are_those_of_the_equations(name, options, steps, shorter):
    hht, state, h = begun(name, steps, **options)
    engine = hht._engine
    h, rescaled = shorter * h, steps > 0 and options.get("rescale_a", True)
    weights = (shorter if rescaled else 1.0, 1.0, 0.0)
    a0 = state.f + shorter * (state.a - state.f) if rescaled else state.a  # (H11)
    plain, known = known_of(hht, state, h, a0)
    given, dynamics, layout = given_of(state, h, weights), engine.dynamics, engine.layout
    size, n = layout.size, layout.structure.n
    x, static = near(state, size, 0.1), (engine.functions.method, layout)
    functions = (
        lambda x, known, given: residual_and_matrix(dynamics, plain, x, known),
        lambda x, known, given: step_residual_and_matrix(dynamics, *static, x, given),
        lambda x, known, given: residual_and_end(dynamics, *static, x, given),
        lambda x, known, given: end_of(stages(dynamics, plain, plain.split(x), known)),
    )
    wanted, found, after, end = (np.asarray(value) for value in values(functions, x, known, given))
    np.testing.assert_allclose(found, wanted, rtol=1e-11, atol=1e-12 * np.abs(wanted).max())
    np.testing.assert_allclose(after[:size], wanted[:size], rtol=1e-11, atol=1e-12 * np.abs(wanted[:size]).max())
    np.testing.assert_array_equal(after[size : 2 * size], constraint_rows(layout, after[:size]))
    after = np.delete(after, np.s_[size : 2 * size])
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
    reactions = end[2 * n : 4 * n] if layout.structure.m else np.zeros(0)
    np.testing.assert_allclose(after[at + kept.size + n :], reactions, rtol=1e-12, atol=1e-12)
    assert after.size == size + state_size(layout)


@pytest.mark.parametrize("name", [name for name in SCENES if name != "andrews"])
def test_a_correction_is_that_of_numpys_solver_and_what_is_kept_serves_another_iterate(name):
    hht, state, h = begun(name, 2, **SCENES[name])
    engine = hht._engine
    layout, dynamics, size = engine.layout, engine.dynamics, engine.layout.size
    assert size <= SMALL
    analysis, static = engine.functions.analysis, (engine.functions.method, layout)
    flat = (analysis.rows - size) * size + analysis.columns
    entries = tuple(flat[analysis.own :].tolist())
    given, lots = given_of(state, h, (1.0, 1.0, 0.0)), np.random.default_rng(1)
    x, other = (state.unknowns * (1 + 0.05 * lots.standard_normal(size)) for _ in range(2))
    plain, known = known_of(hht, state, h, state.a)
    n = layout.structure.n
    blocks_of = lambda x, known, given: residual_and_matrix(dynamics, plain, x, known)  # noqa: E731
    fresh_of = lambda x, known, given: fresh_correction(dynamics, *static, entries, x, given)  # noqa: E731
    both, fresh = (np.asarray(value) for value in values((blocks_of, fresh_of), x, known, given))
    residual, blocks = unpack_matrix(layout, both)
    matrix, maps = blocks[:size], blocks[size:]

    def agrees(found, residual):
        wanted = np.linalg.solve(matrix, residual)
        moved = np.abs(maps @ wanted)
        sizes = [*wanted, moved[:n].max(), moved[n:].max()]
        np.testing.assert_allclose(found, sizes, rtol=1e-8, atol=1e-10 * np.abs(wanted).max())

    agrees(fresh[: size + 2], residual)
    inverse, kept, largest = np.split(fresh[size + 2 :], [size * size, size * size + len(entries)])
    np.testing.assert_allclose(inverse.reshape(size, size).T @ matrix, np.eye(size), atol=1e-9)
    np.testing.assert_array_equal(kept, maps.ravel()[list(entries)])
    np.testing.assert_allclose(largest, [max(np.abs(residual).max(), np.abs(blocks).max())], rtol=1e-12)
    lagged = lambda x, inverse, kept, given: lagged_correction_and_end(  # noqa: E731
        dynamics, *static, entries, x, inverse, kept, given
    )
    whole = lambda x, inverse, kept, given: residual_and_end(dynamics, *static, x, given)  # noqa: E731
    later, both = (np.asarray(value) for value in values((lagged, whole), other, inverse, kept, given))
    agrees(later[: size + 2], both[:size])
    np.testing.assert_allclose(later[size + 2 : 2 * size + 2], both[:size], rtol=1e-13, atol=1e-13)
    agrees(later[2 * size + 2 : 3 * size + 4], constraint_rows(layout, both[:size]))
    np.testing.assert_allclose(later[3 * size + 4 :], both[2 * size :], rtol=1e-13, atol=1e-13)
