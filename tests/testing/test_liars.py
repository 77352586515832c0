"""Solvers that say success and are wrong are found, by the check that is meant for it."""

from __future__ import annotations

import pytest

from hhtbench.conformance import Kind, check_solver
from tests.testing.liars import LIARS, Honest


def run(solver, name):
    (check,) = (check for check in check_solver(solver) if check.name == name)
    return check.run()


@pytest.mark.parametrize("liar", LIARS, ids=lambda kind: kind.__name__)
def test_every_liar_fails_the_check_that_the_honest_one_passes(liar):
    name = LIARS[liar]
    assert run(Honest(), name).kind is Kind.passed
    found = run(liar(), name)
    assert found.kind is Kind.failed, found
    assert found.message
