"""Checks say what they measure, are strict about what is expected to fail, and need no pytest."""

from __future__ import annotations

import subprocess
import sys
from unittest import SkipTest

import jax.numpy as jnp
import pytest

import hhtbench as hb
from hhtbench.conformance import Check, Kind, assert_solver_converges, check_problem, check_solver, parametrize_with_checks
from hhtbench.conformance.entry import Finding, as_known, claim, outcome_of
from hhtbench.conformance.registry import CLAIMS, FAMILIES
from hhtbench.conformance.subject import Subject
from tests.conformance.faulty import faulty, straight_on


def passes():
    pass


def breaks():
    raise AssertionError("it is 3, not 4")


def declines():
    raise SkipTest("not this one")


def test_a_check_raises_where_its_claim_fails_and_says_what_was_measured():
    Check("good", "it holds", passes)()
    with pytest.raises(AssertionError, match="bad: it is 3, not 4"):
        Check("bad", "it holds", breaks)()
    with pytest.raises(SkipTest, match="not this one"):
        Check("other", "it holds", declines)()


def test_passing_unexpectedly_is_a_failure_and_failing_as_expected_is_none():
    unexpected = Check("good", "it holds", passes, expected_failed="it never did")
    assert unexpected.run().kind is Kind.unexpected
    with pytest.raises(AssertionError, match="expected to fail \\(it never did\\)"):
        unexpected()
    assert Check("bad", "it holds", breaks, expected_failed="it never did").run().kind is Kind.expected
    assert Check("other", "it holds", declines, expected_failed="it never did").run().kind is Kind.declined


def test_whatever_a_solver_raises_is_a_failure_with_its_type():
    found = Check("bad", "it holds", lambda: {}["key"]).run()
    assert (found.kind, found.message) == (Kind.crashed, "KeyError: 'key'")


def test_expected_failures_must_exist_and_have_a_reason():
    with pytest.raises(ValueError, match=r"no check 'mixed/level'\. Did you mean mixed/levels"):
        check_solver("hht", {"mixed/level": "it drifts"})
    with pytest.raises(ValueError, match="mixed/levels needs a reason"):
        check_solver("hht", {"mixed/levels": ""})


def test_every_entry_has_a_sentence_and_a_name_of_its_own():
    entries = (*CLAIMS, *FAMILIES)
    assert len({(entry.lane, entry.id) for entry in entries}) == len(entries)
    for entry in entries:
        assert entry.sentence.endswith("."), entry.id


def test_what_the_registry_knows_to_fail_is_strict():
    passing = claim("it", parts=("one", "other"), known={"ida": (("one",), "it drifts")})(lambda subject, part: None).entry
    ida, other = Subject("ida"), Subject("cvode")
    found = [as_known(passing.run(ida, *case), passing.reason(ida, *case)).kind for case in passing.cases()]
    assert found == [Kind.unexpected, Kind.right]
    assert [passing.reason(other, *case) for case in passing.cases()] == ["", ""]


@pytest.mark.parametrize(
    ("failing", "kind"),
    [(("a", "b"), Kind.expected), (("a",), Kind.unexpected), ((), Kind.unexpected), (("a", "b", "c"), Kind.wrong)],
)
def test_a_row_fails_as_expected_in_just_the_cases_that_are_known(failing, kind):
    found = outcome_of(lambda: Finding(measured="", holds=not failing, failing=failing))
    assert as_known(found, "roundoff", ("a", "b")).kind is kind


def test_an_entry_declines_what_the_solver_lacks():
    named = {entry.id: entry for entry in CLAIMS}
    found = named["events/times"].run(Subject("ida"))
    assert (found.kind, found.message) == (Kind.declined, "ida has no with_events")


def test_nothing_here_imports_pytest_unless_it_is_used():
    code = (
        "import sys; from hhtbench.conformance import check_solver; check_solver('hht'); sys.exit('pytest' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_parameters_carry_strict_marks():
    mark = parametrize_with_checks([Check("a", "it", passes), Check("b", "it", breaks, expected_failed="known")])
    first, second = mark.args[1]
    assert (first.id, second.id) == ("a", "b")
    (xfail,) = second.marks
    assert (xfail.name, xfail.kwargs["strict"], xfail.kwargs["reason"]) == ("xfail", True, "known")


def test_convergence_is_judged_by_order_and_by_tolerance():
    assert_solver_converges("hht", order=2)
    assert_solver_converges("projected")
    with pytest.raises(AssertionError, match=r"falls to the power 2\.0. of the step"):
        assert_solver_converges("rattle", order=3)
    with pytest.raises(AssertionError, match=r"the error of q at rtol=0\.001"):
        assert_solver_converges(faulty(straight_on))
    with pytest.raises(AssertionError, match="takes none of the scenes"):
        assert_solver_converges("cvode", order=2)


def test_a_problem_keeps_its_promises():
    found = [check.run() for check in check_problem("simple_pendulum")]
    assert {"motion/agree", "motion/known"} <= {outcome.id for outcome in found}
    assert [outcome for outcome in found if not outcome.kind.good] == []


class WrongRow(hb.System):
    """A declared Jacobian with a wrong row."""

    def force(self, t, q, v):
        return jnp.array([-9.81, 0.0])

    def constraint(self, t, q):
        return q[:1] - 0.5 * q[1:]

    def constraint_jacobian(self, t, q):
        return jnp.array([[1.0, 0.5]])


@pytest.mark.filterwarnings("ignore:the declared constraint_jacobian")
def test_a_wrong_row_of_a_declared_jacobian_is_named():
    problem = hb.Problem(name="wrong", system=WrongRow(), t_span=(0.0, 0.1), q0=[0.5, 1.0], v0=[0.0, 0.0])
    found = {check.name: check.run() for check in check_problem(problem)}
    assert found["derivative/constraint_q"].kind is Kind.wrong
    expected = {"derivative/constraint_q": "the row is wrong on purpose"}
    again = {check.name: check.run() for check in check_problem(problem, expected)}
    assert again["derivative/constraint_q"].kind is Kind.expected
