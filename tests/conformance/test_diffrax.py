"""diffrax, held to all checks: in a file of its own since XLA compiles for each scene."""

from __future__ import annotations

import pytest

from tests.conformance.test_solvers import parameters


@pytest.mark.parametrize("check", parameters("diffrax"))
def test_diffrax(check):
    found = check.run()
    assert found.kind.good, found.message
