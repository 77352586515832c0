"""A fault in a declared derivative is found, named and placed (acceptance row J4)."""

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.checks.problem import check
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System
from tests.check.scenes import V0, Bead, bead, bead_problem, failed, jax_bead, problem, row, skate, skate_problem

FAULTS = {
    "10 % wrong": lambda x: 1.1 * x,
    "factor 2": lambda x: 2.0 * x,
    "wrong sign": lambda x: -x,
    "zero": lambda x: 0.0 * x,
    "transposed": lambda x: x.T,
    "NaN": lambda x: np.nan * x,
    "wrong shape": lambda x: np.concatenate([x, x]),
}
TARGETS = [  # declared function, which of its two matrices, the row that must fail
    ("force_jacobians", 0, "force_q"),
    ("force_jacobians", 1, "force_v"),
    ("constraint_jacobian", None, "constraint_q"),
    ("constraint_time_derivative", None, "constraint_t"),
    ("constraint_acceleration", None, "constraint_acceleration"),
    ("reaction_jacobians", 0, "reaction_q"),
    ("reaction_jacobians", 1, "reaction_lam"),
    ("velocity_constraint_jacobian", None, "velocity_constraint_v"),
]


def declared_value(name, which):
    function = (skate() | bead())[name]
    arguments = (np.array([1.0, 0.5, 0.3]), np.array([2.0, 1.5, 0.7]))[: function.__code__.co_argcount - 1]
    value = function(0.1, *arguments)
    return value if which is None else value[which]


def with_fault(name, which, fault):
    make, functions = (skate_problem, skate()) if name.startswith("velocity") else (bead_problem, bead())

    def faulty(*arguments):
        value = functions[name](*arguments)
        if which is None:
            return fault(value)
        return tuple(fault(part) if i == which else part for i, part in enumerate(value))

    return make(**{name: faulty})


def same_transposed(name, which):
    value = declared_value(name, which)
    return value.shape == value.T.shape and np.array_equal(value, value.T)


CASES = [
    (*target, fault) for target in TARGETS for fault in FAULTS if fault != "transposed" or not same_transposed(*target[:2])
]


@pytest.mark.parametrize(("name", "which", "target", "fault"), CASES)
def test_a_fault_in_a_declared_derivative_is_found_and_named(name, which, target, fault):
    value = declared_value(name, which)
    evidence = check(with_fault(name, which, FAULTS[fault]))
    assert not evidence.passed
    wrong_shape = fault == "wrong shape" or (fault == "transposed" and value.shape != value.T.shape)
    if wrong_shape:
        assert failed(evidence)[0] == f"shape/{name}"
        assert "got shape" in row(evidence, f"shape/{name}").measured
    else:
        # where one matrix of a pair is NaN the callback gives neither; the text names the matrix
        allowed = {f"derivative/{t}" for n, _, t in TARGETS if n == name and (fault == "NaN" or t == target)}
        assert failed(evidence)[0] in allowed
    found = row(evidence, f"derivative/{target}")
    assert found.passed is False
    assert fault != "NaN" or "nan" in found.measured


def test_the_worst_entry_is_given_with_row_column_and_both_values():
    functions = bead()

    def jacobians(t, q, v):
        by_q, by_v = functions["force_jacobians"](t, q, v)
        by_v = by_v.copy()
        by_v[1, 0] += 0.5
        return by_q, by_v

    measured = row(check(bead_problem(force_jacobians=jacobians)), "derivative/force_v").measured
    assert "row 1, column 0" in measured
    given, expected = (float(measured.split(f"{word} ")[1].split(",")[0].rstrip(")")) for word in ("given", "expected"))
    assert given - expected == pytest.approx(0.5, rel=1e-6)


def test_a_zero_jacobian_declared_as_none_is_checked_too():
    functions = bead()
    evidence = check(bead_problem(force_jacobians=lambda t, q, v: (functions["force_jacobians"](t, q, v)[0], None)))
    assert failed(evidence) == ["derivative/force_v"]


def test_a_derivative_that_is_right_at_rest_only_is_found():
    """constraint_acceleration without its velocity terms is right at v = 0."""
    resting = problem(bead() | {"constraint_acceleration": lambda t, q, v: np.array([-np.sin(t) / 10])}, v0=np.zeros(2))
    assert "derivative/constraint_acceleration" in failed(check(resting))


@pytest.mark.parametrize("fault", [0.1, 1e-9, np.nan])
def test_a_fault_in_a_declared_jax_derivative_is_found(fault):
    """1e-9 is below the error of differences; automatic differentiation sees it."""
    evidence = check(jax_bead(Bead(fault=fault)))
    first = failed(evidence)[0]
    assert first == "derivative/constraint_q"
    assert ("automatic" in row(evidence, first).measured) == (fault == 1e-9)


def test_what_is_made_from_a_wrong_derivative_is_not_measured_but_the_start_is():
    evidence = check(jax_bead(Bead(fault=0.1)))
    assert row(evidence, "derivative/constraint_acceleration").measured.startswith("not measured: it is made from")
    assert row(evidence, "start/velocity").passed  # g_q from automatic differentiation, not the wrong one


def test_a_wrong_sparsity_pattern_is_found():
    functions = {"force": bead()["force"], "sparsity": {"force_q": np.eye(2, dtype=bool)}}
    assert failed(check(problem(functions))) == ["derivative/force_q"]


def test_a_pattern_of_the_wrong_shape_is_a_row():
    evidence = check(problem({"force": bead()["force"], "sparsity": {"force_q": np.eye(3)}}))
    assert "shape/sparsity" in failed(evidence)


@pytest.mark.parametrize(("pattern", "error"), [({"force_x": np.eye(2)}, ValueError), ([1, 2], TypeError)])
def test_a_pattern_of_unknown_name_is_refused_before_any_check(pattern, error):
    with pytest.raises(error, match="force_q"):
        problem({"force": bead()["force"], "sparsity": pattern})


@pytest.mark.parametrize(("factor", "passed"), [(1.0, True), (1.0 + 1e-9, False)])
def test_functions_that_are_not_holomorphic_are_judged_too(factor, passed):
    """Of -|q| q; at the kink of |q_1| = 0 both derivatives vanish."""

    class Drag(System):
        def force(self, t, q, v):
            return -jnp.abs(q) * q

        def force_jacobians(self, t, q, v):
            return -2.0 * factor * jnp.diag(jnp.abs(q)), None

    found = row(check(Problem(name="x", system=Drag(), t_span=(0, 1), q0=[1.0, 0.0], v0=V0)), "derivative/force_q")
    assert found.passed is passed


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_differences_stay_where_a_function_is_defined(sign):
    """A first step of 1/256 of the scale leads from 1e-3 to a negative number, whose root is NaN."""

    class Root(System):
        def force(self, t, q, v):
            return -jnp.sqrt(q)

        def force_jacobians(self, t, q, v):
            return -sign * jnp.diag(0.5 / jnp.sqrt(q)), None

    scene = Problem(name="root", system=Root(), t_span=(0.0, 1e-3), q0=[1e-3], v0=[0.0], scales=Scales(q=1.0, v=1.0))
    found = row(check(scene), "derivative/force_q")
    assert found.passed is (sign > 0)
    assert "inf" not in found.bound
