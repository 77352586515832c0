"""Every row of the acceptance matrix: it holds, or the solver says why it cannot be asked; and how rows are judged."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from hhtbench.conformance.acceptance import Acceptance, measured, study_acceptance
from hhtbench.conformance.entry import Kind, Lane
from hhtbench.conformance.entry import tested as held_by_tests
from hhtbench.conformance.registry import ROWS
from hhtbench.conformance.rows.judging import judged, row, within
from hhtbench.conformance.subject import Declined, Subject
from hhtbench.protocol.errors import NotFoundError
from hhtbench.solution.result import Counters, Status
from solvers._ending import empty_solution
from solvers._start import Failure

BY_ID = {entry.id: entry for entry in ROWS}
CHEAP = {  # rows that plain Python measures in less than half a second each
    *("M6", "I1", "I2", "I4", "I6", "C1", "C6", "O1", "O2", "O3", "O4", "O7"),
    *("S1", "S4", "S5", "S7", "S8", "P6"),
}
BY_DEADLINES = {("J2", "ida"), ("P1", "ida")}  # the machine decides
# Seconds each, and held beside them: NaN by tests/hht/test_callbacks.py, the orders and what IDA does by claims.
SECONDS = {
    ("C2", "hht"),
    ("M7", "hht"),
    ("M3", "hht"),
    ("P12", "hht"),
    ("P12", "ida"),
    *((x, "ida") for x in ("C2", "J1", "P7", "R5", "R6", "S6")),
}


def parameters():
    for name in ("hht", "ida", "hht in Python"):  # the other columns are the study's: they take minutes
        for entry in ROWS:
            if entry.measure and (name != "hht in Python" or entry.id in CHEAP):
                slow = entry.lane is Lane.slow or (entry.id, name) in BY_DEADLINES | SECONDS
                yield pytest.param(entry, name, id=f"{entry.id}-{name}", marks=pytest.mark.long if slow else ())


@pytest.fixture(scope="module")
def subject():
    made = {}
    return lambda name: made.setdefault(name, Subject.column(name))


@pytest.mark.parametrize(("entry", "name"), [*parameters()])
def test_a_row_of_the_matrix_holds(entry, name, subject):
    outcome = measured(entry, subject(name), timed=False)
    assert outcome.kind.good, outcome.message
    if subject(name).is_hht:
        assert outcome.kind is not Kind.declined, outcome.message


class Failing:
    """Always ends at once, with one status."""

    name = "failing"

    def __init__(self, status):
        self.status = status

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        return empty_solution(problem.q0.size, Failure(self.status, "no step goes on"), Counters())


@pytest.mark.parametrize("status", [Status.newton_failed, Status.deadline, Status.nonfinite_callback])
def test_a_solver_that_always_fails_does_not_pass_the_random_cases(status):
    outcome = BY_ID["R8"].run(Subject(Failing(status)))
    assert outcome.kind is Kind.wrong
    assert len(outcome.failing) > 100


def test_no_row_of_the_matrix_is_missing():
    letters = {"M": 15, "I": 8, "C": 15, "O": 7, "S": 9, "P": 14, "J": 5, "E": 2, "R": 9, "A": 3, "K": 12}
    assert [entry.id for entry in ROWS] == [f"{x}{k}" for x, most in letters.items() for k in range(1, most + 1)]


def test_the_tests_that_rows_name_are_there():
    root = Path(__file__).parents[2]
    named = [test.partition("::") for entry in ROWS for test in entry.tests]
    for file, _, name in named:
        assert f"def {name}(" in (root / file).read_text() if name else (root / file).is_file(), name
    assert len(named) > 20


@pytest.mark.parametrize(
    ("cases", "holds", "failing"),
    [
        ({"a": "", "b": within(1.0, 2.0)}, True, ()),
        ({"a": "off", "b": ""}, False, ("a",)),
        ({"a": within(3.0, 2.0), "b": within(math.nan, 2.0)}, False, ("a", "b")),
        ({"a": Declined("no"), "b": ""}, False, ("a",)),
        ({}, False, ()),
    ],
)
def test_a_row_holds_where_every_case_does_and_there_is_one(cases, holds, failing):
    found = judged(iter(cases.items()), Subject("hht"))
    assert (found.holds, found.failing) == (holds, failing)


def test_a_row_is_declined_where_every_case_is():
    with pytest.raises(Declined, match="no"):
        judged(iter({"a": Declined("no"), "b": Declined("no")}.items()), Subject("hht"))


def test_some_cases_may_fail_where_a_row_allows_a_share():
    cases = {str(k): "off" if k < 5 else "" for k in range(100)}
    assert [judged(iter(cases.items()), Subject("hht"), most_failing=x).holds for x in (0.05, 0.04)] == [True, False]


def test_a_row_asks_hht_in_every_way_and_tells_the_largest_number_and_the_slowest_solve():
    @row("M1", "in", "out", seconds=1e-9)
    def measure(subject, request):
        subject.took.append(0.5)
        yield "one", within(request["alpha"], 0.1, "alpha")

    found = measure(Subject("hht"))
    assert found.measured == "4 of 4 cases; alpha 0 of 0.1 allowed; slowest 0.5 s of 1e-09 allowed"
    assert found.holds and not found.in_time
    assert measure.entry.run(Subject("hht")).kind is Kind.wrong
    assert measure.entry.run(Subject("hht"), timed=False).kind is Kind.right


def test_the_summary_counts_the_ways_in_which_rows_end_and_names_the_slow_ones():
    def measure(subject):
        yield "a", within(subject.took.append(0.0) or 1.0, 2.0)

    whole, part = (held_by_tests(name, "in", "out", "tests/x.py", gap=gap) for name, gap in (("K1", ""), ("K5", "the rest")))
    slow = row("M1", "in", "out", lane=Lane.slow, gap="more")(measure).entry
    wrong = row("M2", "in", "out")(lambda subject: iter([("a", "off")])).entry
    known = replace(wrong, id="M3", known={"hht": (("a",), "rounding")})
    outgrown = replace(slow, id="M4", gap="", known={"hht": (("a",), "rounding")})
    rows, subject = (whole, part, slow, wrong, known, outgrown), Subject.column("hht")
    found = Acceptance(rows=rows, outcomes=tuple(measured(x, subject) for x in rows))
    assert [x.kind.name for x in found.outcomes] == ["elsewhere", "in_part", "in_part", "wrong", "expected", "unexpected"]
    assert [x.message.partition("not shown: ")[2] for x in found.outcomes[:3]] == ["", "the rest", "more"]
    assert not found.passed and Acceptance(rows=rows[:3], outcomes=found.outcomes[:3]).passed
    assert found.summary.splitlines() == [
        "hht: 0 rows hold, 1 wrong (M2), 2 in part (K5, M1), 1 tests (K1), 1 fails as expected (M3), "
        "1 passes unexpectedly (M4), 0 cannot be asked",
        "in the slow lane: M1, M4",
    ]


def test_the_study_takes_rows_by_id_or_letter_and_knows_no_others():
    found = study_acceptance(["O7", "A"], ["hht"], slow=False)
    assert [x.id for x in found.rows] == ["O7", "A2", "A3"]
    assert [(x.id, x.kind.name) for x in found.outcomes] == [("O7", "right"), ("A2", "right"), ("A3", "elsewhere")]
    with pytest.raises(NotFoundError, match="no row Z1"):
        study_acceptance(["Z1"])


@pytest.mark.parametrize(
    ("body", "kind", "text"),
    [("pass", "right", "1 passed"), ("assert 0", "wrong", "1 failed"), ("pytest.skip()", "in_part", "1 skipped")],
)
def test_a_row_that_tests_hold_tells_how_they_end(body, kind, text, tmp_path):
    file = tmp_path / "test_it.py"
    file.write_text(f"import pytest\ndef test_one(): {body}\n")
    outcome = held_by_tests("K1", "in", "out", f"{file}::test_one").run(Subject("hht"), run_tests=True)
    assert (outcome.kind.name, outcome.message.partition(" in ")[0]) == (kind, text)
    assert ("; not shown: SKIPPED [1]" in outcome.message) is (kind == "in_part")
    assert [name.endswith("test_it.py::test_one") for name in outcome.failing] == [True] * (kind == "wrong")
