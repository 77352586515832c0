"""The check finds what is put into a problem, and nothing in a clean one."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from hhtbench.checks.problem import check
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import NumpySystem, System
from tests.check.scenes import (
    Q0,
    V0,
    Fall,
    bead,
    bead_problem,
    failed,
    fall,
    jax_bead,
    problem,
    row,
    skate,
    skate_problem,
)

CLEAN = {
    "position constraint, every derivative declared": bead_problem,
    "position constraint, nothing declared": lambda: problem(
        {k: f for k, f in bead().items() if "jacob" not in k and "_time" not in k and "_acc" not in k}, lam_guess=[-3.0]
    ),
    "velocity constraint": skate_problem,
    "JAX, declared Jacobian": jax_bead,
    "JAX, free fall": fall,
}


@pytest.mark.parametrize("name", CLEAN)
def test_a_clean_problem_passes(name):
    evidence = check(CLEAN[name]())
    assert evidence.passed, [(r.id, r.measured) for r in evidence.rows if r.passed is False]


def test_automatic_differentiation_judges_declared_derivatives_of_jax_functions():
    measured = row(check(jax_bead()), "derivative/constraint_q")
    assert "by automatic differentiation" in measured.measured
    assert "1e-12" in measured.bound


def test_the_same_problem_gives_the_same_rows():
    assert check(bead_problem()).rows == check(bead_problem()).rows


# shapes: no fault stops the check


@pytest.mark.parametrize("name", ["force", "mass_matrix", "constraint", "reaction"])
def test_a_wrong_shape_is_a_row_and_what_rests_on_it_is_not_measured(name):
    evidence = check(bead_problem(**{name: lambda t, *arguments: np.ones((3, 3))}))
    assert f"shape/{name}" in failed(evidence)
    assert "got shape (3, 3)" in row(evidence, f"shape/{name}").measured
    for row_id in ("derivative", "start", "kkt", "index"):
        assert row(evidence, row_id).measured.startswith("not measured: ")
        assert row(evidence, row_id).passed is False
    assert row(evidence, "data/energy").passed


def test_several_faults_are_all_listed():
    evidence = check(bead_problem(force=lambda t, q, v: None, energy=lambda t, q, v: q, reaction=lambda t, q, lam: 1 / 0))
    for name, word in (("force", "None"), ("energy", "shape (2,)"), ("reaction", "ZeroDivisionError")):
        assert word in row(evidence, f"shape/{name}").measured


def test_a_function_that_writes_into_its_arguments_is_a_row():
    def force(t, q, v):
        q[0] = 1.0
        return q

    assert "read-only" in row(check(bead_problem(force=force)), "shape/force").measured


def test_a_jax_function_of_the_wrong_shape_is_a_row():
    class Long(Fall):
        def energy(self, t, q, v):
            return q

        def force(self, t, q, v):
            return jnp.ones(3)

    evidence = check(fall(system=Long()))
    assert "got shape (3,)" in row(evidence, "shape/force").measured
    assert "got shape (2,)" in row(evidence, "shape/energy").measured


def test_a_jax_function_that_branches_on_values_is_a_row():
    class Branching(Fall):
        def force(self, t, q, v):
            return q if q[0] > 0 else v

    assert "TracerBoolConversionError" in row(check(fall(system=Branching())), "shape/force").measured


@pytest.mark.parametrize("name", ["force", "constraint", "mass_matrix"])
@pytest.mark.parametrize("route", ["jax", "numpy"])
def test_a_value_that_is_not_finite_is_named(name, route):
    if route == "jax":
        functions = {
            "force": lambda self, t, q, v: -q,
            "constraint": lambda self, t, q: q[:1] - 1,
            "mass_matrix": lambda self, t, q: jnp.eye(2) * (2 + jnp.sin(q[0])),
        }
        broken = functions | {name: lambda self, t, *a, f=functions[name]: f(self, t, *a).at[0].set(jnp.nan)}
        made = Problem(name="x", system=type("Broken", (System,), broken)(), t_span=(0, 1), q0=Q0, v0=V0)
    else:
        made = bead_problem(**{name: lambda t, *a: np.nan * bead()[name](t, *a)})
    evidence = check(made)
    assert failed(evidence)[0] == "start/finite"
    assert name in row(evidence, "start/finite").measured
    assert "nan" in row(evidence, "start/finite").measured


def test_states_where_the_force_is_undefined_are_left_out():
    """sqrt(q - q0) is defined to one side of the start only."""

    def force(t, q, v):
        with np.errstate(invalid="ignore"):
            return np.sqrt(q - Q0 + 0.02)

    rooted = problem({"force": force})
    evidence = check(rooted)
    assert "the others are left out" in row(evidence, "start/finite").measured
    assert row(evidence, "start/finite").passed


# mass


@pytest.mark.parametrize(
    ("mass", "wrong"),
    [
        (np.array([[2.0, 0.5], [0.0, 2.0]]), ["mass/symmetric"]),
        (np.array([[1.0, 2.0], [2.0, 1.0]]), ["mass/definite"]),
        (-1.0, ["mass/definite"]),
        (np.array([1e-9, 1e9]), []),
    ],
)
def test_the_mass_must_be_symmetric_without_negative_directions(mass, wrong):
    assert failed(check(problem({"force": bead()["force"], "mass_matrix": mass}))) == wrong


def test_a_negative_mass_is_named_with_its_entry():
    evidence = check(problem({"force": bead()["force"], "mass_matrix": np.array([2.0, -3.0])}))
    assert row(evidence, "mass/definite").claim.startswith("no mass is negative")
    assert "M[1, 1] = -3" in row(evidence, "mass/definite").measured


def test_a_singular_mass_is_allowed_where_the_kkt_matrix_is_regular():
    tied = {"force": lambda t, q, v: -q, "mass_matrix": np.array([1.0, 0.0]), "constraint": lambda t, q: q[1:] - 0.5}
    evidence = check(problem(tied, v0=np.array([1.0, 0.0])))
    assert evidence.passed
    assert "allowed, since the KKT matrix is regular" in row(evidence, "mass/definite").measured
    alone = check(problem({"force": lambda t, q, v: -q, "mass_matrix": np.array([1.0, 0.0])}))
    assert failed(alone) == ["start/acceleration", "kkt", "index"]
    assert "mass matrix is singular" in row(alone, "index").measured


# consistency


def test_rows_of_the_start_that_do_not_hold_are_named_with_their_size():
    two = {"force": lambda t, q, v: -q, "constraint": lambda t, q: np.array([q[0] - 1.0, q[1] - 0.499])}
    evidence = check(problem(two, v0=np.array([0.0, 0.25])))
    position, velocity = row(evidence, "start/position"), row(evidence, "start/velocity")
    assert (position.passed, velocity.passed) == (False, False)
    assert "g[1] = 0.001" in position.measured
    assert "(g_t + g_q v)[1] = 0.25" in velocity.measured
    assert "g[0]" not in position.measured


def test_a_velocity_constraint_that_does_not_hold_is_named():
    evidence = check(problem(skate(), q0=np.zeros(3), v0=np.array([1.0, 0.5, 2.0])))
    assert "k[0] = -0.1" in row(evidence, "start/velocity").measured


def test_contradictory_accelerations_are_found():
    """Two constraints with one gradient and different accelerations; both hold at the start."""
    both = {"force": lambda t, q, v: -q, "constraint": lambda t, q: np.array([q[0] - 1.0, q[0] - 1.0 - t**2])}
    evidence = check(problem(both, v0=np.zeros(2)))
    assert row(evidence, "start/velocity").passed
    assert not row(evidence, "start/acceleration").passed


# rank and index


@pytest.mark.parametrize("factor", [1.0, 3.7, 1e-8])
def test_redundant_rows_are_named_and_leave_no_index(factor):
    twice = {"force": lambda t, q, v: -q, "constraint": lambda t, q: np.array([q[0] - 1.0, factor * (q[0] - 1.0)])}
    evidence = check(problem(twice, v0=np.array([0.0, 1.0])))
    assert failed(evidence) == ["rank", "kkt", "index"]
    assert "rank 1 of 2" in row(evidence, "rank").measured
    assert "g[1]" in row(evidence, "rank").measured or "g[0]" in row(evidence, "rank").measured
    assert "not defined (redundant rows g[" in row(evidence, "index").measured
    assert "not unique" in row(evidence, "start/acceleration").measured


@pytest.mark.parametrize(
    ("make", "index"),
    [(bead_problem, "3"), (skate_problem, "2"), (lambda: problem({"force": lambda t, q, v: -q}), "0")],
    ids=["position", "velocity", "none"],
)
def test_the_index_follows_from_what_is_declared(make, index):
    assert row(check(make()), "index").measured.split()[0] == index


# problem data


@pytest.mark.parametrize(
    ("change", "row_id", "word"),
    [
        ({"scales": Scales(q=-1.0)}, "data/scales", "scales.q must be above 0"),
        ({"scales": Scales(v=np.ones(3))}, "data/scales", r"shape (2,); got (3,)"),
        ({"scales": Scales(q=np.nan)}, "data/scales", "finite"),
        ({"lam_guess": [1.0]}, "data/lam_guess", "got shape (1,)"),
        ({"mu_guess": [1.0, 2.0]}, "data/mu_guess", "got shape (2,)"),
        ({"observables": {"bad": lambda t, q, v, lam: q[7]}}, "data/observable/bad", "IndexError"),
        ({"observables": {"bad": lambda t, q, v, lam: np.nan}}, "data/observable/bad", "nan"),
        ({"exact": lambda t: fall().exact(t + 1e-3)}, "data/exact", "v differs by"),
        ({"exact": lambda t: None}, "data/exact", "AttributeError"),
        ({"reference": {"t": [0.0], "q": [[0.0, 2.1]], "v": [[1.0, 0.0]]}}, "data/reference", "q differs by 0.05"),
        ({"reference": {"t": [1.0], "q": [[0.0]], "v": [[1.0]]}}, "data/reference", "must have shape (1, 2)"),
    ],
)
def test_wrong_problem_data_is_named(change, row_id, word):
    evidence = check(fall(**change))
    assert failed(evidence) == [row_id]
    assert word in row(evidence, row_id).measured


@pytest.mark.parametrize(
    ("name", "function"),
    [("energy", lambda t, q, v: np.inf), ("invariants", lambda t, q, v: {"fine": 1.0, "lost": np.nan})],
)
def test_measured_quantities_must_be_finite(name, function):
    evidence = check(bead_problem(**{name: function}))
    assert failed(evidence) == [f"data/{name}"]


# the contract


def test_rows_are_json_and_the_closing_line_counts_them(tmp_path):
    evidence = check(bead_problem(constraint_jacobian=lambda t, q: np.full((1, 2), np.nan)))
    evidence.write_json(tmp_path / "check.json")
    stored = json.loads((tmp_path / "check.json").read_text())
    assert set(stored) == {"schema", "title", "passed", "rows", "environment"}
    assert stored["passed"] is False
    assert all(set(r) == {"id", "claim", "measured", "bound", "passed"} for r in stored["rows"])
    assert len({r["id"] for r in stored["rows"]}) == len(stored["rows"])
    assert evidence.summary.startswith("check of made: ")
    assert "derivative/constraint_q" in evidence.summary


def test_only_a_problem_is_checked():
    with pytest.raises(TypeError, match="check takes a Problem; got str"):
        check("andrews")


def test_the_users_interrupt_is_not_swallowed():
    def force(t, q, v):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        check(problem({"force": force}))


def test_a_problem_of_a_numpy_system_is_checked_without_touching_its_start():
    before = Q0.copy(), V0.copy()
    check(bead_problem())
    np.testing.assert_array_equal((Q0, V0), before)
    assert isinstance(bead_problem().system, NumpySystem)
