"""The library's own table and thumbnails: a new problem cannot be forgotten."""

from pathlib import Path

import pytest
from PIL import Image

import problems
from hhtbench.catalogue.registry import list_problems
from hhtbench.drawing import table
from hhtbench.protocol.errors import ProblemError

README = Path(problems.__file__).with_name("README.md")
THUMBNAILS = README.with_name("thumbnails")
RENEW = "run: hhtbench show --all --out problems/thumbnails --table problems/README.md"


def test_readme_lists_all_problems_as_they_are():
    assert table.split_text(README)[1].strip() == table.problem_table().strip(), RENEW


def test_every_problem_has_a_thumbnail_of_fitting_size_and_no_other_is_kept():
    files = {file.stem: file for file in THUMBNAILS.glob("*.png")}
    assert set(files) == set(list_problems()), RENEW
    for file in files.values():
        assert file.stat().st_size < 15_000
        with Image.open(file) as picture:
            assert picture.size == (320, 240)


def test_every_problem_says_what_it_is_good_for():
    for line in table.problem_table().splitlines()[2:]:
        cells = [cell.strip() for cell in line.strip("|").split(" | ")]
        assert len(cells) == len(table.HEADS)
        assert all(cells)


def test_file_without_marks_is_refused(tmp_path):
    (tmp_path / "README.md").write_text("# Problems\n")
    with pytest.raises(ProblemError, match="must hold the lines"):
        table.update_table(tmp_path / "README.md")
