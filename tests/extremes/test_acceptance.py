"""Every fast row of the acceptance matrix: it holds, or the solver says why it cannot be asked."""

import pytest

from hhtbench.studies.acceptance.asked import ASKED
from hhtbench.studies.acceptance.rows import CORE, Verdict
from hhtbench.studies.acceptance.study import all_rows, chosen_rows

FAST = [x for x in chosen_rows((), long=False) if x.measure]
HERE = [asked for asked in ASKED if asked.name in ("hht", "ida")]  # the other columns are the study's: they take minutes
KNOWN = {  # (row, solver) -> why it fails; one that no longer fails has to be taken out
    ("M12", "ida"): "errors of 40 tolerances",
    ("P1", "ida"): "errors of up to 0.09 at a tolerance of 1e-5 from 1e6 N/m on",
    ("P8", "hht"): "the KKT matrix passes for singular where rows of constraints are 1e50 times the mass",
    ("P8", "ida"): "the same",
    ("P9", "ida"): "no warning of an absolute tolerance beyond the solution",
    ("R9", "ida"): "a jump of the force to 1e12 ends in time_resolution",
}


@pytest.mark.parametrize("asked", HERE, ids=lambda asked: asked.name)
@pytest.mark.parametrize("row", FAST, ids=lambda row: row.id)
def test_a_row_of_the_matrix_holds(row, asked):
    outcome = row.outcome(asked, timed=False)
    failing = outcome.verdict is Verdict.fails
    assert failing == ((row.id, asked.name) in KNOWN), outcome.measured
    if asked.name == "hht":
        assert outcome.verdict is not Verdict.undecided, outcome.measured


def test_no_row_of_the_matrix_is_missing():
    letters = {"M": 15, "I": 8, "C": 15, "O": 7, "S": 9, "P": 14, "J": 5, "E": 2, "R": 9, "A": 3, "K": 12}
    assert set(all_rows()) == {f"{letter}{k}" for letter, most in letters.items() for k in range(1, most + 1)}
    assert set(all_rows()) >= CORE
