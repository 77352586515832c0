"""diffrax, held to all checks: in a file of its own since XLA compiles for each scene."""

from __future__ import annotations

import pytest

from tests.conformance.test_solvers import parameters

COMPILED = ("mass/", "declared/", "velocity/", "rheonomic/")  # a second each; `make test-slow` has them


def chosen():
    found = [(x, x.values[0].name.startswith(COMPILED)) for x in parameters("diffrax")]
    return [pytest.param(*x.values, id=x.id, marks=pytest.mark.long if long else ()) for x, long in found]


@pytest.mark.parametrize("check", chosen())
def test_diffrax(check):
    found = check.run()
    assert found.kind.good, found.message
