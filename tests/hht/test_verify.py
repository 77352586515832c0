"""``verify paper`` on coarse levels: its claims hold."""

from __future__ import annotations

import numpy as np
import pytest

from solvers.hht.verify import figures, paper
from solvers.hht.verify.measure import Case, refine
from solvers.hht.verify.study import ALPHAS
from tests.sample import slow

TEST1 = Case("jay_negrut_test1", 1.0, 10)
SOME_METHODS = [method for alpha in ALPHAS for method in paper.methods(alpha)][::3]  # `verify paper` measures all


@pytest.mark.parametrize(
    "method",
    [slow(x) if i % 2 else x for i, x in enumerate(SOME_METHODS)],
    ids=lambda m: f"{m['reaction']}-b{m['b']:g}-alpha{m['alpha']:.3g}",
)
def test_members_of_the_family_are_of_order_two(method):
    """Jay and Negrut (2007), Theorem 4.3 and figures 5.1, 5.2; a and v against f(t + alpha h) and the exact solution."""
    found = refine(TEST1, (50, 100, 200), **method).orders()
    assert found == pytest.approx(dict.fromkeys("qva", 2.0), abs=0.06)


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


def test_rows_of_the_verification_hold():
    """Figures 5.3 and 5.4, Theorem 4.3, orders of stage multipliers, remark 4.2, and both levels to roundoff."""
    rows = [row for alpha in ALPHAS for row in paper.variable_steps(TEST1, alpha, 0.3, (20, 40), (320, 640))]
    rows += [row for alpha in ALPHAS for row in paper.local_errors(TEST1, alpha, 0.002, count=3)]
    rows += [row for alpha in (0.0, -0.3) for row in paper.multipliers(TEST1, alpha, (100, 200, 400))]
    rows += [paper.multiplier_guess(TEST1, (1.0, 0.7, 0.9, 1.1), 0.01), *paper.drift(TEST1, 200, paper.REACTIONS)]
    assert len(rows) > 36
    assert [row.claim for row in rows if not row.passed] == []


@pytest.mark.parametrize("rescale_a", [True, False])
def test_steps_of_one_to_five_keep_the_order(rescale_a):
    """They lose it without (H11)."""
    lengths = [np.tile([1.0, 0.2], n) / (1.2 * n) for n in (160, 320, 640)]
    found = refine(TEST1, lengths, alpha=-0.3, b=0.3, reaction="implicit", rescale_a=rescale_a).orders()
    assert found["v"] == pytest.approx(2.0, abs=0.1) if rescale_a else found["v"] < 1.7
