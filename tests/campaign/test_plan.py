"""Keys change exactly when a result could."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from hhtbench.campaign import Campaign, Grid, named_campaign, plan_cells, read_campaign, restrict, sources
from hhtbench.errors import NotFoundError, ProblemError

GRID = Grid(problems=("fall",), solvers=("told", "told(does='nan')"), rtol=(1e-3, 1e-6))
CAMPAIGN = Campaign(grids=(GRID,))


def keys(campaign: Campaign = CAMPAIGN) -> list[str]:
    return [cell.key for cell in plan_cells(campaign)]


def test_a_plan_holds_every_combination_once_with_a_key_of_its_own(outside: Path):
    twice = Campaign(grids=(GRID, replace(GRID, solvers=("told()", "told( does = 'nan' )"))))
    assert len(set(keys())) == 4
    assert keys(twice) == keys()


@pytest.mark.parametrize("file", ["fall.py", "told.py", "shared.py", "fall.json", "__init__.py"])
def test_a_change_of_a_file_behind_a_cell_changes_its_key(outside: Path, file: str):
    before = keys()
    path = outside / "outside" / file
    path.write_text(path.read_text() + "\n# changed\n")
    assert not set(before) & set(keys())


@pytest.mark.parametrize("file", ["other.py", "other.json"])
def test_a_change_of_any_other_file_does_not(outside: Path, file: str):
    before = keys()
    path = outside / "outside" / file
    path.write_text(path.read_text() + "\n# changed\n")
    assert keys() == before


def test_a_changed_solver_leaves_the_cells_of_other_solvers(outside: Path):
    campaign = Campaign(grids=(Grid(problems=("fall",), solvers=("told", "hht"), steps=(10,)),))
    before = keys(campaign)
    path = outside / "outside" / "told.py"
    path.write_text(path.read_text() + "\n# changed\n")
    after = keys(campaign)
    assert [old == new for old, new in zip(before, after, strict=True)] == [False, True]


def test_numerics_of_the_bench_are_behind_every_cell_and_its_surface_is_not(outside: Path):
    from hhtbench.specs import parse_spec

    behind = sources.SourceReader().behind(parse_spec("fall"), parse_spec("told"))
    inner = {
        "hhtbench.lowering.dynamics.kkt",
        "hhtbench.campaign.drift",
        "hhtbench.campaign.run",
        "hhtbench.request",
        "outside.shared",
    }
    assert inner <= set(behind)
    assert not [
        name for name in behind if name.startswith(("hhtbench.cli", "hhtbench.report", "hhtbench.checks", "outside.o"))
    ]


def test_solvers_of_the_library_rest_on_their_package_but_not_on_their_verification():
    from hhtbench.specs import parse_spec

    behind = sources.SourceReader().behind(parse_spec("andrews"), parse_spec("hht"))
    assert {"solvers.hht.run.engine", "problems._common", "problems.andrews: references/andrews.json"} <= set(behind)
    assert not [name for name in behind if ".verify" in name or "knife_edge" in name]


def test_another_version_of_a_library_changes_the_key(outside: Path, monkeypatch: pytest.MonkeyPatch):
    before = keys()
    monkeypatch.setattr(sources, "_version_of", lambda top: f"{top} 0")
    assert not set(before) & set(keys())


@pytest.mark.parametrize("change", [{"max_seconds": 99.0}, {"repeats": 9}])
def test_what_cannot_change_a_result_is_outside_the_key(outside: Path, change: dict[str, float]):
    assert keys(replace(CAMPAIGN, **change)) == keys()


def test_the_number_of_outputs_and_each_value_are_inside_the_key(outside: Path):
    assert not set(keys(replace(CAMPAIGN, outputs=7))) & set(keys())
    assert len(set(keys()) & set(keys(Campaign(grids=(replace(GRID, rtol=(1e-3, 2e-6)),))))) == 2


def test_a_users_file_is_read_with_its_neighbours(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.py").write_text("import helper\n")
    (tmp_path / "helper.py").write_text("K = 1\n")
    campaign = Campaign(grids=(Grid(problems=("mine.py:problem",), solvers=("hht",), steps=(10,)),))
    before = keys(campaign)
    (tmp_path / "helper.py").write_text("K = 2\n")
    assert keys(campaign) != before


def test_wrong_names_and_values_are_refused_before_anything_runs(outside: Path):
    with pytest.raises(NotFoundError, match="Did you mean told"):
        keys(Campaign(grids=(replace(GRID, solvers=("tild",)),)))
    with pytest.raises(NotFoundError, match="no file"):
        keys(Campaign(grids=(replace(GRID, problems=("absent.py:problem",)),)))
    with pytest.raises(ProblemError, match="must not be negative"):
        keys(Campaign(grids=(replace(GRID, rtol=(-1.0,)),)))
    with pytest.raises(ProblemError, match="nothing to run"):
        keys(Campaign(grids=(Grid(problems=("fall",), solvers=("told",)),)))


def test_the_quick_campaign_is_six_problems_on_fifteen_solvers_or_more_at_five_accuracies():
    cells = Counter((cell.problem, cell.solver) for cell in plan_cells(named_campaign("quick")))
    assert len(cells) == 6 * 16 - 2, "diffrax's Kvaerno5 is left out twice"
    assert {count for (_, solver), count in cells.items() if solver != "hht(alpha=-0.05)"} == {5}
    assert {count for (_, solver), count in cells.items() if solver == "hht(alpha=-0.05)"} == {10}, "constant steps too"
    part = restrict(named_campaign("quick"), ["andrews"], ["hht(alpha=-0.3)"])
    assert [cell.request["rtol"] for cell in plan_cells(part)] == [1e-2, 3e-3, 1e-3, 3e-4, 1e-4]


@pytest.mark.parametrize(
    ("problems", "solvers", "said"),
    [
        (["andrew"], [], r"no problem 'andrew'\. Did you mean andrews\? It has: "),
        (["andrews", "nosuch"], [], r"no problem 'nosuch'\. It has: .*andrews"),
        ([], ["hht(alpha=-0.3)", "ida"], r"no solver 'ida'\. Did you mean ida\(form='ggl'\)\?"),
        (["andrews"], ["scipy(method=radau)"], r"Did you mean scipy\(method='Radau'\)\?"),
    ],
)
def test_what_is_not_in_a_campaign_is_told_with_the_closest_that_is(problems: list[str], solvers: list[str], said: str):
    with pytest.raises(NotFoundError, match=said):
        restrict(named_campaign("quick"), problems, solvers)


def test_an_unknown_entry_or_name_of_a_campaign_is_named():
    with pytest.raises(ProblemError, match="unknown rtoll; known: problems, solvers, rtol"):
        read_campaign("[[grid]]\nproblems=['a']\nsolvers=['b']\nrtoll=[1]\n")
    with pytest.raises(NotFoundError, match="known: quick"):
        named_campaign("quck")


def test_a_users_folder_of_a_distributions_name_changes_no_key(
    outside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    asked = Campaign(grids=(Grid(problems=("fall",), solvers=("told",), rtol=(1e-3,)),))
    (before,) = plan_cells(asked)
    folder = tmp_path / "own" / "outside"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(str(folder.parent))
    (after,) = plan_cells(asked)
    assert after.key == before.key
