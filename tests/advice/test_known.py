"""What rows of a problem tell ``select``: only where they are of today's problem, machine and versions, and failures too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from textwrap import dedent

import pytest

import hhtbench as hb
from hhtbench.advice import selecting
from hhtbench.advice.criteria import Criteria
from hhtbench.advice.database import read_database
from hhtbench.advice.selecting import known_of
from hhtbench.campaign.machine import machine_facts
from tests.advice.plugin import PROBLEM
from tests.advice.test_trading import CHEAP
from tests.analysis.laws import failed, law, run

CRITERIA = Criteria(accuracies=(1e-4,), on="evaluations")
NESTED = "minimal(solver='ida(form=ggl)')"
RULES = {"accuracies": [1e-2, 1e-4], "max_seconds": 1.0, "pair_seconds": 4.0, "refinements": 9}


@pytest.fixture
def stored(monkeypatch):
    """Says which rows every store holds."""

    def hold(rows):
        monkeypatch.setattr(selecting, "load_rows", lambda file: [replace(row, problem="simple_pendulum") for row in rows])
        monkeypatch.setattr(selecting, "outdated", lambda rows: ())

    return hold


def advice(**asked):
    return hb.select("simple_pendulum", on="evaluations", **{"accuracy": 1e-4, "store": "runs.sqlite"} | asked)


def test_rows_of_a_problem_whose_file_has_changed_are_left_out_and_counted(prices, tmp_path: Path):
    file, store = tmp_path / "own.py", tmp_path / "own.sqlite"
    file.write_text(dedent(PROBLEM))
    asked = {"on": "evaluations", "store": store}
    made = hb.trade(f"{file}:problem", accuracies=[1e-2], solvers=[CHEAP], seconds=300, jobs=1, **asked)
    told = hb.select(f"{file}:problem", accuracy=1e-2, **asked)
    assert (told.taken, told.evidence) == (CHEAP, f"{len(made.rows)} runs in own.sqlite")
    file.write_text(dedent(PROBLEM).replace("9.81", "1.62"))
    told = hb.select(f"{file}:problem", accuracy=1e-2, **asked)
    assert told.taken != CHEAP
    assert told.evidence.startswith(
        f"0 runs in own.sqlite; {len(made.rows)} of other sources or libraries left out; {len(read_database().scenes)} known"
    )


def test_a_solver_that_failed_on_the_problem_is_not_named_and_the_evidence_says_so(stored):
    stored([])
    usual = advice()
    stored([failed(usual.taken, 1e-2), failed(usual.second, 1e-2)])
    told = advice()
    assert not {usual.taken, usual.second} & {told.taken, told.second}
    assert told.evidence.startswith(f"2 runs in runs.sqlite do not get there; {usual.taken}: newton_failed 1 of 1")


def test_where_all_known_solvers_failed_it_cannot_be_told(stored):
    specs = dict.fromkeys(entry.removesuffix(", steps=N") for entry in read_database().entries)
    steps = {"rtol": None, "atol": None, "step": None, "steps": 10}
    stored([*(failed(spec, 1e-2) for spec in specs), failed("hht(alpha=-0.05)", 1e-2, request=steps)])
    told = advice()
    assert (told.taken, told.second) == (None, None)
    assert "all solvers of the database have failed on this problem" in told.text


def test_a_solver_that_drifts_too_far_on_the_problem_is_not_named(stored):
    stored([])
    usual = advice(drift=1e-10)
    stored(law(usual.taken, 50.0, 4, drift=1e-5))
    told = advice(drift=1e-10)
    assert told.taken != usual.taken
    assert "drifts by 1.0e-05 or more, above 1e-10" in told.evidence


def test_a_solver_of_which_only_looser_errors_were_asked_has_not_failed():
    loose = law("ida", 50.0, 4, settings=(1e-2, 1e-3))
    asked = [replace(row, request={**row.request, "rules": {**RULES, "accuracies": [1e-2, 1e-3]}}) for row in loose]
    for rows in (loose, asked):
        found = known_of("pendulum", rows, CRITERIA, "2 runs")
        assert found.failed == {}
        assert found.text == "2 runs do not get there"


def test_a_solver_that_used_up_what_a_campaign_gives_has_failed():
    late = failed("cvode", 1e-2, status="deadline", message="late")
    rows = [replace(late, request={**late.request, "rules": RULES})]
    assert set(known_of("pendulum", rows, CRITERIA, "1 runs").failed) == {"cvode"}


@pytest.mark.parametrize(
    ("changed", "text"),
    [({"numpy": "0.1"}, "other versions (numpy 0.1, here"), ({"processor": "abacus"}, "machine (abacus")],
)
def test_times_of_rows_made_elsewhere_or_with_other_versions_are_refused(changed, text):
    here = machine_facts()
    rows = [replace(row, environment={**here, **changed}) for row in law("ida", 50.0, 4)]
    asked = Criteria(accuracies=(1e-4,))
    found = known_of("pendulum", rows, asked, "")
    assert found.on == "evaluations"
    assert text in found.refusal
    same = [replace(row, environment=here) for row in rows]
    assert (known_of("pendulum", same, asked, "").on, known_of("pendulum", same, asked, "").refusal) == (
        "time",
        "",
    )


def test_solvers_are_named_as_solve_takes_them_and_beside_it_what_they_are_given(stored):
    constant = {"rtol": None, "atol": None, "step": None, "steps": 200}
    stored([run("hht(alpha=-0.05)", 1e-4, 1e-5, 200.0, request=constant), run(NESTED, 1e-5, 1e-5, 900.0)])
    found = advice()
    assert (found.taken, found.taken_by) == ("hht(alpha=-0.05)", "steps")
    assert (found.second, found.second_by) == (NESTED, "rtol")
    assert found.text.startswith("Take hht(alpha=-0.05), steps=N: 200 steps gives")
