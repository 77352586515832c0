"""Campaigns, references and validation of problems with events."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.campaign.store import load_rows
from hhtbench.cli.main import main
from hhtbench.conformance.pairwise import assert_solvers_agree
from tests.eventful.scenes import belt
from tests.eventful.test_switches import Sticking, stick_slip

SCENES = str(Path(__file__).with_name("scenes.py"))


def test_events_of_a_problem_are_taken_by_solve_unless_others_are_given():
    found = hb.solve(belt(), "projected", rtol=1e-8)
    np.testing.assert_allclose(found.t_events[0][:3], stick_slip(3)[0], atol=1e-7)
    assert not hb.solve(belt(), "projected", rtol=1e-8, events=[]).t_events


def test_a_campaign_certifies_scenes_with_events_and_measures_their_errors(tmp_path, monkeypatch):
    from click.testing import CliRunner

    monkeypatch.chdir(tmp_path)
    problems = ["--problems", f"{SCENES}:belt"]
    solvers = ["--solvers", "ida", "--solvers", "cvode", "--rtol", "1e-6"]
    options = [*problems, *solvers, "--reference", "auto", "--jobs", "1", "--no-timing", "--store", "runs.db"]
    result = CliRunner().invoke(main, ["run", *options])
    assert result.exit_code == 0, result.output
    assert result.output.count(": certified") == 1
    rows = load_rows(tmp_path / "runs.db")
    assert [row.status for row in rows] == ["success"] * 2
    errors = [row.metrics["errors"]["q"]["max_scaled"] for row in rows]
    assert max(errors) < 1e-3
    assert {row.metrics["errors"]["against"] for row in rows} == {"reference"}


def test_solvers_of_all_families_agree_on_a_scene_with_events():
    solvers = ["ida", "cvode", "projected"]
    assert_solvers_agree(belt(), solvers, rtol=1e-9, factor=300)  # of sizes of 0.06 m: atol is that of 1 m, CVODE 14 of them


@pytest.mark.parametrize("solver", ["hht", "projected"])
def test_events_of_another_system_are_declined(solver):
    found = hb.solve(replace(belt(), system=Sticking()), solver, rtol=1e-6)
    assert found.status.label == "declined"
    assert "event 'breaks' is looked for during a system that is not in this motion" in found.message
