"""Checks as tests of pytest."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import pytest

from hhtbench.conformance.check import Check


def parametrize_with_checks(checks: Iterable[Check]) -> pytest.MarkDecorator:
    """A decorator that runs a test for every check, ``def test_my_solver(check): check()``.

    A check that is expected to fail is marked ``xfail(strict=True)``: where it passes the test fails.
    """
    return pytest.mark.parametrize("check", [as_parameter(check) for check in checks])


def as_parameter(check: Check, prefix: str = "") -> Any:
    """One check as a parameter with its name and, where it is expected to fail, its mark."""
    name = f"{prefix}{check.name}"
    if not check.expected_failed:
        return pytest.param(check, id=name)
    mark = pytest.mark.xfail(strict=True, reason=check.expected_failed, raises=AssertionError)
    return pytest.param(replace(check, expected_failed=""), id=name, marks=mark)
