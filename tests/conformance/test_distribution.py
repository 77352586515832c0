"""A solver from a distribution of its own: installed, found by its name, and put to all checks in one line."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).with_name("acme_rk4")
EXPECTED = {
    "budget/steps": "it counts no budget of steps",
    "declines/unknown_option": "it looks at no options",
    "start/position": "it integrates whatever it is given",
    "start/velocity": "it integrates whatever it is given",
    "start/velocity_constraint": "it integrates whatever it is given",
}


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """The folder into which pip has installed it, without network."""
    folder = tmp_path_factory.mktemp("acme")
    shutil.copytree(SOURCE, folder / "source")  # a build leaves files beside its sources
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    command = [sys.executable, "-m", "pip", "install", *options, "--target", folder / "site", folder / "source"]
    subprocess.run(command, check=True, capture_output=True)
    return folder / "site"


def in_one_line(site, folder, *options, expected=EXPECTED):
    """``pytest --hhtbench-solver=acme_rk4`` where the distribution is installed."""
    (folder / "pytest.ini").write_text(
        "[pytest]\nhhtbench_expected_failed =\n" + "".join(f"    {name}: {why}\n" for name, why in expected.items())
    )
    environment = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--hhtbench-solver=acme_rk4", *options]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)


def test_it_passes_every_check_but_those_known_to_fail(installed, tmp_path):
    """And where no file is named, nothing else is collected."""
    (tmp_path / "test_own.py").write_text("def test_own():\n    assert False\n")
    found = in_one_line(installed, tmp_path)
    assert found.returncode == 0, found.stdout[-3000:]
    counts = {word: int(count) for count, word in re.findall(r"(\d+) (\w+)", found.stdout.splitlines()[-1])}
    assert counts["passed"] >= 60
    assert counts["xfailed"] == len(EXPECTED)


@pytest.mark.long
def test_an_unexpected_pass_fails(installed, tmp_path):
    found = in_one_line(installed, tmp_path, "-k", "name", expected={"name": "it had none once"})
    assert found.returncode == 1
    assert "XPASS(strict)" in found.stdout
    assert "it had none once" in found.stdout


def test_a_name_that_no_check_has_is_told(installed, tmp_path):
    found = in_one_line(installed, tmp_path, expected={"position/row": "a slip of the pen"})
    assert found.returncode != 0
    assert "Did you mean position/rows" in found.stdout


@pytest.mark.long
def test_files_that_are_named_are_run_beside_the_checks(installed, tmp_path):
    (tmp_path / "test_own.py").write_text("def test_own():\n    pass\n")
    found = in_one_line(installed, tmp_path, "test_own.py", "--collect-only", "-k", "own or name")
    assert found.stdout.count("test_own.py::test_own") == 1
    assert found.stdout.count("::test_solver[name]") == 1
