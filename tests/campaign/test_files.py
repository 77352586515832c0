"""What is wrong in a campaign's file is told with file, line, key, what was expected and what came."""

from __future__ import annotations

from pathlib import Path

import pytest

from hhtbench.campaign import named_campaign, read_campaign
from hhtbench.protocol.errors import NotFoundError, ProblemError

GOOD = """\
# mine
accuracies = [1e-2, 1e-4]
max_seconds = 5

[[grid]]
problems = ["andrews"]
solvers = ["hht", "ida"]

[[grid]]
problems = ["knife_edge"]
solvers = [
    "hht",
]
refine = "steps"
held_out = true
"""


def test_a_campaign_is_read_as_it_is_written():
    campaign = read_campaign(GOOD)
    assert (campaign.accuracies, campaign.max_seconds) == ((1e-2, 1e-4), 5.0)
    first, second = campaign.grids
    assert (first.solvers, first.refine, first.held_out) == (("hht", "ida"), "rtol", False)
    assert (second.solvers, second.refine, second.held_out) == (("hht",), "steps", True)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            'problems = ["andrews"]',
            'problems = "andrews"',
            r"mine.toml, line 6: grid\[0\].problems: expected a list; got 'andrews'",
        ),
        ('    "hht",\n', "    1,\n", r"line 11: grid\[1\].solvers\[0\]: expected text; got 1"),
        ("max_seconds = 5", "max_seconds = [5]", r"line 3: max_seconds: expected a number; got \[5\]"),
        ("max_seconds = 5", "max_seconds = 0", r"line 3: max_seconds: expected a number > 0.0; got 0"),
        ("max_seconds = 5", 'max_seconds = "5"', r"line 3: max_seconds: expected a number; got '5'"),
        ("[1e-2, 1e-4]", "1e-2", r"line 2: accuracies: expected a list; got 0.01"),
        ("[1e-2, 1e-4]", "[1e-2, 2]", r"line 2: accuracies\[1\]: expected a number < 1.0; got 2"),
        ("held_out = true", "held_out = 1", r"line 15: grid\[1\].held_out: expected true or false; got 1"),
        ('refine = "steps"', 'refine = "step"', r"line 14: grid\[1\].refine: Invalid enum value 'step'"),
        ('refine = "steps"', 'refin = "steps"', r"line 14: unknown key grid\[1\].refin. Did you mean refine\?"),
        ("max_seconds", "max_secnds", r"line 3: unknown key max_secnds. Did you mean max_seconds\? Known: grid, accuracies"),
        ('problems = ["knife_edge"]', "", r"line 9: grid\[1\]: Object missing required field `problems`"),
        ("# mine", "= 1", r"mine.toml is not TOML: .*line 1"),
        ('[[grid]]\nproblems = ["andrews"]', '[grid]\nproblems = ["andrews"]', "mine.toml is not TOML|expected a list"),
    ],
)
def test_what_is_wrong_is_told_with_its_place(old: str, new: str, said: str):
    assert old in GOOD
    with pytest.raises(ProblemError, match=said):
        read_campaign(GOOD.replace(old, new, 1), "mine.toml")


def test_a_file_is_read_from_where_it_lies_and_an_absent_one_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "mine.toml").write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    assert named_campaign("mine.toml").max_seconds == 5.0
    with pytest.raises(NotFoundError, match=r"there is no file other.toml in"):
        named_campaign("other.toml")
    with pytest.raises(NotFoundError, match=r"known: .*quick"):
        named_campaign("quck")
