"""Every fast row of the acceptance matrix: it holds, or the solver says why it cannot be asked."""

from dataclasses import dataclass, replace
from pathlib import Path

import pytest

from hhtbench.result import Counters, Status
from hhtbench.studies.acceptance import rows as matrix
from hhtbench.studies.acceptance.asked import ASKED, Asked
from hhtbench.studies.acceptance.rows import CORE, Verdict, bounded
from hhtbench.studies.acceptance.study import Acceptance, all_rows, chosen_rows
from solvers._ending import empty_solution
from solvers._start import Failure

FAST = [x for x in chosen_rows((), long=False) if x.measure]
HERE = [asked for asked in ASKED if asked.name in ("hht", "ida")]  # the other columns are the study's: they take minutes
PLAIN = next(asked for asked in ASKED if asked.name == "hht in Python")
CHEAP = {  # rows that plain Python measures in less than half a second each
    *("M2", "M5", "M6", "M11", "I1", "I2", "I4", "I6", "C1", "C6", "O1", "O2", "O3", "O4", "O7"),
    *("S1", "S4", "S5", "S7", "S8", "P6", "P11"),
}
ADAPTIVE = "alpha=0 adaptive", "alpha=-0.3 adaptive"
TINY = "4.9406564584124654e-324"
KNOWN = {  # (row, solver) -> the failing cases and why; one that no longer fails has to be taken out
    ("M3", "hht"): (
        {f"energy at w h = 1e+0{k}" for k in (4, 5, 6, 7, 8)},
        "h^2 a rounds to eps (w h)^2 of q, THEORY.md 8",
    ),
    ("M12", "ida"): ({"1e-07"}, "an error of 40 tolerances"),
    ("P9", "ida"): (
        {"warning", "from rest, atol default", "from rest, atol 1e-06"},
        "no warning of an absolute tolerance beyond the solution",
    ),
    ("S5", "ida"): (
        {f"0..{TINY} ", "0..1e-300 ", "1..1.0000000000000002 ", "1..0.99999999999999989 "},
        "IDA declines an interval whose end it takes for its start",
    ),
}
LONG = {  # the same of rows that take longer than tests may: `hhtbench study acceptance` measures them
    ("J2", "ida"): ({"1e6 alpha=None"}, "a Jacobian that is wrong by 1e6: at 6.6e-4 to 1.1e-2 s after 20 s"),
    ("R9", "ida"): ({"force Jacobian 1e6"}, "the same"),
    ("P1", "ida"): ({"1e6", "1e8", "1e12", "1e14"}, "errors of up to 0.09 at a tolerance of 1e-5"),
}


ROWS = [
    (row, asked) for asked in HERE for row in FAST if (row.id, asked.name) not in LONG
]  # by deadlines the machine decides
ROWS += [(row, PLAIN) for row in FAST if row.id in CHEAP]


@pytest.mark.parametrize(("row", "asked"), ROWS, ids=[f"{row.id}-{asked.name}" for row, asked in ROWS])
def test_a_row_of_the_matrix_holds(row, asked):
    outcome = row.outcome(asked, timed=False)
    cases, _ = KNOWN.get((row.id, asked.name), ((), ""))
    assert set(outcome.failing) == set(cases), outcome.measured
    if not cases:
        assert outcome.verdict is not Verdict.fails, outcome.measured
    if asked.is_hht:
        assert outcome.verdict is not Verdict.undecided, outcome.measured


@dataclass(frozen=True, kw_only=True)
class Failing(Asked):
    """A solver that always ends at once, with one status."""

    status: Status

    def solve(self, problem, **request):
        return empty_solution(problem.q0.size, Failure(self.status, "no step goes on"), Counters())


@pytest.mark.parametrize("status", [Status.newton_failed, Status.deadline, Status.nonfinite_callback])
def test_a_solver_that_always_fails_does_not_pass_the_random_cases(status):
    outcome = all_rows()["R8"].outcome(Failing(name="failing", spec="", status=status))
    assert outcome.verdict is Verdict.fails
    assert len(outcome.failing) > 100


def test_no_row_of_the_matrix_is_missing():
    letters = {"M": 15, "I": 8, "C": 15, "O": 7, "S": 9, "P": 14, "J": 5, "E": 2, "R": 9, "A": 3, "K": 12}
    assert set(all_rows()) == {f"{letter}{k}" for letter, most in letters.items() for k in range(1, most + 1)}
    assert set(all_rows()) >= CORE


def test_rows_that_hold_in_part_are_counted_apart_and_tell_what_they_do_not_show():
    whole, part = (matrix.tested(name, "in", "out", "tests/x.py", gap=gap) for name, gap in (("K1", ""), ("K5", "the rest")))
    measured = replace(whole, id="M1", measure=lambda asked: bounded(1.0, 2.0), gap="more", long=True)
    wrong = replace(measured, id="M2", measure=lambda asked: bounded(3.0, 2.0))
    rows = whole, part, measured, wrong
    found = Acceptance(rows=rows, outcomes=tuple(row.outcome(PLAIN) for row in rows))
    assert [x.verdict.name for x in found.outcomes] == ["elsewhere", "in_part", "in_part", "fails"]
    assert [x.measured.partition("not shown: ")[2] for x in found.outcomes] == ["", "the rest", "more", ""]
    assert found.summary.splitlines() == [
        "hht in Python: 0 rows hold, 1 have tests of their own, not run (K1), "
        "2 hold in part (K5, M1), 1 fail (M2), 0 cannot be asked",
        "measured by this study only, since tests may not take so long: M1, M2",
    ]


def test_the_tests_that_rows_name_are_there():
    root = Path(__file__).parents[2]
    named = [test.partition("::") for row in all_rows().values() for test in row.tests]
    for file, _, name in named:
        assert f"def {name}(" in (root / file).read_text() if name else (root / file).is_file(), name
    assert len(named) > 20


@pytest.mark.parametrize(
    ("body", "verdict", "told"),
    [("pass", "holds", "1 passed"), ("assert 0", "fails", "1 failed"), ("pytest.skip()", "in_part", "1 skipped")],
)
def test_a_row_that_tests_hold_tells_how_they_end(body, verdict, told, tmp_path):
    file = tmp_path / "test_it.py"
    file.write_text(f"import pytest\ndef test_one(): {body}\n")
    outcome = matrix.tested("K1", "in", "out", f"{file}::test_one").outcome(PLAIN, run_tests=True)
    assert (outcome.verdict.name, outcome.measured.partition(" in ")[0]) == (verdict, told)
    assert ("; not shown: SKIPPED [1]" in outcome.measured) is (verdict == "in_part")
    assert [name.endswith("test_it.py::test_one") for name in outcome.failing] == [True] * (verdict == "fails")
