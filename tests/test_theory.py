"""The formulas in the code and the page that numbers them stay together."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import hhtbench
import solvers.hht

NUMBER = re.compile(r"\((H\d+)\)")
DEFINITION = re.compile(r"^    \((H\d+)\)", re.MULTILINE)
HHT = Path(solvers.hht.__file__).parent
SOURCES = [*HHT.rglob("*.py"), *(Path(hhtbench.__file__).parent / "lowering").rglob("*.py")]
THEORY = (HHT / "THEORY.md").read_text(encoding="utf-8")


def cited(text: str) -> set[str]:
    return set(NUMBER.findall(text))


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.name)
def test_every_formula_number_in_the_code_stands_in_theory(source):
    assert cited(source.read_text(encoding="utf-8")) <= set(DEFINITION.findall(THEORY))


def test_every_formula_of_theory_is_cited_in_the_code():
    everywhere = set().union(*(cited(source.read_text(encoding="utf-8")) for source in SOURCES))
    assert set(DEFINITION.findall(THEORY)) == everywhere


def test_every_formula_is_defined_once_and_mapped_to_the_paper_in_the_table():
    numbers = DEFINITION.findall(THEORY)
    assert len(numbers) == len(set(numbers))
    table = "\n".join(line for line in THEORY.splitlines() if line.startswith("| H"))
    mapped: set[int] = set()
    for first, last in re.findall(r"H(\d+)(?: to H(\d+))?", table):
        mapped |= set(range(int(first), int(last or first) + 1))
    assert mapped == {int(number[1:]) for number in numbers}


def test_papers_are_mapped_in_theory_alone():
    """The step's formulas cite our numbers; the paper's own are left to THEORY.md and to the claims of `verify`."""
    for source in HHT.glob("*.py"):
        assert not re.findall(r"\(3\.[1-5][a-f]?\)|\(2\.[1-3]\)|\(6\.1\)", source.read_text(encoding="utf-8")), source.name


def test_theory_is_read_without_scrolling_sideways():
    assert [line for line in THEORY.splitlines() if len(line) > 120] == []
