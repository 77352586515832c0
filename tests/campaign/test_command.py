"""``hhtbench run`` on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from hhtbench.campaign.command import split_specs
from hhtbench.cli import main
from hhtbench.store import load_rows


def test_a_solver_from_outside_the_distribution_runs_beside_hht(outside: Path, tmp_path: Path):
    store = tmp_path / "runs.db"
    options = ["--problems", "fall", "--solvers", "told(does=decline), hht", "--rtol", "1e-3", "--steps", "8 16"]
    result = CliRunner().invoke(main, ["run", *options, "--store", str(store), "--jobs", "1"])
    assert result.exit_code == 0, result.output
    assert "6 cells: 4 declined, 2 success (6 run now, 2 timed now)" in result.output
    assert "it never takes anything" in result.output
    assert {row.solver for row in load_rows(store)} == {"told(does='decline')", "hht"}
    assert {row.request["steps"] for row in load_rows(store) if row.success} == {8, 16}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--problems", "fal", "--solvers", "told", "--rtol", "1e-3"], "Did you mean fall"),
        (["--problems", "fall", "--solvers", "told", "--rtol", "small"], "--rtol takes numbers"),
        (["--problems", "fall", "--solvers", "told"], "nothing to run"),
        (["--campaign", "quick", "--rtol", "1e-3"], "has its own tolerances"),
        (["--campaign", "slow"], "known: quick"),
    ],
)
def test_wrong_use_leaves_with_2_and_says_what_to_do(outside: Path, tmp_path: Path, options: list[str], said: str):
    result = CliRunner().invoke(main, ["run", *options, "--store", str(tmp_path / "runs.db")])
    assert result.exit_code == 2
    assert said in result.output


def test_specs_are_split_at_commas_outside_of_brackets_and_quotes():
    assert split_specs(("a, b(k=1, name=')x,(', r=[1, 2])", " c ")) == ["a", "b(k=1, name=')x,(', r=[1, 2])", "c"]
