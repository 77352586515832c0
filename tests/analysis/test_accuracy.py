from __future__ import annotations

from dataclasses import replace

import pytest

from hhtbench.campaign.analysis import by_problem, convergence, points
from hhtbench.campaign.analysis.cells import typical
from tests.analysis.laws import failed, run


def _quadratic(*steps, solver="hht(alpha=0)"):
    rows = []
    for step in steps:
        request = {"rtol": None, "atol": None, "step": step, "steps": None}
        rows.append(run(solver, step, 3 * step**2, 1 / step, request=request))
    return rows


def test_slope_of_a_power_law_is_its_power():
    (curve,) = convergence(_quadratic(0.1, 0.05, 0.025))
    assert (curve.kind, curve.entry) == ("step", "hht(alpha=0), steps=N")
    assert curve.slope.value == pytest.approx(2.0)
    assert (curve.slope.count, curve.slope.spread) == (3, pytest.approx(0.0, abs=1e-12))


def test_slope_against_a_number_of_steps_is_taken_against_the_step():
    rows = [
        replace(row, request={"rtol": None, "atol": None, "step": None, "steps": round(1 / row.request["step"])})
        for row in _quadratic(0.1, 0.05, 0.025)
    ]
    (curve,) = convergence(rows)
    assert curve.kind == "steps"
    assert curve.slope.value == pytest.approx(2.0)


def test_slope_leaves_out_what_failed_and_what_the_reference_cannot_judge():
    rows = _quadratic(0.1, 0.05, 0.025, 0.0125)
    rows.append(run("hht(alpha=0)", 1e-3, 1.0, 1e3, request={"step": 1e-3}, status="unreliable"))
    floor = run("hht(alpha=0)", 1e-4, 1e-7, 1e4, request={"step": 1e-4})
    rows = [replace(row, metrics={"errors": row.metrics["errors"] | {"digits": 6}}) for row in [*rows, floor]]
    (curve,) = convergence(rows)
    assert curve.slope.value == pytest.approx(2.0)
    assert curve.slope.count == 4
    assert len(curve.points) == 6


def test_slope_leaves_out_errors_above_a_tenth():
    (curve,) = convergence([*_quadratic(0.1, 0.05, 0.025), run("hht(alpha=0)", 1.0, 0.11, 1, request={"step": 1.0})])
    assert (curve.slope.count, curve.slope.value) == (3, pytest.approx(2.0))
    assert convergence(_quadratic(0.1, 0.05))[0].slope is None, "two points fit any line"


def test_every_row_is_a_point_and_a_failed_one_has_no_error():
    rows = [*_quadratic(0.1, 0.05), failed("ida", 1e-3), run("ida", 1e-4, 1e-4, 100, status="unreliable")]
    curves = by_problem(points(rows))["pendulum"]
    assert sorted(item.key for runs in curves.values() for item in runs) == sorted(row.key for row in rows)
    assert [(item.error, item.doubted) for item in curves["ida"]] == [(None, None), (None, 1e-4)]


def test_error_of_a_run_is_the_larger_of_q_and_v():
    row = run("ida", 1e-3, 1e-3, 100)
    row.metrics["errors"]["v"] = {"max_scaled": 5e-3, "end_scaled": 1.0}
    assert points([row])[0].error == 5e-3


def test_error_of_observables_counts_where_neither_q_nor_v_is_known():
    observed = {"tip": {"max_scaled": 1e-3}, "angle": {"max_scaled": 2e-3}}
    row = run("ida", 1e-3, 1e-3, 100, metrics={"errors": {"against": "reference", "digits": 8, "observables": observed}})
    assert points([row])[0].error == 2e-3


def test_time_is_the_best_one_alone_and_else_says_that_it_was_not():
    alone = points([run("ida", 1e-3, 1e-3, 100, timing={"solve_s": 7.0, "best_s": 1e-3})])[0]
    beside = points([run("ida", 1e-3, 1e-3, 100, timing={"solve_s": 7.0, "best_s": None})])[0]
    assert (alone.time, alone.alone) == (1e-3, True)
    assert (beside.time, beside.alone) == (7.0, False)


def test_multiplier_errors_stand_with_every_row():
    row = run("ida", 1e-3, 1e-3, 100)
    row.metrics["errors"]["lam"] = {"max_scaled": 0.25}
    assert [(item.lam, item.mu) for item in points([row, failed("ida", 1e-4)])] == [(0.25, None), (None, None)]


def test_typical_run_is_nearest_to_1e_4_and_a_failed_one_where_none_succeeded():
    rows = [run("ida", setting, setting, 100) for setting in (1e-2, 2e-4, 1e-6)]
    assert typical(points(rows)).error == 2e-4
    assert typical(points([failed("ida", 1e-3)])).status == "newton_failed"
