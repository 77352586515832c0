"""What is read from a system: dependencies, sizes, and errors that name function and shapes."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.lowering import REDUCTIONS, derive
from hhtbench.lowering.dynamics.derive_jax import used_arguments
from hhtbench.protocol.errors import NonFiniteValue, ProblemError
from hhtbench.protocol.system import NumpySystem, System
from tests.lowering.systems import RICH_NUMPY, MasslessWheel, Pendulum, Rich, Springs


def test_an_argument_counts_as_used_only_when_a_result_depends_on_it():
    def function(t, q, v):
        _ = jnp.sin(v)  # computed, but without effect
        return q * 2 + 0 * jnp.ones(2)

    assert used_arguments(function, 0.0, jnp.ones(2), jnp.ones(2)) == (False, True, False)


@pytest.mark.parametrize(
    ("system", "n", "facts"),
    [
        (
            Springs(),
            2,
            {"m": 0, "p": 0, "mass": "identity", "force_uses_q": True, "force_uses_v": False, "constrained": False},
        ),
        (
            Pendulum(),
            2,
            {"m": 1, "p": 0, "mass": "constant", "force_uses_q": False, "rheonomic": False, "linear_reaction": True},
        ),
        (Rich(), 3, {"m": 1, "p": 1, "mass": "variable", "rheonomic": True, "linear_reaction": False}),
        (Rich(), 3, {"velocity_jacobian_uses_v": True, "velocity_reaction_uses_v": True, "force_uses_v": True}),
        (MasslessWheel(), 3, {"m": 0, "p": 1, "velocity_jacobian_uses_v": False, "velocity_reaction_uses_v": False}),
        (RICH_NUMPY, 3, {"m": 1, "p": 1, "mass": "variable", "force_uses_q": True, "linear_reaction": False}),
    ],
)
def test_structure_states_sizes_and_dependencies(system, n, facts):
    structure = derive(system, 0.1, np.full(n, 0.3), np.full(n, 0.2)).structure
    assert {name: getattr(structure, name) for name in facts} == facts


def test_a_mass_method_that_depends_on_nothing_counts_as_constant():
    class Ball(Springs):
        def mass_matrix(self, t, q):
            return 2 * jnp.eye(2)

    dynamics = derive(Ball(), 0.0, np.ones(2), np.ones(2))
    assert dynamics.structure.mass == "constant"
    np.testing.assert_array_equal(dynamics.inverse_mass, 0.5 * np.eye(2))


# (function, arguments after t, what it returns, expected shape, given shape): acceptance row I8
WRONG = [
    ("force", 2, lambda xp: xp.ones(3), "(2,)", "(3,)"),
    ("force", 2, lambda xp: xp.ones((2, 1)), "(2,)", "(2, 1)"),
    ("force", 2, lambda xp: xp.ones(()), "(2,)", "()"),
    ("mass_matrix", 1, lambda xp: xp.ones((2, 3)), "(2, 2)", "(2, 3)"),
    ("mass_matrix", 1, lambda xp: xp.ones(3), "(2, 2)", "(3,)"),
    ("reaction", 2, lambda xp: xp.ones(1), "(2,)", "(1,)"),
    ("velocity_reaction", 3, lambda xp: xp.ones(3), "(2,)", "(3,)"),
    ("constraint_jacobian", 1, lambda xp: xp.ones((2, 1)), "(1, 2)", "(2, 1)"),
    ("constraint_time_derivative", 1, lambda xp: xp.ones((1, 1)), "(1,)", "(1, 1)"),
    ("constraint_acceleration", 2, lambda xp: xp.ones(2), "(1,)", "(2,)"),
    ("velocity_constraint_jacobian", 2, lambda xp: xp.ones(2), "(1, 2)", "(2,)"),
    ("force_jacobians", 2, lambda xp: (xp.ones((2, 2)), xp.ones((2, 1))), "(2, 2)", "(2, 1)"),
    ("reaction_jacobians", 2, lambda xp: (xp.ones((2, 2)), xp.ones((2, 2))), "(2, 1)", "(2, 2)"),
]
RIGHT = {
    "force": lambda t, q, v: 0.0 * q,
    "constraint": lambda t, q: q[:1],
    "velocity_constraint": lambda t, q, v: v[1:],
}
CALLS = {  # the derived function that calls a declared one, and the arguments it takes
    "mass_matrix": ("mass", "t q"),
    "reaction": ("reaction", "t q v lam"),
    "reaction_jacobians": ("reaction_jacobians", "t q v lam"),
    "velocity_reaction": ("velocity_reaction", "t q v mu"),
    "constraint_jacobian": ("constraint_jacobian", "t q"),
    "constraint_time_derivative": ("constraint_time_derivative", "t q"),
}
PLACE = {"t": 0.0, "q": np.array([0.0, 1.0]), "v": np.array([1.0, 0.0]), "lam": np.ones(1), "mu": np.ones(1)}


def jax_system(**functions):
    methods = {name: lambda self, *arguments, f=f: f(*arguments) for name, f in functions.items()}
    return type("Made", (System,), methods)()


def call(system, name):
    """Derive ``system`` and evaluate what rests on the declared function ``name``."""
    dynamics = derive(system, PLACE["t"], PLACE["q"], PLACE["v"])
    function, arguments = CALLS.get(name, (name, "t q v"))
    return getattr(dynamics, function)(*(PLACE[key] for key in arguments.split()))


@pytest.mark.parametrize("route", ["jax", "numpy"])
@pytest.mark.parametrize(("name", "count", "result", "expected", "given"), WRONG)
def test_a_wrong_shape_is_refused_with_function_and_both_shapes(route, name, count, result, expected, given):
    xp, make = (jnp, jax_system) if route == "jax" else (np, lambda **functions: NumpySystem(**functions))
    functions = RIGHT | {name: lambda t, *arguments: result(xp)}
    with pytest.raises(ProblemError) as error:
        call(make(**functions), name)
    for text in (name, expected, given):
        assert text in str(error.value)


@pytest.mark.parametrize("route", ["jax", "numpy"])
@pytest.mark.parametrize("name", ["constraint", "velocity_constraint"])
def test_constraints_that_are_no_vector_are_refused(route, name):
    xp, make = (jnp, jax_system) if route == "jax" else (np, lambda **functions: NumpySystem(**functions))
    with pytest.raises(ProblemError, match=rf"{name} must return shape .*got \(2, 2\)"):
        call(make(**(RIGHT | {name: lambda t, *arguments: xp.ones((2, 2))})), name)


@pytest.mark.parametrize("value", [None, "text", np.array([1j, 2j]), True], ids=["None", "text", "complex", "bool"])
def test_a_force_that_is_no_real_array_is_refused(value):
    with pytest.raises(TypeError, match="force"):
        call(jax_system(**(RIGHT | {"force": lambda t, q, v: value})), "force")


def test_one_coordinate_wants_a_vector_of_one_not_a_scalar():
    system = NumpySystem(force=lambda t, q, v: -q[0])
    with pytest.raises(ProblemError, match=r"\(1,\).*got \(\)"):
        derive(system, 0.0, np.ones(1), np.ones(1)).force(0.0, np.ones(1), np.ones(1))


@pytest.mark.parametrize("route", ["jax", "numpy"])
def test_a_pair_of_jacobians_must_be_a_pair(route):
    xp, make = (jnp, jax_system) if route == "jax" else (np, lambda **functions: NumpySystem(**functions))
    with pytest.raises(TypeError, match="force_jacobians must return two matrices"):
        call(make(**(RIGHT | {"force_jacobians": lambda t, q, v: xp.ones((2, 2))})), "force_jacobians")


def test_a_system_without_force_is_refused():
    class Nothing(System):
        pass

    with pytest.raises(TypeError, match="Nothing declares no force"):
        derive(Nothing(), 0.0, np.ones(1), np.ones(1))


def test_a_value_that_is_not_finite_names_function_component_and_time():
    system = NumpySystem(force=lambda t, q, v: np.array([0.0, np.inf]))
    with pytest.raises(NonFiniteValue, match=r"force\[1\] = inf at t = 2"):
        derive(system, 0.0, np.ones(2), np.ones(2)).force(2.0, np.ones(2), np.ones(2))


def test_an_ignored_derivative_is_neither_used_nor_checked():
    system = jax_system(**(RIGHT | {"constraint_jacobian": lambda t, q: jnp.ones((5, 5))}))
    dynamics = derive(system, 0.0, PLACE["q"], PLACE["v"], ignored=("constraint_jacobian",))
    np.testing.assert_array_equal(dynamics.constraint_jacobian(0.0, PLACE["q"]), [[1.0, 0.0]])


# what callbacks may return and do besides: acceptance rows C6 to C10
Q, V = np.array([1.0, 2.0]), np.array([0.5, 0.25])


def test_time_reaches_a_callback_as_a_plain_float():
    seen = []
    system = NumpySystem(force=lambda t, q, v: seen.append(type(t)) or -q)
    derive(system, 0.0, Q, V).force(np.float64(1.0), Q, V)
    assert seen == [float]


@pytest.mark.parametrize(
    "system",
    [
        Springs(),
        Pendulum(mass_matrix=2.5),
        NumpySystem(force=lambda t, q, v: -q),
        NumpySystem(force=lambda t, q, v: -q, mass_matrix=np.array([2.0, 3.0])),
    ],
    ids=["identity", "number", "numpy", "numpy diagonal"],
)
def test_a_constant_mass_that_is_taken_for_any_other_has_the_same_values(system):
    known, general = (derive(system, 0.0, Q, V, without=without) for without in ((), ("mass",)))
    assert (known.structure.mass, general.structure.mass) != ("variable", "variable")
    assert general.structure == dataclasses.replace(known.structure, mass="variable")
    np.testing.assert_array_equal(general.mass(0.0, Q), known.mass(0.0, Q))
    np.testing.assert_array_equal(general.mass_product_jacobian(0.0, Q, V), np.zeros((2, 2)))
    np.testing.assert_allclose(general.over_mass(0.0, Q, V), known.over_mass(0.0, Q, V), rtol=1e-15)


@pytest.mark.parametrize("name", REDUCTIONS)
def test_without_a_reduction_the_structure_is_that_of_a_system_that_cannot_be_read(name):
    system = Pendulum()
    known, general = (derive(system, 0.0, Q, V, without=without).structure for without in ((), (name,)))
    assert general == dataclasses.replace(known, **REDUCTIONS[name])
    assert general != known
    assert derive(system, 0.0, Q, V).structure == known
