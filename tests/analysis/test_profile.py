from __future__ import annotations

import random

import pytest

from hhtbench.campaign.analysis import profiles, reaches
from tests.analysis.laws import EVALUATION, failed, law, run
from tests.report.synthetic import rows as campaign


def share(found, entry, cost):
    """Of all pairs that ``entry`` reaches within ``cost``."""
    (own,) = [profile for profile in found if profile.entry == entry]
    return max((s for c, s in zip(own.cost, own.share, strict=True) if c <= cost), default=0.0)


def test_share_of_problem_error_pairs_is_counted_by_hand():
    rows = law("hht", 100.0, 2, settings=(1e-1, 1e-2, 1e-4))  # 316, 1000 and 10,000 evaluations
    found = profiles(reaches(rows, "evaluations", (1e-1, 1e-2, 1e-3, 1e-5)))
    assert [share(found, "hht", cost) for cost in (300, 400, 2000, 20_000)] == pytest.approx([0, 0.25, 0.5, 0.75])


def test_cost_is_that_of_the_first_run_that_reaches_the_error():
    rows = [run("hht", 1e-1, 5e-1, 100), failed("hht", 1e-2), run("hht", 1e-3, 1e-3, 900), run("hht", 1e-4, 1e-4, 300)]
    (reach,) = reaches(rows, "time", (1e-2,))
    assert reach.cost == pytest.approx(900 * EVALUATION)


def test_unreached_stays_unreached_however_much_is_spent():
    found = profiles(reaches([*law("hht", 1.0, 2), run("ida", 1e-9, 0.5, 1e9)], "time", (1e-2,)))
    assert share(found, "ida", float("inf")) == 0.0
    assert share(found, "hht", float("inf")) == 1.0


def test_problems_weigh_the_same_however_many_of_their_errors_can_be_judged():
    rows = [*law("hht", 1.0, 2), *law("ida", 1.0, 2), *law("hht", 1.0, 2, problem="andrews")]
    for row in rows:
        if row.problem == "pendulum":
            row.metrics["errors"]["digits"] = 2  # errors below 1e-2 are judged of nobody
    found = reaches(rows, "time", (1e-1, 1e-2, 1e-3, 1e-4))
    assert sum(reach.weight for reach in found if reach.entry == "hht") == pytest.approx(1.0)
    assert sum(reach.weight for reach in found if reach.problem == "andrews") == pytest.approx(0.5)
    assert share(profiles(found), "ida", float("inf")) == pytest.approx(0.5)  # who was not run there has not reached it


def test_no_curve_changes_when_a_solver_comes_or_goes():
    rows = campaign()
    whole = {profile.entry: profile for profile in profiles(reaches(rows, "time"))}
    solvers = sorted({row.solver for row in rows})
    for gone in random.Random(1).sample(solvers, 5):
        kept = profiles(reaches([row for row in rows if row.solver != gone], "time"))
        assert len(kept) == len(whole) - 1
        assert all(profile == whole[profile.entry] for profile in kept)
