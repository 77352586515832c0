"""The planted faults still fit the sources.  Whether they are found is the command's: ``python -m tests.faults``."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.faults.planted import FAULTS

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: f"{fault.file}: {fault.name}")
def test_a_fault_changes_one_place_and_leaves_python(fault):
    before = (ROOT / fault.file).read_text(encoding="utf-8")
    after = fault.planted(before)
    assert ast.dump(ast.parse(after)) != ast.dump(ast.parse(before))


@pytest.mark.parametrize("fault", [fault for fault in FAULTS if fault.by_tests], ids=lambda fault: fault.name)
def test_a_fault_names_tests_that_there_are(fault):
    files = fault.checked.partition(":")[2].split()
    names = re.findall(
        r"^def (test_\w+)", "".join((ROOT / file).read_text(encoding="utf-8") for file in files), re.MULTILINE
    )
    assert any(fault.first in name for name in names), f"{fault.first!r} is in none of {names}"


def test_there_are_fifty_of_different_names():
    names = [(fault.file, fault.name) for fault in FAULTS]
    assert len(names) == len(set(names)) >= 50
