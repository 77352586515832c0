"""``hhtbench status``: what a store holds, and what of a campaign is left to do in it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from hhtbench.campaign import Campaign, Grid, machine
from hhtbench.campaign.store import RunRow, Store, load_rows
from hhtbench.cli.main import main
from tests.campaign.plugin import first_cells

HERE = machine.machine_facts()
GIVEN = '[[grid]]\nproblems = ["fall"]\nsolvers = ["told"]\nrtol = [1e-3, 1e-4]\n'
NAMED = '[[grid]]\nproblems = ["fall"]\nsolvers = ["told", "told(does=decline)"]\n'


def row(number: int, **changes: Any) -> RunRow:
    asked = {"rtol": 1e-3 / (number + 1), "atol": None, "step": None, "steps": None, "max_seconds": 9.0}
    return replace(
        RunRow(key=f"k{number}", problem="fall", solver="told", request=asked, status="success", message="there"),
        **{"environment": HERE, "created": f"2026-01-0{number + 1}T00:00:00+00:00", **changes},
    )


ROWS = (
    row(0),
    row(1, status="crashed", message="the worker died"),
    row(2, status="crashed", message="the worker died", environment={**HERE, "processor": "another", "cores": 99}),
    row(3, status="declined", message="it takes nothing"),
)


def filled(path: Path, rows: tuple[RunRow, ...] = ROWS) -> Path:
    with Store(path) as store:
        for each in rows:
            store.put(each, f"identity {each.key}")
    return path


def status(*words: object) -> Any:
    return CliRunner().invoke(main, ["status", *map(str, words)])


def test_cells_failures_by_reason_time_span_and_machines_are_told_and_there_as_json(tmp_path: Path):
    store, file = filled(tmp_path / "runs.db"), tmp_path / "status.json"
    found = status(store, "--json", file)
    assert found.exit_code == 0, found.output
    lines = [" ".join(line.split()) for line in found.output.splitlines()]
    assert lines[0] == f"{store}: 4 cells: 2 crashed, 1 success, 1 declined"
    assert lines[1] == "crashed fall told 2 cells: the worker died"
    assert lines[2].startswith("declined fall told rtol=0.00025: it takes nothing")
    assert lines[3] == "made from 2026-01-01T00:00:00+00:00 to 2026-01-04T00:00:00+00:00"
    assert lines[4].startswith(f"rows: 3, by {HERE['processor']}, {HERE['cores']} cores, ")
    assert lines[5].startswith("rows: 1, by another, 99 cores, ")
    told = json.loads(file.read_text())
    assert (told["cells"], told["ended"]) == (4, {"success": 1, "crashed": 2, "declined": 1})
    assert [(one["status"], len(one["cells"])) for one in told["failures"]] == [("crashed", 2), ("declined", 1)]
    assert (told["first"], told["last"]) == (ROWS[0].created, ROWS[-1].created)
    assert [one["rows"] for one in told["machines"]] == [3, 1]
    assert (told["damaged"], told["left"]) == ([], None)


def test_damaged_rows_are_named_and_the_exit_code_is_1_or_2_where_none_can_be_read(tmp_path: Path):
    store, file = filled(tmp_path / "runs.db"), tmp_path / "status.json"
    content = bytearray(store.read_bytes())
    content[content.find(b"it takes nothing")] ^= 1
    store.write_bytes(content)
    found = status(store, "--json", file)
    assert found.exit_code == 1
    assert "is damaged: 1 row cannot be read: fall, told, rtol=0.00025 (number 4 in the file)" in found.stderr
    assert json.loads(file.read_text())["damaged"] == ["fall, told, rtol=0.00025 (number 4 in the file)"]
    store.write_bytes(content[:4096])
    assert status(store).exit_code == 2
    assert status(tmp_path / "absent.db").exit_code == 2


def test_a_store_is_read_while_a_runner_has_it(tmp_path: Path):
    path = filled(tmp_path / "runs.db")
    with Store(path) as store, store._connection:
        store._connection.execute("BEGIN IMMEDIATE")  # it is in the midst of writing
        assert status(path).exit_code == 0


@pytest.fixture
def campaign(outside: Path, tmp_path: Path) -> Path:
    file = tmp_path / "mine.toml"
    file.write_text(f"accuracies = [1e-1, 1e-2]\n{NAMED}")
    return file


def test_what_a_campaign_would_run_next_is_counted_until_nothing_is_left(campaign: Path, tmp_path: Path):
    store, file = tmp_path / "runs.db", tmp_path / "status.json"

    def left() -> dict[str, Any]:
        found = status(store, "--campaign", campaign, "--json", file)
        assert found.exit_code == 0, found.output
        return dict(json.loads(file.read_text())["left"])

    first = first_cells(Campaign(grids=(Grid(problems=("fall",), solvers=("told",), rtol=(3e-2,)),)))[0]
    other = row(5, key="other")
    filled(store, (row(0, key=first.key, request=first.request, status="newton_failed"), other))
    found = left()
    assert (found["pairs"], found["finished"], found["done"]) == (2, 0, 1)
    assert (found["next"], found["untimed"], found["other"]) == (2, 0, 1)
    ran = CliRunner().invoke(main, ["run", "--campaign", str(campaign), "--store", str(store), "--jobs", "1"])
    assert ran.exit_code == 0, ran.output
    found = left()
    assert (found["finished"], found["next"], found["untimed"], found["other"]) == (2, 0, 0, 1)
    assert found["done"] == len(load_rows(store)) - 1


def test_successes_without_times_and_cells_that_ran_out_of_a_smaller_budget_are_left(outside: Path, tmp_path: Path):
    store, file = tmp_path / "runs.db", tmp_path / "mine.toml"
    asked = Campaign(grids=(Grid(problems=("fall",), solvers=("told",), rtol=(1e-3, 1e-4)),), max_seconds=9.0)
    ends = zip(first_cells(asked), ("deadline", "success"), strict=True)
    filled(store, tuple(row(0, key=cell.key, request=cell.request, status=end) for cell, end in ends))
    for budget, left in ((9.0, 0), (99.0, 1)):
        file.write_text(f"max_seconds = {budget}\n{GIVEN}")
        assert status(store, "--campaign", file, "--json", tmp_path / "status.json").exit_code == 0
        found = json.loads((tmp_path / "status.json").read_text())["left"]
        assert (found["next"], found["untimed"]) == (left, 1)


ALONE = [["--solvers", "told"], ["--rtol", "1e-4"], ["--max-seconds", "3"], ["--reference", "auto"], ["--step", "0.1"]]


@pytest.mark.parametrize("options", [*ALONE, ["--problems", "fall", "--solvers", "told(doez=ok)", "--rtol", "1e-3"]])
def test_options_that_name_no_campaign_that_could_run_are_refused_as_run_refuses_them(
    outside: Path, tmp_path: Path, options: list[str]
):
    store = filled(tmp_path / "runs.db")
    found = status(store, *options)
    ran = CliRunner().invoke(main, ["run", "--store", str(tmp_path / "none.db"), *options])
    assert (found.exit_code, ran.exit_code) == (2, 2)
    assert found.stderr == ran.stderr
