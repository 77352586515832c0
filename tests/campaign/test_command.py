"""``hhtbench run`` on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from hhtbench.campaign import Campaign, Grid
from hhtbench.campaign.asked import split_specs
from hhtbench.campaign.store import RunRow, Store, load_rows
from hhtbench.campaign.summary import failure_lines, is_failure
from hhtbench.cli.main import main
from tests.campaign.plugin import first_cells


def test_a_solver_from_outside_the_distribution_runs_beside_hht(outside: Path, tmp_path: Path):
    store = tmp_path / "runs.db"
    options = ["--problems", "fall", "--solvers", "told(does=good), told(does=decline), hht"]
    options += ["--rtol", "1e-3", "--steps", "8 16"]
    result = CliRunner().invoke(
        main, ["run", *options, "--store", str(store), "--jobs", "1", "--json", str(tmp_path / "run.json")]
    )
    assert result.exit_code == 0, result.output
    told = json.loads((tmp_path / "run.json").read_text())
    assert (told["cells"], told["run"], told["ended"]) == (9, 9, {"success": 6, "declined": 3})
    assert told["rows"][0]["error"] == pytest.approx(1e-3)
    assert "9 cells: 6 success, 3 declined (9 run now, 6 timed now)" in result.output
    assert "it never takes anything" in result.output
    rows = load_rows(store)
    outside_rows = [row for row in rows if row.solver == "told(does='good')"]
    assert [row.status for row in outside_rows] == ["success"] * 3
    assert outside_rows[0].metrics["errors"]["q"]["end"] == pytest.approx(1e-3)  # the error that it makes
    assert {row.request["steps"] for row in rows if row.success and row.solver == "hht"} == {None, 8, 16}


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--problems", "fal", "--solvers", "told", "--rtol", "1e-3"], "Did you mean fall"),
        (["--problems", "fall", "--solvers", "told", "--rtol", "small"], "--rtol takes numbers"),
        (["--problems", "fall", "--rtol", "1e-3"], "nothing to run"),
        (["--campaign", "quick", "--rtol", "1e-3"], "a campaign has its own rtol"),
        (["--campaign", "slow"], "known: full, quick"),
        (["--campaign", "quick", "--problems", "nosuch"], "the campaign has no problem 'nosuch'"),
        (["--campaign", "quick", "--solvers", "hht(alpha=-0.3), ida(form=gg1)"], "Did you mean ida(form='ggl')"),
        (
            ["--problems", "fall", "--solvers", "told, ida(fom=ggl)", "--rtol", "1e-3"],
            "does not know fom; known: form. Did you mean form?",
        ),
        (["--problems", "fall", "--solvers", "scipy(method=radau)", "--rtol", "1e-3"], "Did you mean Radau"),
        (["--problems", "fall", "--solvers", "told(dos=good)", "--rtol", "1e-3"], "Did you mean does"),
    ],
)
def test_wrong_use_leaves_with_2_and_says_what_to_do(outside: Path, tmp_path: Path, options: list[str], said: str):
    result = CliRunner().invoke(main, ["run", *options, "--store", str(tmp_path / "runs.db")])
    assert result.exit_code == 2
    assert said in result.output
    assert not (tmp_path / "runs.db").exists() or not load_rows(tmp_path / "runs.db")


def test_a_misspelt_solver_of_a_campaign_file_is_refused_before_anything_runs(outside: Path, tmp_path: Path):
    file = tmp_path / "own.toml"
    file.write_text('accuracies = [1e-2]\n[[grid]]\nproblems = ["fall"]\nsolvers = ["told", "hht(alfa=-0.3)"]\n')
    result = CliRunner().invoke(main, ["run", "--campaign", str(file), "--store", str(tmp_path / "runs.db")])
    assert result.exit_code == 2
    assert "hht does not know alfa" in result.output


def test_a_solver_whose_module_is_broken_costs_its_own_cells_only(outside: Path, tmp_path: Path):
    options = ["--problems", "fall", "--solvers", "told, absent", "--rtol", "1e-3", "--no-timing", "--jobs", "1"]
    result = CliRunner().invoke(main, ["run", *options, "--store", str(tmp_path / "runs.db")])
    assert result.exit_code == 0, result.output
    assert "1 success, 1 declined" in result.output


def test_specs_are_split_at_commas_outside_of_brackets_and_quotes():
    assert split_specs(("a, b(k=1, name=')x,(', r=[1, 2])", " c ")) == ["a", "b(k=1, name=')x,(', r=[1, 2])", "c"]


@pytest.mark.parametrize(
    ("fail_on", "code"),
    [([], 0), (["declined"], 0), (["user_exception"], 1), (["any"], 1), (["crashed", "user_exception"], 1), (["nosuch"], 2)],
)
def test_cells_that_fail_make_the_exit_code_1_only_where_that_is_asked(
    outside: Path, tmp_path: Path, fail_on: list[str], code: int
):
    store = tmp_path / "runs.db"
    with Store(store) as kept:
        for cell in first_cells(Campaign(grids=(Grid(problems=("fall",), solvers=("told",), rtol=(1e-3, 1e-4)),))):
            row = RunRow(
                key=cell.key, problem="fall", solver="told", request=cell.request, status="user_exception", message="no"
            )
            kept.put(row, cell.identity)
    options = ["--problems", "fall", "--solvers", "told", "--rtol", "1e-3, 1e-4", "--store", str(store), "--no-timing"]
    for status in fail_on:
        options += ["--fail-on", status]
    result = CliRunner().invoke(main, ["run", *options])
    assert result.exit_code == code, result.output


def test_any_failure_means_neither_a_success_nor_declined():
    ends = ["success", "event", "declined", "crashed", "deadline"]
    rows = [RunRow(key="k", problem="fall", solver="told", request={}, status=status, message="") for status in ends]
    assert [is_failure(row, ("any",)) for row in rows] == [False, False, False, True, True]


def test_equal_failures_are_one_line_with_a_count():
    asked = {"rtol": None, "step": None, "steps": None}

    def row(problem: str, rtol: float, status: str, message: str) -> RunRow:
        return RunRow(
            key="k", problem=problem, solver="told", request={**asked, "rtol": rtol}, status=status, message=message
        )

    rows = [row("fall", 10.0**-power, "crashed", "it died") for power in range(1, 10)]
    rows += [row(problem, 1e-3, "declined", "it takes nothing") for problem in ("fall", "rise", "swing")]
    rows += [row("fall", 1e-3, "deadline", "too long")]
    lines = [" ".join(line.split()) for line in failure_lines(rows)]
    assert lines == [
        "crashed fall told 9 cells: it died",
        "deadline fall told rtol=0.001: too long",
        "declined fall and 2 more told 3 cells: it takes nothing",
    ]
