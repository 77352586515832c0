"""Every solver of the bench, held to all checks; what is known to fail stands beside the entry, with its reason."""

from __future__ import annotations

import pytest

from hhtbench.conformance import check_names, check_solver
from tests.conformance.claims import CLAIMS, claims_of

SLOW = ("diffrax", "collocation")  # `python -m tests.faults --sound` holds them to the checks
ALIKE = (
    "rattle",
    "generalised_alpha",
    "generalised_alpha(form=index3)",
    "hht_i3",
)  # HHT's loop: two scenes; `make test-slow` has all


def parameters(*solvers):
    checks = [(spec, check) for spec in solvers for check in check_solver(spec, **claims_of(spec))]
    return [pytest.param(check, id=f"{spec}: {check}", marks=marks_of(spec, check.name)) for spec, check in checks]


def marks_of(spec, name):
    return pytest.mark.long if spec in ALIKE and not name.startswith(("position/", "mixed/")) else ()


@pytest.mark.parametrize("check", parameters(*(spec for spec in CLAIMS if spec not in SLOW)))
def test_solver(check):
    found = check.run()
    assert found.kind.good, found.message


def test_there_are_at_least_sixty_checks_of_different_names():
    names = check_names()
    assert len(names) == len(set(names)) >= 60
