"""Every solver of the bench, held to all checks; what is known to fail is named with its reason."""

from __future__ import annotations

import pytest

from hhtbench.testing import check_names, check_solver
from hhtbench.testing.parametrize import as_parameter

CLAIMS = {
    "hht": {"order": 2.0, "drift": 1e-10, "accuracy": 10.0, "iterations": 4.0},
    "rattle": {"order": 2.0, "drift": 1e-10},
    "projected": {"drift": 1e-10},
    "ida": {},
    "cvode": {},
    "scipy(method=DOP853)": {},
    "scipy(method=Radau)": {},
}


def parameters(*solvers):
    return [as_parameter(check, f"{spec}: ") for spec in solvers for check in check_solver(spec, **CLAIMS.get(spec, {}))]


@pytest.mark.parametrize("check", parameters(*CLAIMS))
def test_solver(check):
    verdict = check.run()
    assert verdict.kind.good, verdict.message


def test_there_are_at_least_sixty_checks_of_different_names():
    names = check_names()
    assert len(names) == len(set(names)) >= 60
