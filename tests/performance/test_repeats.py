"""The A/A measurement on rows whose spread is known."""

from __future__ import annotations

import random

from hhtbench.campaign.analysis import points
from tests.analysis.laws import law
from tests.performance.repeats import against_themselves


def noisy(spread, solvers=40, seed=3):
    source = random.Random(seed)
    rows = []
    for problem in ("a", "b", "c"):
        for number in range(solvers):
            for row in law(f"s{number}", 10.0, 2, problem=problem):
                row.timing["rounds_s"] = [row.timing["best_s"] * 2 ** source.gauss(0.0, spread) for _ in range(2)]
                rows.append(row)
    return rows


def test_noise_of_any_size_is_no_difference_in_99_of_100_comparisons():
    for spread in (0.0, 0.02, 0.5):
        found = against_themselves(points(noisy(spread)))
        assert found.count == 3 * 40 * 6
        assert found.share >= 0.98


def test_a_clock_that_runs_away_between_the_rounds_is_found_where_others_are_steady():
    rows = noisy(0.02)
    for row in rows:
        if row.problem == "a":
            row.timing["rounds_s"][1] *= 1.5
    found = against_themselves(points(rows))
    assert {problem for problem, *_ in found.differing} == {"a"}
    assert len(found.differing) == 40 * 6
