"""Every fast row of the acceptance matrix: it holds, or the solver says why it cannot be asked."""

from dataclasses import replace
from pathlib import Path

import pytest

from hhtbench.conformance.acceptance import Acceptance, chosen_rows, measured
from hhtbench.conformance.entry import Kind, Lane, bounded, tested
from hhtbench.conformance.registry import ROWS
from hhtbench.conformance.subject import Subject
from hhtbench.result import Counters, Status
from solvers._ending import empty_solution
from solvers._start import Failure

FAST = [row for row in chosen_rows((), slow=False) if row.measure]
HHT, IDA, PLAIN = (Subject.column(name) for name in ("hht", "ida", "hht in Python"))
CHEAP = {  # rows that plain Python measures in less than half a second each
    *("M2", "M5", "M6", "M11", "I1", "I2", "I4", "I6", "C1", "C6", "O1", "O2", "O3", "O4", "O7"),
    *("S1", "S4", "S5", "S7", "S8", "P6", "P11"),
}
BY_DEADLINES = {"J2", "R9", "P1"}  # with IDA: which case fails the machine decides
HERE = [(row, HHT) for row in FAST]  # the other columns are the study's: they take minutes
HERE += [(row, IDA) for row in FAST if row.id not in BY_DEADLINES]
HERE += [(row, PLAIN) for row in FAST if row.id in CHEAP]


@pytest.mark.parametrize(("row", "subject"), HERE, ids=[f"{row.id}-{subject.name}" for row, subject in HERE])
def test_a_row_of_the_matrix_holds(row, subject):
    found = measured(row, subject, timed=False)
    assert found.kind.good, found.message
    assert not (subject.is_hht and found.kind is Kind.declined), found.message


class Failing:
    """A solver that always ends at once, with one status."""

    def __init__(self, status):
        self.name, self.status = f"always {status.name}", status

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        return empty_solution(problem.q0.size, Failure(self.status, "no step goes on"), Counters())


@pytest.mark.parametrize("status", [Status.newton_failed, Status.deadline, Status.nonfinite_callback])
def test_a_solver_that_always_fails_does_not_pass_the_random_cases(status):
    (row,) = chosen_rows(["R8"])
    found = row.run(Subject(Failing(status)))
    assert found.kind is Kind.wrong
    assert len(found.failing) > 100


def test_no_row_of_the_matrix_is_missing():
    letters = {"M": 15, "I": 8, "C": 15, "O": 7, "S": 9, "P": 14, "J": 5, "E": 2, "R": 9, "A": 3, "K": 12}
    assert [row.id for row in ROWS] == [f"{letter}{k}" for letter, most in letters.items() for k in range(1, most + 1)]


def test_rows_that_hold_in_part_are_counted_apart_and_say_what_they_do_not_show():
    whole, part = (tested(name, "in", "out", "tests/x.py", gap=gap) for name, gap in (("K1", ""), ("K5", "the rest")))
    good = replace(whole, id="M1", measure=lambda subject: bounded(1.0, 2.0), gap="more", lane=Lane.slow)
    wrong = replace(good, id="M2", measure=lambda subject: bounded(3.0, 2.0))
    rows = whole, part, good, wrong
    found = Acceptance(rows=rows, outcomes=tuple(row.run(PLAIN) for row in rows))
    assert [x.kind.name for x in found.outcomes] == ["elsewhere", "in_part", "in_part", "wrong"]
    assert [x.message.partition("not shown: ")[2] for x in found.outcomes] == ["", "the rest", "more", ""]
    first, second = found.summary.splitlines()
    for text in ("0 rows hold", "1 have tests of their own, not run (K1)", "2 hold in part (K5, M1)", "1 fail (M2)"):
        assert text in first
    assert second == "in the slow lane, measured by this study only: M1, M2"


def test_the_tests_that_rows_name_are_there():
    root = Path(__file__).parents[2]
    named = [test.partition("::") for row in ROWS for test in row.tests]
    for file, _, name in named:
        assert f"def {name}(" in (root / file).read_text() if name else (root / file).is_file(), name
    assert len(named) > 20


@pytest.mark.parametrize(
    ("body", "kind", "said"),
    [("pass", "right", "1 passed"), ("assert 0", "wrong", "1 failed"), ("pytest.skip()", "in_part", "1 skipped")],
)
def test_a_row_that_tests_hold_says_how_they_end(body, kind, said, tmp_path):
    file = tmp_path / "test_it.py"
    file.write_text(f"import pytest\ndef test_one(): {body}\n")
    found = tested("K1", "in", "out", f"{file}::test_one").run(PLAIN, run_tests=True)
    assert (found.kind.name, found.message.partition(" in ")[0]) == (kind, said)
    assert ("; not shown: SKIPPED [1]" in found.message) is (kind == "in_part")
    assert [name.endswith("test_it.py::test_one") for name in found.failing] == [True] * (kind == "wrong")
