"""The study of ``accuracy``: what its rows say of cells that are right, wrong, unshown, too costly."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.conformance.accuracy import Cell, cells_of, evidence_of, truth

GOOD = Cell(problem="p", solver="hht", accuracy=1e-3, status="success", error=3e-4, bound=5e-4, cost=4.0, extrapolated=1e-4)


def failed(cells):
    return {row.id.partition("/")[2] for row in evidence_of(cells).rows if row.passed is False}


@pytest.mark.parametrize(
    ("changes", "share", "claims"),
    [
        ({}, 1.0, set()),
        ({"error": 2e-3}, 0.04, set()),
        ({"error": 2e-3}, 0.06, {"within"}),
        ({"error": 4e-3}, 0.02, {"beyond"}),
        ({"status": "accuracy_not_shown", "cost": None}, 0.09, set()),
        ({"status": "accuracy_not_shown", "cost": None}, 0.11, {"unshown"}),
        ({"error": 1e-5, "extrapolated": 1e-6}, 0.6, {"size"}),
        ({"cost": 6.0}, 0.6, {"cost"}),
        ({"cost": 9.0}, 0.2, {"cost90"}),
        ({"extrapolated": 9e-4}, 0.6, {"better"}),
    ],
)
def test_a_claim_fails_where_too_many_cells_break_it(changes, share, claims):
    count = round(100 * share)
    cells = [GOOD] * (100 - count) + [replace(GOOD, **changes)] * count
    assert failed(cells) == claims


def test_cells_beyond_three_times_what_was_asked_are_named():
    rows = evidence_of([GOOD, replace(GOOD, problem="worse", error=4e-3)]).rows
    assert any("worse at 0.001: 4.0e-03" in row.claim for row in rows)


def test_the_truth_is_a_closed_solution_or_a_certified_reference():
    times, known = truth(hb.load_problem("simple_pendulum"))
    assert known.shape == (times.size, 4)
    problem = hb.load_problem("andrews")
    times, known = truth(problem)
    at = np.flatnonzero(np.asarray(problem.reference["t"]) == times[-1])[0]
    np.testing.assert_allclose(known[-1, :7] * problem.scales.q, problem.reference["q"][at])


def test_cells_of_a_problem_hold_what_was_measured():
    cells = cells_of("jay_negrut_test1")  # its reaction is nonlinear: the solvers of the underlying ODE decline it
    assert {cell.solver for cell in cells} == {"hht", "ida(form=ggl)"}
    assert all(cell.error < cell.accuracy for cell in cells if cell.status == "success")
    assert all(cell.cost > 1 for cell in cells if cell.status == "success")
