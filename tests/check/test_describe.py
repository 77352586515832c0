"""The description says what is declared, what therefore is not computed, and why."""

import json

import numpy as np
import pytest

from hhtbench.lowering.description import describe
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import NumpySystem
from tests.check.scenes import Bead, bead_problem, fall, jax_bead, problem
from tests.lowering.systems import Massless, MasslessWheel, Pendulum, Rich


def made(system, n):
    return describe(Problem(name="made", system=system, t_span=(0, 1), q0=np.full(n, 0.5), v0=np.full(n, 0.2)))


def texts(description, topic):
    return {s.subject: f"{s.text} {s.reason}" for s in description.about(topic)}


PENDULUM, RICH, FALL = made(Pendulum(mass_matrix=2.5), 2), made(Rich(), 3), describe(fall())


def test_parameters_are_shown_with_value_and_meaning():
    assert texts(made(Rich(stiffness=3.25), 3), "declared")["stiffness"] == "= 3.25 stiffness [N/m]"
    assert texts(PENDULUM, "declared")["mass_matrix"].startswith("2.5")


@pytest.mark.parametrize(
    ("description", "subject", "words"),
    [
        (PENDULUM, "mu, k, k_v", "no multiplier mu"),
        (PENDULUM, "M(t, q), (M x)_q", "factorised once"),
        (PENDULUM, "F_v", "the force does not depend on v"),
        (PENDULUM, "F_q", "the force does not depend on q"),
        (PENDULUM, "g_t", "the constraint does not depend on t"),
        (FALL, "lam, g, g_q", "no multiplier lam"),
        (FALL, "KKT matrix", "without constraints it is an ODE"),
        (FALL, "M", "identity"),
        (FALL, "energy", "not measured"),
        (made(MasslessWheel(), 3), "Q_v", "does not depend on v"),
    ],
)
def test_what_is_not_declared_is_not_computed_with_its_reason(description, subject, words):
    assert words in texts(description, "not computed")[subject]


def test_what_is_needed_is_not_said_to_be_left_out():
    assert set(texts(RICH, "not computed")) == {"energy", "invariants"}


def test_the_multipliers_need_one_solve_or_an_iteration():
    assert "one linear solve" in texts(PENDULUM, "computed")["multipliers"]
    assert "Newton" in texts(RICH, "computed")["multipliers"]


@pytest.mark.parametrize(
    ("description", "sizes", "step", "kkt"),
    [
        (PENDULUM, "n = 2 coordinates, m = 1 position constraints, p = 0", "4 x 4 (6 x 6 for b != 0)", "3 x 3"),
        (RICH, "n = 3 coordinates, m = 1 position constraints, p = 1", "12 x 12 (9 x 9 with", "5 x 5"),
        (FALL, "n = 2 coordinates, m = 0 position constraints, p = 0", "2 x 2", None),
    ],
)
def test_sizes_and_linear_algebra(description, sizes, step, kkt):
    assert sizes in texts(description, "size")["n, m, p"]
    assert step in texts(description, "linear algebra")["HHT step"]
    level = texts(description, "linear algebra").get("acceleration level")
    assert level is None if kkt is None else kkt in level


def test_a_singular_mass_is_augmented_and_no_longer_constant():
    description = made(Massless(), 3)
    assert "augmented" in texts(description, "linear algebra")["mass"]
    assert "M(t, q), (M x)_q" not in texts(description, "not computed")


def test_route_and_derivatives_follow_from_the_kind_of_system():
    assert set(texts(describe(jax_bead()), "route")) == {"native"}
    assert "called as declared" in texts(describe(jax_bead()), "computed")["constraint_jacobian"]
    plain = describe(problem({"force": lambda t, q, v: -q}))
    assert set(texts(plain, "route")) == {"numpy"}
    assert "differences" in texts(plain, "computed")["force_jacobians"]
    assert "cannot be read" in texts(plain, "computed")["dependencies"]
    coloured = describe(problem({"force": lambda t, q, v: -q, "sparsity": {"force_q": np.eye(2)}}))
    assert "coloured" in texts(coloured, "computed")["force_jacobians"]


def test_a_system_without_start_says_that_sizes_need_one():
    assert "sizes need a start" in texts(describe(Bead()), "size")["n, m, p"]
    assert "n = 3" in texts(describe(Massless()), "size")["n, m, p"]
    assert "no multiplier mu" in texts(describe(Bead()), "not computed")["mu, k, k_v"]
    assert describe(NumpySystem(force=lambda t, q, v: -q)).about("route")[0].subject == "numpy"


def test_the_description_is_a_table_and_plain_values():
    description = describe(bead_problem())
    assert str(description).splitlines()[0] == "made: NumpySystem"
    assert all(statement.subject.split(",")[0] in str(description) for statement in description.statements)
    stored = json.loads(json.dumps(description.as_dict()))
    assert set(stored) == {"title", "statements"}
    assert all(set(row) == {"topic", "subject", "text", "reason"} for row in stored["statements"])


def test_wrong_input_is_refused():
    with pytest.raises(TypeError, match="takes a Problem, a System or a NumpySystem; got str"):
        describe("andrews")
    with pytest.raises(ProblemError, match="constraint must return shape"):
        describe(bead_problem(constraint=lambda t, q: np.ones((2, 2))))
