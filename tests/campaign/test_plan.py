"""Keys change exactly when a result could."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from hhtbench import list_problems, list_solvers, load_problem
from hhtbench.campaign import Campaign, Grid, named_campaign, plan_pairs, restrict, sources
from hhtbench.catalogue.specs import canonical, parse_spec
from hhtbench.protocol.errors import NotFoundError, ProblemError
from tests.campaign.plugin import first_cells

GRID = Grid(problems=("fall",), solvers=("told", "told(does='nan')"), rtol=(1e-3, 1e-6))
CAMPAIGN = Campaign(grids=(GRID,))


def keys(campaign: Campaign = CAMPAIGN) -> list[str]:
    return [cell.key for cell in first_cells(campaign)]


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


@pytest.mark.parametrize("file", ["other.py", "other.json", "fall.sqlite", "fall.html", "s.sqlite.references/fall.json"])
def test_a_change_of_any_other_file_does_not(outside: Path, file: str):
    """Nor do results that have the problem's name: the store, a page, a certificate beside the store."""
    before = keys()
    path = outside / "outside" / file
    path.parent.mkdir(exist_ok=True)
    path.write_text((path.read_text() if path.exists() else "") + "\n# changed\n")
    assert keys() == before


def test_a_changed_solver_leaves_the_cells_of_other_solvers(outside: Path):
    campaign = Campaign(grids=(Grid(problems=("fall",), solvers=("told", "hht"), steps=(10,)),))
    before = keys(campaign)
    path = outside / "outside" / "told.py"
    path.write_text(path.read_text() + "\n# changed\n")
    after = keys(campaign)
    assert [old == new for old, new in zip(before, after, strict=True)] == [False, True]


def test_numerics_of_the_bench_are_behind_every_cell_and_its_surface_is_not(outside: Path):

    behind = sources.SourceReader().behind(parse_spec("fall"), parse_spec("told"))
    inner = {
        "hhtbench.lowering.dynamics.kkt",
        "hhtbench.checks.drift.measure",
        "hhtbench.campaign.run",
        "hhtbench.solution.request",
        "outside.shared",
    }
    assert inner <= set(behind)
    surface = ("hhtbench.cli.main", "hhtbench.report", "hhtbench.checks.problem", "outside.o")
    assert not [name for name in behind if name.startswith(surface)]


def test_solvers_of_the_library_rest_on_their_package_but_not_on_their_verification():

    behind = sources.SourceReader().behind(parse_spec("andrews"), parse_spec("hht"))
    assert {"solvers.hht.run.engine", "problems._common", "problems.andrews: references/andrews.json"} <= set(behind)
    assert not [name for name in behind if ".verify" in name or "knife_edge" in name]


def test_planning_looks_up_every_problem_and_solver_once_however_many_pairs_they_make(
    outside: Path, monkeypatch: pytest.MonkeyPatch
):
    """Finding a name reads the files of all distributions."""
    looked: Counter[str] = Counter()
    find = sources.plugins.find
    monkeypatch.setattr(sources.plugins, "find", lambda kind, name: looked.update([name]) or find(kind, name))
    campaign = Campaign(grids=(Grid(problems=("fall", "andrews", "knife_edge"), solvers=("hht", "ida"), rtol=(1e-3,)),))
    assert len(plan_pairs(campaign)) == 6
    assert looked == dict.fromkeys(("fall", "andrews", "knife_edge", "hht", "ida"), 1)


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
        keys(Campaign(grids=(Grid(problems=("fall",), solvers=()),)))


KINDS = {  # tag -> how many problems of the quick campaign have it, at least
    "holonomic": 9,
    "velocity-level": 2,
    "mixed": 2,
    "unconstrained": 2,
    "stiff": 3,
    "redundant": 1,
    "rheonomic": 1,
    "large": 1,
}


def problems_of(name: str, **of_grid: bool) -> list[str]:
    grids = [g for g in named_campaign(name).grids if all(getattr(g, key) is value for key, value in of_grid.items())]
    return list(dict.fromkeys(problem for grid in grids for problem in grid.problems))


@pytest.mark.parametrize("name", ["quick", "full"])
def test_every_registered_solver_takes_part_and_minimal_coordinates_where_there_are_any(name: str):
    solvers = {pair.solver for pair in plan_pairs(named_campaign(name))}
    assert {solver.partition("(")[0] for solver in solvers} >= {solver for solver in list_solvers() if solver != "told"}
    assert {"ida(form='ggl')", "projected(method='DOP853')", "collocation(form='ggl')"} <= solvers
    minimal = {pair.problem for pair in plan_pairs(named_campaign(name)) if pair.solver.startswith("minimal")}
    assert minimal == {canonical(spec) for spec in problems_of(name) if load_problem(spec).minimal is not None}


def test_the_quick_campaign_has_problems_of_all_kinds_each_with_a_known_truth():
    problems = [load_problem(spec) for spec in problems_of("quick")]
    assert len(problems) >= 14
    tags = Counter(tag for problem in problems for tag in problem.tags)
    assert {kind: tags[kind] >= least for kind, least in KINDS.items()} == dict.fromkeys(KINDS, True)
    assert all(problem.exact is not None or problem.reference is not None for problem in problems)


def test_the_full_campaign_has_the_whole_library_and_ten_problems_more_that_were_held_out():
    library = {spec.partition("(")[0] for spec in problems_of("full", held_out=False)}
    assert library == set(list_problems())
    held_out = problems_of("full", held_out=True)
    assert len(held_out) >= 10
    assert not set(held_out) & {*problems_of("full", held_out=False), *problems_of("quick")}
    assert named_campaign("full").reference == "auto", "the drawn ones bring no reference"
    assert all(load_problem(spec).name for spec in held_out)


def test_a_pair_that_is_refined_has_the_campaigns_rules_in_every_request(outside: Path):
    campaign = Campaign(grids=(Grid(problems=("fall",), solvers=("told",), held_out=True),), accuracies=(1e-2, 1e-3))
    (pair,) = plan_pairs(campaign)
    (first,) = pair.next_cells(())
    assert first.request["rtol"] == 3e-2
    rules = {"accuracies": [1e-2, 1e-3], "max_seconds": 20.0, "pair_seconds": 60.0, "refinements": 16}
    assert (first.request["rules"], first.request["held_out"]) == (rules, True)
    (other,) = plan_pairs(replace(campaign, refinements=3, accuracies=(1e-5,)))
    assert other.next_cells(())[0].key == first.key, "what is asked for next does not change what was found"


@pytest.mark.parametrize(
    ("problems", "solvers", "said"),
    [
        (["andrew"], [], r"no problem 'andrew'\. Did you mean andrews\? It has: "),
        (["andrews", "nosuch"], [], r"no problem 'nosuch'\. It has: .*andrews"),
        ([], ["hht(alpha=-0.3)", "minimal"], r"no solver 'minimal'\. Did you mean minimal\("),
        (["andrews"], ["scipy(method=radau)"], r"Did you mean scipy\(method='Radau'\)\?"),
    ],
)
def test_what_is_not_in_a_campaign_is_told_with_the_closest_that_is(problems: list[str], solvers: list[str], said: str):
    with pytest.raises(NotFoundError, match=said):
        restrict(named_campaign("quick"), problems, solvers)


def test_specs_that_write_out_a_default_and_specs_that_do_not_are_the_same_cells(outside: Path):
    quick = restrict(named_campaign("quick"), ["andrews"], ["projected"])
    assert {solver for grid in quick.grids for solver in grid.solvers} == {"projected(method=DOP853)"}
    twice = Grid(problems=("fall", "fall(t_end=1.0)"), solvers=("projected", "projected(method=DOP853)"), rtol=(1e-3,))
    assert [(cell.problem, cell.solver) for cell in first_cells(Campaign(grids=(twice,)))] == [("fall", "projected")]
    told = ("hht", "hht(b=0)", "hht(engine='compiled')", "hht(alpha=-0.1)")
    whole = Grid(problems=("fall(t_end=2)", "fall(t_end=2.0)"), solvers=told, rtol=(1e-3,))
    assert [cell.solver for cell in first_cells(Campaign(grids=(whole,)))] == ["hht", "hht(alpha=-0.1)"]
    other = Grid(problems=("fall", "fall(t_end=2.0)"), solvers=("projected", "projected(method=RK23)"), rtol=(1e-3,))
    assert len(first_cells(Campaign(grids=(other,)))) == 4


def test_a_users_folder_of_a_distributions_name_changes_no_key(
    outside: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    asked = Campaign(grids=(Grid(problems=("fall",), solvers=("told",), rtol=(1e-3,)),))
    (before,) = first_cells(asked)
    folder = tmp_path / "own" / "outside"
    folder.mkdir(parents=True)
    (folder / "__init__.py").write_text("VALUE = 1\n")
    monkeypatch.syspath_prepend(str(folder.parent))
    (after,) = first_cells(asked)
    assert after.key == before.key
