"""Some random mechanisms show no fault, and solvers that mislead are found; ``make fuzz`` draws 10,000."""

import pytest

from tests.fuzz.explore import explore
from tests.fuzz.liars import LIARS

CASES = {"steps": 10, "control": 6, "machine": 5, "hostile": 10}
SEED = 20_260
LIES = 60  # cases within which one is found


@pytest.mark.parametrize("family", CASES)
def test_no_random_case_shows_a_fault(family):
    """Sound and gentle ones arrive, and they are many."""
    found = list(explore(family, SEED, CASES[family]))
    assert [(one.seed, one.fault) for one in found if one.fault] == []
    assert sum(one.must_succeed for one in found) >= (0 if family == "hostile" else 0.4 * len(found))
    assert sum(one.status == "success" for one in found) >= 0.2 * len(found)


@pytest.mark.parametrize("name", LIARS)
def test_a_solver_that_misleads_is_found(name):
    solver, family, twin = LIARS[name]
    assert any(one.fault for one in explore(family, SEED, LIES, solver, twin=twin))
