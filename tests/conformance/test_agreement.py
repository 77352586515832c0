"""Solvers are compared two by two, whether or not the solution is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.conformance import agreement, assert_solvers_agree
from hhtbench.conformance.scenes.pendulum import pendulum
from tests.conformance.faulty import faulty, larger_by_three_percent

UNKNOWN = replace(pendulum().problem, exact=None)
SOLVERS = ("hht", "rattle", "ida(form=index1)", "projected")


def test_good_solvers_agree_on_a_problem_without_reference_at_every_level():
    found = assert_solvers_agree(UNKNOWN, SOLVERS, rtol=1e-5, levels=("position", "velocity", "acceleration"))
    assert found.names == SOLVERS
    np.testing.assert_array_equal(found.matrix, found.matrix.T)
    assert 0 < found.spread < 1e-2


def test_the_spread_is_an_estimate_of_the_largest_error():
    found = agreement(UNKNOWN, ("projected", "hht", "cvode"), rtol=1e-5)
    known = pendulum()
    solution = hb.solve(UNKNOWN, "cvode", rtol=1e-5, t_eval=np.linspace(*UNKNOWN.t_span, 11))
    motions = [known.exact(t) for t in solution.t]
    error = max(np.max(np.abs(getattr(solution, x) - [getattr(m, x) for m in motions])) for x in ("q", "v"))
    assert error / 3 < found.spread < 3 * error


def test_who_disagrees_is_named_and_the_matrix_shown():
    with pytest.raises(AssertionError, match=r"honest and (projected|hht) differ by") as caught:
        assert_solvers_agree(UNKNOWN, ("projected", "hht", faulty(larger_by_three_percent)), rtol=1e-4)
    assert "largest difference" in str(caught.value)
    assert "hht and projected differ" not in str(caught.value)


def test_who_does_not_reach_the_end_is_no_agreement():
    with pytest.raises(AssertionError, match=r"ida\(form=index2\) ends with declined: the form index2"):
        assert_solvers_agree("oscillator_chain", ("hht", "ida(form=index2)"), rtol=1e-4)


def test_wrong_use_is_told():
    with pytest.raises(hb.ProblemError, match="two or more"):
        assert_solvers_agree(UNKNOWN, ("hht",))
    with pytest.raises(hb.ProblemError, match="some of position, velocity, acceleration; got jerk"):
        assert_solvers_agree(UNKNOWN, ("hht", "ida"), levels=("jerk",))
