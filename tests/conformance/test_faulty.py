"""Solvers that say success and are wrong are found, by the check that is meant for it."""

from __future__ import annotations

import pytest

from hhtbench.conformance import Kind, check_solver
from tests.conformance.faulty import FAULTS, Honest, faulty


def run(solver, name):
    (check,) = (check for check in check_solver(solver) if check.name == name)
    return check.run()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.__name__)
def test_every_faulty_solver_fails_the_check_that_the_honest_one_passes(fault):
    name = FAULTS[fault]
    assert run(Honest(), name).kind is Kind.right
    found = run(faulty(fault), name)
    assert found.kind.misleading, found
    assert found.message
