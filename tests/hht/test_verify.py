"""``verify paper`` on coarse levels: its claims hold, and each kind of row fails when the method is broken."""

from __future__ import annotations

import pytest

from solvers.hht.equations import known
from solvers.hht.verify import figures, paper
from solvers.hht.verify.measure import Case, refine
from solvers.hht.verify.study import ALPHAS
from tests.hht.scenes import forget_code

TEST1 = Case("jay_negrut_test1", 1.0, 10)
ALL_METHODS = [method for alpha in ALPHAS for method in paper.methods(alpha)]


@pytest.mark.parametrize("method", ALL_METHODS, ids=lambda m: f"{m['reaction']}-b{m['b']:g}-alpha{m['alpha']:.3g}")
def test_every_member_of_the_family_is_of_order_two(method):
    """Jay and Negrut (2007), Theorem 4.3 and figures 5.1, 5.2; a and v against f(t + alpha h) and the exact solution."""
    found = refine(TEST1, (50, 100, 200), **method).orders()
    assert found == pytest.approx(dict.fromkeys("qva", 2.0), abs=0.06)


def test_alternating_steps_lose_an_order_without_rescaling_and_keep_it_with():
    """Figures 5.3 and 5.4."""
    rows = [row for alpha in ALPHAS for row in paper.variable_steps(TEST1, alpha, 0.3, (20, 40), (320, 640))]
    assert len(rows) == 15
    assert all(row.passed for row in rows)


@pytest.mark.parametrize(
    ("study", "case"),
    [(figures.test1_figures, TEST1), (figures.pendulum_figures, paper.PENDULUM)],
    ids=["test1", "pendulum"],
)
def test_errors_equal_those_of_an_independent_implementation(study, case):
    """Stored errors of a separate plain implementation of (3.4), kept with six to seven digits."""
    agreement, *_ = study(case)
    assert agreement.passed
    assert 1e-8 < agreement.measured < 1e-6, "what is compared is what is stored, to its digits"


def test_local_errors_have_the_orders_of_theorem_4_3():
    rows = [row for alpha in ALPHAS for row in paper.local_errors(TEST1, alpha, 0.002, count=3)]
    assert len(rows) == 15
    assert all(row.passed for row in rows)


def test_stage_multipliers_are_first_order_their_mean_and_the_recovered_ones_second():
    assert all(row.passed for alpha in (0.0, -0.3) for row in paper.multipliers(TEST1, alpha, (100, 200, 400)))


def test_the_result_does_not_depend_on_the_starting_multiplier():
    """Remark 4.2."""
    assert paper.multiplier_guess(TEST1, (1.0, 0.7, 0.9, 1.1), 0.01).passed


@pytest.mark.parametrize("name", ["knife_edge", "rolling_disk3d_steady"], ids=["velocity-level", "mixed"])
def test_velocity_level_and_mixed_constraints_keep_order_two(name):
    """(6.1), and both kinds together."""
    keys = ("q", "v", "mu") if name == "knife_edge" else ("q", "v", "lam", "mu")
    found = refine(Case(name, 1.0, 20), (400, 800, 1600), alpha=-0.05, b=0.0).orders(keys)
    assert found == pytest.approx(dict.fromkeys(keys, 2.0), abs=0.06)


def test_both_levels_are_held_to_roundoff_at_every_step():
    rows = paper.drift(TEST1, 200, paper.REACTIONS)
    assert len(rows) == 6
    assert all(row.passed for row in rows)


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_a_wrong_weight_is_seen_as_a_lost_order(monkeypatch, factor):
    """The order test can fail: one percent in one weight is enough."""
    honest = known.weighted

    def bent(*arguments):
        values = honest(*arguments)
        return {**values, "v_a": values["v_a"] * factor}

    monkeypatch.setattr(known, "weighted", bent)
    forget_code(monkeypatch)
    found = refine(TEST1, (50, 100, 200), alpha=-0.15, b=0.0).orders()
    assert min(found["q"], found["v"]) < 1.5
