"""Multipliers that are nan: believed where the constraints lose rank, and left out of errors that say so; nowhere else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

import hhtbench as hb
from hhtbench import Request, Solution
from hhtbench.campaign.metrics import measure
from hhtbench.checks.result.judge import judge
from tests.trust.faulty import Returning

BARS = hb.load_problem("four_bars(n_windows=1, t_end=1.0)")
FLAT = brentq(lambda t: BARS.exact(t).q[2], 0.6, 0.8)  # [s]: the bars are horizontal
BESIDE = FLAT + np.array([-1e-6, -1e-8, 0.0, 1e-8, 1e-6])
ASKED = Request(rtol=1e-6, t_eval=np.array([0.0, 0.1, 0.3, *BESIDE, 0.8, 1.0]))
ROWS = slice(3, 8)  # those beside


@pytest.fixture(scope="module")
def made() -> Solution:
    """A solution that says of rows beside a singular position that their multipliers are not known."""
    return without(hb.load_solver("hht").solve(BARS, ASKED), slice(3, 8))


def without(made: Solution, rows: Any, value: float = np.nan) -> Solution:
    lam = made.lam.copy()
    lam[rows] = value
    return replace(made, lam=lam)


def test_rows_without_multipliers_beside_a_singular_position_are_believed(made: Solution):
    assert np.flatnonzero(made.unknown).tolist() == [3, 4, 5, 6, 7]
    found = judge(BARS, ASKED, made)
    assert (found.doubt, found.not_judged) == ("", "")
    assert hb.solve(BARS, Returning(made), rtol=1e-6, t_eval=ASKED.t_eval).success


@pytest.mark.parametrize("rows", [1, -1, slice(None)], ids=["one", "last", "all"])
def test_elsewhere_they_are_not(made: Solution, rows: Any):
    found = hb.solve(BARS, Returning(without(made, rows)), rtol=1e-6, t_eval=ASKED.t_eval)
    for doubt in (judge(BARS, ASKED, without(made, rows)).doubt, found.message):
        assert doubt.startswith("finiteness: multipliers are nan in row")
    assert found.status is hb.Status.unreliable


def test_multipliers_of_redundant_constraints_are_known_although_their_rank_is_always_low():
    problem = hb.load_problem("redundant_pendulum")
    asked = Request(rtol=1e-4, t_eval=np.linspace(*problem.t_span, 21))
    solution = hb.load_solver("hht").solve(problem, asked)
    assert judge(problem, asked, without(solution, 5)).doubt.startswith("finiteness: ")


def test_infinite_multipliers_are_nowhere_believed(made: Solution):
    assert judge(BARS, ASKED, without(made, ROWS, np.inf)).doubt == "finiteness: lam is not finite in row 3 of 10."


def test_errors_and_drift_leave_them_out_and_say_how_many(made: Solution):
    metrics = measure(BARS, replace(made, carried={"lam": made.lam, "mu": made.mu})).metrics
    for name in ("lam", "lam_carried"):
        assert metrics["errors"][name]["unknown"] == 5
        assert 1e-8 < metrics["errors"][name]["max_scaled"] < 1e-4
    assert "unknown" not in metrics["errors"]["q"]
    assert 0.0 < metrics["drift"]["acceleration"] < 1e-5  # between steps lam is a blend, (H60)
    assert metrics["drift"]["acceleration_note"] == "where its multipliers are nan, in 5 of 10 rows"


def test_no_multiplier_at_all_is_no_small_error(made: Solution):
    none = without(made, slice(None))
    metrics = measure(BARS, replace(none, carried={"lam": none.lam, "mu": none.mu})).metrics
    for name in ("lam", "lam_carried"):
        assert (metrics["errors"][name]["max_scaled"], metrics["errors"][name]["unknown"]) == (None, 10)
    assert metrics["drift"]["acceleration"] is None


def test_coordinates_that_are_nan_are_left_out_of_nothing(made: Solution):
    q = made.q.copy()
    q[2] = np.nan
    assert measure(BARS, replace(without(made, 2), q=q)).metrics["errors"]["q"]["max"] is None
