"""``hhtbench verify control``: its judgement, from runs made by hand."""

from hhtbench.solution.result import Status
from solvers.hht.verify import control
from solvers.hht.verify.control import TOLERANCES
from solvers.hht.verify.measure import Run


def made(spec, factors, rejected=0):
    errors = [None if f is None else f * tolerance for f, tolerance in zip(factors, TOLERANCES, strict=True)]
    status = Status.success
    return [Run(spec, x, error, status, 100, rejected) for x, error in zip(TOLERANCES, errors, strict=True)]


def verdicts(*library):
    return {row.id: row.passed for row in (*control.problem_rows(library), *control.overall_rows(library))}


def test_errors_that_follow_the_tolerance_hold_whatever_their_constant():
    found = verdicts(made("a", [40, 40, 40, 40, 40]), made("b", [0.1, 0.2, 0.1, 0.2, 0.1]))
    assert found["ratio/all"]
    assert found["slope/a"]
    assert found["slope/b"]
    assert found["rejected/all"]
    assert found["ratio/a"] is None, "shown, not judged"


def test_errors_that_stay_behind_the_tolerance_fail():
    behind = made("a", [1, 10, 100, 1_000, 10_000])  # the error does not fall at all
    found = verdicts(behind)
    assert found["slope/a"] is False
    assert found["ratio/all"] is False


def test_failed_runs_count_against_the_share_and_rejections_against_theirs():
    found = verdicts(made("a", [1, 1, 1, 1, None], rejected=30))
    assert found["ratio/all"] is False, "four of five are below nine of ten"
    assert found["rejected/all"] is False
    assert verdicts(made("a", [1, 1, 1, 1, 1e-9]))["ratio/all"], "roundoff is as good as it gets"
