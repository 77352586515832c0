"""Every solver of the bench, held to all checks; what is known to fail is named with its reason."""

from __future__ import annotations

import pytest

from hhtbench.conformance import check_names, check_solver
from hhtbench.conformance.parametrize import as_parameter
from tests.testing.claims import CLAIMS, claims_of

SLOW = ("diffrax", "collocation")  # `python -m tests.faults --sound` holds them to the checks
SOLVERS = tuple(spec for spec in CLAIMS if spec not in SLOW)


def parameters(*solvers):
    return [as_parameter(check, f"{spec}: ") for spec in solvers for check in check_solver(spec, **claims_of(spec))]


@pytest.mark.parametrize("check", parameters(*SOLVERS))
def test_solver(check):
    verdict = check.run()
    assert verdict.kind.good, verdict.message


def test_there_are_at_least_sixty_checks_of_different_names():
    names = check_names()
    assert len(names) == len(set(names)) >= 60
