from __future__ import annotations

from collections import Counter
from dataclasses import replace

from hhtbench.campaign.analysis import drift_series, failures, newest, points, statuses
from hhtbench.campaign.analysis.outcomes import machines
from tests.analysis.laws import failed, run
from tests.report.synthetic import rows as campaign


def test_every_failed_row_is_in_the_failures_once():
    rows = campaign()
    keys = [row.key for line in failures(rows) for row in line.rows]
    assert Counter(keys) == Counter(row.key for row in rows if not row.success)
    assert sum(statuses(rows).values()) == len(rows)


def test_messages_that_differ_by_numbers_alone_are_one_reason_and_names_with_digits_are_none():
    told = ["RK45: no step below 1e-3 at t = 0.1", "RK45: no step below 2 at t = -4.", "RK23: no step below 1e-3 at t = 0.1"]
    rows = [failed("cvode", 1e-3, status="declined")] + [failed("ida", 1e-3, message=text) for text in told]
    assert [(one.message, len(one.rows)) for one in failures(rows)] == [(told[0], 2), (told[2], 1), ("no convergence", 1)]
    assert [one.text for one in failures(rows)] == [f"{told[0]} (the first; numbers differ)", told[2], "no convergence"]
    assert failures([rows[1], rows[1]])[0].text == told[0]


def test_exit_codes_are_no_numbers_that_may_differ():
    told = ["the worker died: exit code 1", "the worker died: exit code 137", "the worker died: exit code 137"]
    assert [len(one.rows) for one in failures(failed("ida", 1e-3, message=text) for text in told)] == [1, 2]


def test_counter_that_was_not_reported_is_absent_and_zero_stays_zero():
    row = run("ida", 1e-3, 1e-3, 100, counters={"steps_accepted": 0, "newton_iterations": None, "provenance": "library"})
    (line,) = points([row])
    assert (line.counts, line.provenance) == ({"steps_accepted": 0}, "library")


def test_drift_stands_with_every_row_at_every_level():
    found = {"position": 1e-9, "velocity": 1e-7, "acceleration": None, "energy": 0.0}
    full, empty = points([run("ida", 1e-3, 1e-3, 100, metrics={"drift": found}), failed("ida", 1e-4)])
    assert (full.position, full.velocity, full.acceleration, full.energy) == (1e-9, 1e-7, None, 0.0)
    assert (empty.position, empty.status) == (None, "newton_failed")


def test_drift_series_of_a_failed_run_goes_as_far_as_it_came():
    row = run("ida", 1e-3, 1e-3, 100, status="deadline", series={"drift": {"t": [0.0, 1.0], "position": [0.0, 1e-9]}})
    (series,) = drift_series([row, failed("ida", 1e-4)], "position")
    assert (series.t, series.value, series.point.status) == ((0.0, 1.0), (0.0, 1e-9), "deadline")
    assert drift_series([row], "velocity") == ()


def test_run_that_is_not_believed_is_not_said_to_have_reached_the_end():
    (line,) = failures([run("ida", 1e-3, 1e-3, 100, status="unreliable")])
    assert line.reached is None


def test_newest_row_of_a_cell_stands_for_it_whatever_its_output():
    rows = [run("ida", 1e-3, 1e-3, 100, key=key, created=day) for key, day in (("a", "2026-01-02"), ("b", "2026-01-01"))]
    rows[1].request["outputs"] = 11
    found = newest([*rows, run("ida", 1e-4, 1e-3, 100)])
    assert [row.key for row in found.rows] == ["a", "ida/0.0001"]
    assert (found.left_out, found.cells, found.versions) == (1, 1, 2)


def test_rows_of_two_machines_are_told_apart():
    rows = [run("ida", 1e-3, 1e-3, 100), run("ida", 1e-4, 1e-3, 100)]
    rows.append(replace(rows[0], environment={"python": "3.13"}))
    assert machines(rows) == [
        ({"python": "3.11"}, 2),
        ({"python": "3.13"}, 1),
    ]
