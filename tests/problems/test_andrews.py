"""Andrews' squeezing mechanism against the values of the Test Set for IVP Solvers and an integration of our own."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from problems.andrews import LAM_START, problem
from tests.problems.mechanics import compiled
from tests.problems.published import STORED

TIMES = (0.03, 0.05)


def rows(reference):
    """(t, q, v, lam) at the published times that the reference reaches."""
    for i, t in enumerate(reference["t"]):
        if t in TIMES:
            yield t, reference["q"][i], reference["v"][i], reference["lam"][i]


def test_accelerations_and_multipliers_at_the_start_are_those_of_the_test_set(mechanics):
    squeezer = problem()
    vdot, lam, _ = mechanics(squeezer.system).accelerations(0.0, squeezer.q0, squeezer.v0)
    expected = np.array([14222.4439199541138705911625887, -10666.8329399655854029433719415, 0, 0, 0, 0, 0])
    np.testing.assert_allclose(vdot, expected, rtol=1e-11, atol=1e-8)
    np.testing.assert_allclose(lam, LAM_START, rtol=1e-11, atol=1e-11)
    np.testing.assert_array_equal(squeezer.lam_guess, LAM_START)


def test_reference_states_satisfy_constraints_energy_and_acceleration_level(mechanics):
    squeezer = problem(t_end=0.05)
    system, found = mechanics(compiled(squeezer.system)), list(rows(squeezer.reference))
    assert [row[0] for row in found] == list(TIMES)
    start = squeezer.system.energy(0.0, squeezer.q0, squeezer.v0)
    for t, q, v, expected in found:
        np.testing.assert_allclose(system.g(t, q), 0.0, atol=1e-15)
        np.testing.assert_allclose(system.position_rate(t, q, v), 0.0, atol=1e-12)
        np.testing.assert_allclose(squeezer.system.energy(t, q, v), start, rtol=1e-13)
        vdot, lam, _ = system.accelerations(t, q, v)
        np.testing.assert_allclose(lam, expected, rtol=1e-10)
        if t == TIMES[0]:
            np.testing.assert_allclose(vdot, np.array(STORED["andrews"]["a"], dtype=float), rtol=1e-10)


def test_published_end_values_hold_to_their_digits():
    """The Test Set's values agree with ours to about 10 digits in q and 7 in v."""
    _, q, v, _ = next(rows(problem().reference))
    np.testing.assert_allclose(STORED["andrews"]["published_q"], q, rtol=1e-9)
    np.testing.assert_allclose(STORED["andrews"]["published_v"], v, rtol=1e-6)


def test_integration_of_the_underlying_equation_reaches_the_reference():
    """DOP853 on the equation with the multipliers eliminated; the reference comes from another method and form."""
    squeezer = problem(t_end=0.05)
    system = squeezer.system

    @jax.jit
    def rate(t, y):
        q, v = y[:7], y[7:]
        G = jax.jacfwd(system.constraint, 1)(t, q)
        slope = lambda x: jax.jvp(lambda z: system.constraint(t, z), (x,), (v,))[1]  # noqa: E731
        bias = jax.jvp(slope, (q,), (v,))[1]
        matrix = jnp.block([[system.mass_matrix(t, q), G.T], [G, jnp.zeros((6, 6))]])
        x = jnp.linalg.solve(matrix, jnp.concatenate([system.force(t, q, v), -bias]))
        return jnp.concatenate([v, x[:7]])

    start = np.concatenate([squeezer.q0, squeezer.v0])
    options = {"method": "DOP853", "rtol": 1e-11, "atol": 1e-11, "t_eval": TIMES}
    found = solve_ivp(lambda t, y: np.asarray(rate(t, y)), squeezer.t_span, start, **options)
    for y, (_, q, v, _) in zip(found.y.T, rows(squeezer.reference), strict=True):
        np.testing.assert_allclose(y[:7], q, rtol=1e-7)
        np.testing.assert_allclose(y[7:], v, rtol=1e-7, atol=1e-6)


def test_spring_is_measured_between_its_ends():
    squeezer = problem()
    length = squeezer.observables["spring_length"](0.0, squeezer.q0, squeezer.v0, squeezer.lam_guess)
    points = squeezer.sketch(squeezer.q0)["points"]
    np.testing.assert_allclose(length, np.linalg.norm(points[4] - points[3]), rtol=1e-14)


def test_sketch_closes_every_loop_in_the_common_joint():
    """Bars drawn from both ends have the lengths of the bodies, so the joints sit where the constraints put them."""
    squeezer = problem()
    for q in (squeezer.q0, *(row[1] for row in rows(problem(t_end=0.05).reference))):
        lines = squeezer.sketch(q)["lines"]
        lengths = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)[[0, 1, 2, 5, 6, 7, 8]]
        np.testing.assert_allclose(lengths, [0.007, 0.028, 0.035, 0.04, 0.02, 0.04, 0.02], rtol=1e-12)
