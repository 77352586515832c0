"""What ``pytest --hhtbench-solver=NAME`` collects."""

from __future__ import annotations

import pytest

from hhtbench.conformance.check import Check, check_solver
from hhtbench.conformance.parametrize import as_parameter


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """A test for every check of every solver named."""
    lines = metafunc.config.getini("hhtbench_expected_failed")
    expected = {name.strip(): reason.strip() for name, _, reason in (line.partition(":") for line in lines)}
    solvers = metafunc.config.getoption("--hhtbench-solver")
    checks = [(solver, check) for solver in solvers for check in check_solver(solver, expected)]
    several = len(solvers) > 1
    parameters = [as_parameter(check, f"{solver}/" if several else "") for solver, check in checks]
    metafunc.parametrize("check", parameters)


def test_solver(check: Check) -> None:
    """One check."""
    check()
