"""Every solver of the bench, held to all checks; what is known to fail stands beside the entry, with its reason."""

from __future__ import annotations

import pytest

from hhtbench.conformance import check_names, check_solver
from tests.conformance.claims import CLAIMS, claims_of

SLOW = ("diffrax", "collocation")  # `python -m tests.faults --sound` holds them to the checks


def parameters(*solvers):
    checks = [(spec, check) for spec in solvers for check in check_solver(spec, **claims_of(spec))]
    return [pytest.param(check, id=f"{spec}: {check}") for spec, check in checks]


@pytest.mark.parametrize("check", parameters(*(spec for spec in CLAIMS if spec not in SLOW)))
def test_solver(check):
    found = check.run()
    assert found.kind.good, found.message


def test_there_are_at_least_sixty_checks_of_different_names():
    names = check_names()
    assert len(names) == len(set(names)) >= 60
