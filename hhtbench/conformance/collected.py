"""Checks as pytest tests: collected by ``pytest --hhtbench-solver=NAME``, or made by ``parametrize_with_checks``."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest

from hhtbench.conformance.check import Check, check_solver


def parametrize_with_checks(checks: Iterable[Check]) -> pytest.MarkDecorator:
    """Return a decorator that runs a test for every check, ``def test_my_solver(check): check()``.

    A check that is expected to fail is marked ``xfail(strict=True)``: the test fails if it passes.
    """
    return pytest.mark.parametrize("check", [as_parameter(check) for check in checks])


def as_parameter(check: Check, prefix: str = "") -> Any:
    """Return one check as a pytest parameter with its name and, if it is expected to fail, its mark."""
    name = f"{prefix}{check.name}"
    if not check.expected_failed:
        return pytest.param(check, id=name)
    mark = pytest.mark.xfail(strict=True, reason=check.expected_failed, raises=AssertionError)
    return pytest.param(replace(check, expected_failed=""), id=name, marks=mark)


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Generate a test for every check of every solver named."""
    lines = metafunc.config.getini("hhtbench_expected_failed")
    expected = {name.strip(): reason.strip() for name, _, reason in (line.partition(":") for line in lines)}
    solvers = metafunc.config.getoption("--hhtbench-solver")
    checks = [(solver, check) for solver in solvers for check in check_solver(solver, expected)]
    several = len(solvers) > 1
    parameters = [as_parameter(check, f"{solver}/" if several else "") for solver, check in checks]
    metafunc.parametrize("check", parameters)


def test_solver(check: Check) -> None:
    """Run one check."""
    check()
