"""What a solve accepts as its start: consistent data, checked inputs (rows I1 to I8 of the matrix)."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.protocol import NumpySystem, System
from hhtbench.result import Status
from solvers.hht import HHT
from tests.hht.scenes import GRAVITY, JAX_PENDULUM, Q0, SYSTEMS, V0, Calls, Pendulum, circle, pendulum, same_bits

STEPS = {"steps": 20}
SPAN = (0.0, 0.2)


def never(*arguments):
    raise AssertionError("a callback was called")


@pytest.mark.parametrize("alpha", [0.0, -1.0 / 3.0, -0.3333333333333, np.float64(-0.1), 0])
def test_both_ends_of_the_range_of_alpha_are_accepted(alpha):
    assert HHT(pendulum(), alpha=alpha).options.method().coefficients.alpha == pytest.approx(float(alpha), abs=1e-12)


@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize(
    ("q0", "v0", "row"),
    [
        (Q0 * 1.001, V0, r"g\[0\] = 0.001"),
        (Q0 * 1.1, V0, r"g\[0\] = 0.105"),
        (Q0, V0 + 0.25 * Q0, r"\(g_t \+ g_q v\)\[0\] = 0.25"),
    ],
)
def test_an_inconsistent_start_is_refused_with_row_and_size(route, q0, v0, row):
    solution = HHT(SYSTEMS[route]).solve(SPAN, q0, v0, **STEPS)
    assert solution.status is Status.inconsistent_initial
    assert len(solution.t) == 0
    with pytest.raises(AssertionError, match=row):
        raise AssertionError(solution.message)


@pytest.mark.parametrize("route", SYSTEMS)
@pytest.mark.parametrize(("q0", "v0"), [(Q0 * 1.001, V0), (Q0 * 1.1, V0), (Q0, V0 + 0.25 * Q0), (Q0 * 0.9, V0 - Q0)])
def test_calc_initcond_moves_the_start_onto_both_levels_and_says_how_far(route, q0, v0):
    solution = HHT(SYSTEMS[route]).solve(SPAN, q0, v0, **STEPS, calc_initcond=True)
    assert solution.success, solution.message
    q, v = solution.q[0], solution.v[0]
    assert abs(q @ q - 1.0) / 2.0 <= 1e-12
    assert abs(q @ v) <= 1e-12
    moved_q, moved_v = np.max(np.abs(q - q0)), np.max(np.abs(v - v0))
    assert f"moved q0 by {moved_q:.3g} and v0 by {moved_v:.3g}" in solution.message
    assert np.allclose(q, Q0, atol=1e-12)  # the closest point of the circle lies on the ray
    assert np.allclose(v, V0, atol=1e-9)


POINTS = np.array([[1.07901, -1.041988], [0.0, 1.5], [-0.555727, -0.575472], [1.283995, 0.203365], [0.0, 0.0]])
RODS = np.array([(0, 4), (1, 4), (2, 4), (3, 4), (2, 3), (0, 3)])  # the last point is fixed
MASSES = [3e-4, 1e5, 3e-6, 1e3]


def along_rods(q):
    """(6, 2) from end to end."""
    points = np.vstack([q.reshape(4, 2), np.zeros((1, 2))])
    return points[RODS[:, 0]] - points[RODS[:, 1]]


def rows_of_rods(q):
    rows = np.zeros((6, 5, 2))
    for row, (i, j), d in zip(rows, RODS, along_rods(q), strict=True):
        row[i], row[j] = d, -d
    return rows[:, :4].reshape(6, 8)


@pytest.mark.parametrize("unit", [1e-79, 1.0, 1e79])
def test_calc_initcond_does_the_same_in_any_unit(unit):
    """Light and heavy masses on rods: what is on its constraints stays, what is off moves little."""
    given = POINTS[:4].ravel()
    squares = np.sum(along_rods(given) ** 2, axis=1) / 2
    linkage = NumpySystem(
        mass_matrix=np.repeat(MASSES, 2),
        force=lambda t, q, v: np.zeros(8),
        constraint=lambda t, q: np.sum(along_rods(q) ** 2, axis=1) / 2 - squares * unit**2,
        constraint_jacobian=lambda t, q: rows_of_rods(q),
    )
    for off, most in ((0.0, 1e-14), (1e-3, 1e-2)):
        q0 = (given + off * np.array([1, -1, 1, 0, -1, 1, 0, 1])) * unit
        solution = HHT(linkage).solve((0.0, 1e-3), q0, np.zeros(8), steps=1, calc_initcond=True)
        assert solution.success, solution.message
        assert np.abs(solution.q[0] / unit - given).max() <= most
        assert np.abs(np.sum(along_rods(solution.q[0] / unit) ** 2, axis=1) / 2 - squares).max() <= 1e-12


NO_ROOT = {
    "no root": lambda t, q: np.array([q @ q + 1.0]),
    "no root, flat": lambda t, q: np.array([np.exp(-(q @ q)) + 1e-3]),
    "overflow": lambda t, q: np.array([np.exp(q @ q) + 1.0]),
    "jump": lambda t, q: np.array([np.sign(q[0]) * (1.0 + q @ q)]),
}


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.filterwarnings("ignore:invalid value")
@pytest.mark.parametrize("name", NO_ROOT)
@pytest.mark.parametrize("size", [1e-8, 1.0, 20.0, 1e12])
def test_projection_from_far_away_ends_in_a_bounded_number_of_calls(name, size):
    calls = Calls()
    functions = calls.wrap({"force": lambda t, q, v: np.zeros(2), "constraint": NO_ROOT[name]})
    solution = HHT(NumpySystem(**functions)).solve(SPAN, size * Q0, V0, **STEPS, calc_initcond=True)
    assert solution.status in (Status.inconsistent_initial, Status.nonfinite_callback), solution.message
    if solution.status is Status.nonfinite_callback:
        assert not np.isfinite(NO_ROOT[name](0.0, size * Q0)).all()  # only where the start itself is not finite
    assert calls.count["constraint"] < 5000


@pytest.mark.parametrize("route", SYSTEMS)
def test_a_wrong_guess_of_the_multipliers_changes_nothing_where_the_reaction_is_linear(route):
    solver = HHT(SYSTEMS[route])
    right = solver.solve(SPAN, Q0, V0, **STEPS)
    for guess in ([1e2], [-1e4], [0.0]):
        wrong = solver.solve(SPAN, Q0, V0, lam_guess=guess, **STEPS)
        assert np.max(np.abs(wrong.q - right.q)) <= 1e-8
        assert np.max(np.abs(wrong.v - right.v)) <= 1e-8
        assert np.max(np.abs(wrong.lam - right.lam)) <= 1e-8


@pytest.mark.parametrize("shape", [(1, 2), (2, 1), (3,), (1,), ()])
@pytest.mark.parametrize("name", ["q0", "v0"])
def test_a_start_of_another_shape_is_refused_with_both_shapes(shape, name):
    values = {"q0": Q0, "v0": V0, name: np.ones(shape)}
    with pytest.raises(ValueError, match=r"shape .*\(\w*,\).*; got \(") as caught:
        HHT(NumpySystem(force=never, constraint=never)).solve(SPAN, values["q0"], values["v0"], **STEPS)
    assert "0 must have shape" in str(caught.value)


@pytest.mark.parametrize("route", SYSTEMS)
def test_a_guess_of_another_size_is_refused(route):
    with pytest.raises(ValueError, match=r"lam_guess must have shape \(1,\).*\(2,\)"):
        HHT(SYSTEMS[route]).solve(SPAN, Q0, V0, lam_guess=[1.0, 2.0], **STEPS)


def _kinds(values):
    spaced = np.zeros(4)
    spaced[::2] = values
    frozen = np.array(values)
    frozen.setflags(write=False)
    column = np.asfortranarray(np.stack([values, values]))[0]
    plain = {"list": list(values), "tuple": tuple(values), "jax": jnp.asarray(values)}
    return plain | {"strided": spaced[::2], "read-only": frozen, "fortran": column}


def test_every_kind_of_real_vector_gives_the_same_bits_and_stays_as_it_was():
    solver = HHT(JAX_PENDULUM)
    expected = solver.solve(SPAN, Q0, V0, **STEPS)
    for name, q0 in _kinds(Q0).items():
        v0 = _kinds(V0)[name]
        assert same_bits(solver.solve(SPAN, q0, v0, **STEPS), expected), name
        assert np.array_equal(q0, Q0), name
        assert np.array_equal(v0, V0), name


def test_integers_and_single_precision_mean_their_float64_values():
    solver = HHT(JAX_PENDULUM)
    whole = solver.solve(SPAN, [1, 0], np.array([0, 2], dtype=np.int32), **STEPS)
    assert same_bits(whole, solver.solve(SPAN, [1.0, 0.0], [0.0, 2.0], **STEPS))
    single = solver.solve(SPAN, np.float32([0.0, -1.0]), np.float32([0.1, 0.0]), **STEPS)
    assert same_bits(single, solver.solve(SPAN, [0.0, -1.0], [float(np.float32(0.1)), 0.0], **STEPS))


def test_the_solution_shares_no_memory_with_the_start():
    q0, v0 = Q0.copy(), V0.copy()
    solution = HHT(pendulum()).solve(SPAN, q0, v0, **STEPS)
    before = solution.q.copy()
    q0[:] = v0[:] = 7.0
    assert np.array_equal(solution.q, before)


def test_no_coordinates_are_refused():
    with pytest.raises(ValueError, match="q0 must hold at least one coordinate"):
        HHT(NumpySystem(force=never)).solve(SPAN, [], [], **STEPS)


def rest(t, q, v):
    return np.zeros(2)


def test_as_many_constraints_as_coordinates_hold_the_system_still():
    held = NumpySystem(force=lambda t, q, v: np.array([3.0, -GRAVITY]), constraint=lambda t, q: q - np.array([0.3, 0.4]))
    solution = HHT(held).solve(SPAN, [0.3, 0.4], [0.0, 0.0], **STEPS)
    assert solution.success, solution.message
    assert np.max(np.abs(solution.q - [0.3, 0.4])) <= 1e-12
    assert np.allclose(solution.lam, [3.0, -GRAVITY], atol=1e-7)  # statics: the reaction carries the load


def test_more_constraints_than_coordinates_are_named_and_left_out_or_violated():
    three = NumpySystem(force=rest, constraint=lambda t, q: np.array([q[0], q[1], q[0] + q[1]]))
    with pytest.warns(UserWarning, match="rank 2 of 3"):
        solution = HHT(three).solve(SPAN, [0.0, 0.0], [0.0, 0.0], **STEPS)
    assert solution.success
    assert np.max(np.abs(solution.q)) <= 1e-12
    contradictory = NumpySystem(force=rest, constraint=lambda t, q: np.array([q[0], q[1], q[0] + q[1] - 1.0]))
    with pytest.warns(UserWarning, match="rank 2 of 3"):
        solution = HHT(contradictory).solve(SPAN, [0.0, 0.0], [0.0, 0.0], **STEPS)
    assert solution.status is Status.inconsistent_initial
    assert "g[2]" in solution.message


WRONG_SIZES = {
    "force": lambda t, q, v: np.zeros(3),
    "mass_matrix": lambda t, q: np.eye(3),
    "constraint_jacobian": lambda t, q: np.zeros((2, 2)),
    "force_jacobians": lambda t, q, v: (np.zeros((2, 3)), np.zeros((2, 2))),
}


@pytest.mark.parametrize("name", WRONG_SIZES)
def test_sizes_that_disagree_are_an_error_naming_function_and_shapes(name):
    expected = r"\(1, 2\)" if name == "constraint_jacobian" else r"\(2,"
    with pytest.raises(ValueError, match=rf"{name}.* must return shape {expected}.*got \("):
        HHT(pendulum(**{name: WRONG_SIZES[name]})).solve(SPAN, Q0, V0, **STEPS)


def test_a_constant_mass_of_another_size_is_an_error():
    with pytest.raises(ValueError, match=r"mass_matrix must return shape \(2, 2\).*\(3,\)"):
        HHT(pendulum(mass_matrix=[1.0, 2.0, 3.0])).solve(SPAN, Q0, V0, **STEPS)


def test_a_constraint_that_is_no_vector_is_an_error():
    with pytest.raises(ValueError, match="constraint must return shape"):
        HHT(pendulum(constraint=lambda t, q: circle(t, q)[0], constraint_jacobian=None)).solve(SPAN, Q0, V0, **STEPS)


class WrongForce(System):
    def force(self, t, q, v):
        return jnp.zeros(3)


class WrongMass(System):
    def force(self, t, q, v):
        return jnp.zeros(2)

    def mass_matrix(self, t, q):
        return jnp.eye(3)


class WrongJacobian(System):
    def force(self, t, q, v):
        return jnp.zeros(2)

    def constraint(self, t, q):
        return q[:1]

    def constraint_jacobian(self, t, q):
        return jnp.zeros((2, 2))


@pytest.mark.parametrize(
    ("system", "name"), [(WrongForce(), "force"), (WrongMass(), "mass_matrix"), (WrongJacobian(), "constraint_jacobian")]
)
def test_sizes_of_a_jax_system_that_disagree_are_an_error_before_any_compilation(system, name):
    with pytest.raises(ValueError, match=rf"{name} must return shape .*got \("):
        HHT(system).solve(SPAN, Q0, V0, **STEPS)


@pytest.mark.parametrize(("off", "moves"), [(0.0, True), (5e-9, False)])
def test_a_start_that_is_off_by_more_than_the_tolerances_allow_is_named_at_the_first_step(off, moves):
    """It counts as consistent: coarser tolerances do with it."""
    fine = HHT(Pendulum()).solve((0.0, 0.01), Q0 * (1.0 + off), V0, rtol=1e-8)
    assert HHT(Pendulum()).solve((0.0, 0.01), Q0 * (1.0 + off), V0, rtol=1e-5).success
    assert (fine.status is Status.success) is moves, fine.message
    if not moves:
        assert fine.status is Status.inconsistent_initial
        assert "g[0] = 5e-09" in fine.message
        assert "Loosen" not in fine.message


def test_a_step_that_may_not_be_shorter_is_not_blamed_on_a_start_of_ten_digits():
    solution = HHT(Pendulum(), min_step=0.3).solve((0.0, 1.0), Q0 * (1.0 + 2e-11), V0, rtol=1e-6)
    assert solution.status is Status.step_too_small
    assert "0.3" in solution.message
