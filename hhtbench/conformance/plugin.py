"""pytest plugin: ``pytest --hhtbench-solver=NAME`` runs every check of a solver, beside the named files or alone."""

from __future__ import annotations

from pathlib import Path

import pytest

CONFORMANCE = str(Path(__file__).with_name("collected.py"))


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the option ``--hhtbench-solver`` and the ini value ``hhtbench_expected_failed``."""
    text = "run the checks of hhtbench.conformance on this solver, a name or a spec; may be repeated"
    parser.getgroup("hhtbench").addoption("--hhtbench-solver", action="append", default=[], metavar="NAME", help=text)
    text = "checks that are known to fail, a line each: 'NAME: reason'; passing is then the failure"
    parser.addini("hhtbench_expected_failed", text, type="linelist", default=[])


def pytest_configure(config: pytest.Config) -> None:
    """Let pytest collect the conformance checks if a solver was named by the option; if no file was named, collect nothing
    else.
    """
    if not config.getoption("--hhtbench-solver") or CONFORMANCE in config.args:
        return
    named = config.args_source is config.ArgsSource.ARGS
    config.args[:] = [*(config.args if named else ()), CONFORMANCE]
