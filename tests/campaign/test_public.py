"""``hb.run``: a campaign from Python; its rows as a list, a file, a data frame."""

from __future__ import annotations

import csv

import pytest

import hhtbench as hb

ASKED = {"rtol": [1e-2, 1e-4], "jobs": 1, "timing": False}


@pytest.fixture
def runs(outside):
    return hb.run("fall", "told", **ASKED)


def test_there_is_a_row_for_every_solve_with_its_error_as_a_list_a_file_and_a_frame(runs, tmp_path):
    table = runs.table()
    assert [(row["problem"], row["solver"], row["setting"], row["value"]) for row in table] == [
        ("fall", "told", "rtol", 1e-2),
        ("fall", "told", "rtol", 1e-4),
    ]
    assert [row["error"] for row in table] == pytest.approx([1e-2, 1e-4])  # what the solver adds to the exact motion
    assert [row.key for row in runs.rows] == list(dict.fromkeys(row.key for row in runs.rows))
    file = tmp_path / "runs.csv"
    runs.to_csv(file)
    with file.open(newline="") as stream:
        read = list(csv.DictReader(stream))
    assert [float(row["error"]) for row in read] == [row["error"] for row in runs.table()]
    assert list(read[0]) == list(runs.table()[0])
    frame = runs.to_pandas()
    assert list(frame) == list(runs.table()[0])
    assert frame["error"].tolist() == [row["error"] for row in runs.table()]


def test_a_store_is_resumed(outside, tmp_path):
    log = tmp_path / "calls"
    asked = ("fall", f"told(log='{log}')")
    first = hb.run(*asked, store=tmp_path / "runs.sqlite", **ASKED)
    calls = log.read_text()
    second = hb.run(*asked, store=tmp_path / "runs.sqlite", **ASKED)
    assert log.read_text() == calls
    assert first.rows == second.rows


def test_numbers_of_steps_are_told_as_whole_numbers(outside):
    table = hb.run("fall", "told", steps=[5, 10], jobs=1, timing=False).table()
    assert [(row["setting"], row["value"]) for row in table] == [("steps", 5), ("steps", 10)]


@pytest.mark.parametrize(
    ("asked", "error", "text"),
    [
        ({"rtoll": [1e-3]}, TypeError, "run does not know rtoll; known: .*accuracies.*rtol"),
        ({"campaign": "quick", "rtol": [1e-3]}, hb.ProblemError, "has its own rtol"),
        ({"campaign": "quick"}, hb.NotFoundError, "the campaign has no problem 'fall'"),
        ({"campaign": "slow"}, hb.NotFoundError, "no campaign named 'slow'"),
        ({"rtol": 1e-3}, TypeError, r"rtol must be a list, rtol=\[...\]; got 0.001"),
        ({"accuracies": []}, hb.ProblemError, "between 0 and 1, at least one"),
        ({"accuracies": [-1e-3]}, hb.ProblemError, "between 0 and 1"),
        ({"accuracies": [1e-2], "rtol": [1e-3]}, hb.ProblemError, "accuracies and rtol exclude one another"),
        ({"rtol": [1e-3], "jobs": 0}, hb.ProblemError, "jobs"),
        ({"rtol": [1e-3], "executor": "dask"}, TypeError, "executor must be"),
    ],
)
def test_wrong_use_is_refused_before_anything_runs(outside, asked, error, text):
    with pytest.raises(error, match=text):
        hb.run("fall", "told", **asked)
    with pytest.raises(hb.ProblemError, match="nothing to run"):
        hb.run()
