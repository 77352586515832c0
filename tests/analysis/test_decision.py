from __future__ import annotations

import random
from itertools import combinations

import pytest

from hhtbench.campaign.analysis import decide, drift_costs, kinds
from hhtbench.campaign.analysis.fronts import BOUNDS
from hhtbench.campaign.analysis.kinds import SMOOTH, Kind
from tests.analysis.laws import failed, ladder, law, run
from tests.report.synthetic import rows as campaign

NOT_STIFF = Kind(constraints="position constraints", forces=SMOOTH)
ALL = {NOT_STIFF: ("pendulum", "andrews")}


def two_problems(solver, first, second):
    return [*law(solver, first, 2), *law(solver, second, 2, problem="andrews")]


def test_the_smallest_geometric_mean_is_the_cheapest_and_the_second_is_told_with_its_ratio():
    rows = [*two_problems("hht", 100.0, 100.0), *two_problems("ida", 400.0, 10.0), *two_problems("scipy", 300.0, 300.0)]
    (choice,) = decide(rows, ALL, "evaluations", (1e-4,))
    assert [place.entry for place in choice.places] == ["ida", "hht", "scipy"]  # means 63, 100, 300
    assert choice.places[0].mean == pytest.approx(100 * (400 * 10) ** 0.5)
    assert choice.places[1].mean == pytest.approx(100 * 100)


def test_who_reaches_more_stands_first_however_cheap_the_others_are():
    rows = [*two_problems("hht", 500.0, 500.0), *law("ida", 1.0, 2), failed("ida", 1e-4, problem="andrews")]
    (choice,) = decide(rows, ALL, "time", (1e-4,))
    assert [(place.entry, len(place.costs)) for place in choice.places] == [("hht", 2), ("ida", 1)]
    first, second = choice.places
    assert second.missing == {("andrews", 1e-4): "fails"}
    beside = second.over(first)
    assert (beside.value, beside.goals) == (pytest.approx(1 / 500), 1)
    assert (beside.at_most, beside.at_least) == (False, False)


def test_what_is_not_reached_is_in_no_mean_whatever_was_allowed_there():
    late = failed("ida", 1e-2, "deadline", problem="andrews")
    late.timing["solve_s"] = 250.0
    for budget in (2.0, 600.0):
        rows = ladder([*law("ida", 10.0, 2), late], pair_seconds=budget, max_seconds=1.0)
        (choice,) = decide(rows, ALL, "time", (1e-4,))
        assert choice.places[0].mean == pytest.approx(0.01)


def test_a_ratio_is_that_of_the_goals_that_both_reach_and_says_which_side_is_a_bound():
    rows = [*two_problems("hht", 100.0, 100.0), *law("ida", 400.0, 2), run("ida", 1e-6, 1e-6, 50, problem="andrews")]
    (choice,) = decide(rows, ALL, "evaluations", (1e-4,))
    hht, ida = sorted(choice.places, key=lambda place: place.entry)
    assert ida.over(hht).value == pytest.approx((4 * 50 / 1e4) ** 0.5)
    assert (ida.over(hht).at_most, ida.over(hht).at_least) == (True, False)
    assert (hht.over(ida).at_most, hht.over(ida).at_least) == (False, True)
    (choice,) = decide([*law("hht", 1.0, 2), *law("ida", 1.0, 2, problem="andrews")], ALL, "time", (1e-4,))
    assert choice.places[0].over(choice.places[1]) is None


def test_who_is_not_run_stopped_or_too_coarse_stands_behind_whoever_reaches_more_with_the_reason():
    coarse = (1e-1, 1e-2)
    rows = ladder([*two_problems("hht", 100.0, 100.0), *law("ida", 10.0, 2)])
    rows += ladder([*law("cvode", 20.0, 2), *law("cvode", 10.0, 2, coarse, problem="andrews")])
    rows += [*law("scipy", 30.0, 2), *law("scipy", 10.0, 2, coarse, problem="andrews")]
    rows += [*law("rattle", 40.0, 2), failed("rattle", 1e-4, problem="andrews")]
    (choice,) = decide(rows, ALL, "time", (1e-4,))
    reasons = {place.entry: [*place.missing.values()] for place in choice.places}
    assert list(reasons.items()) == [
        ("hht", []),
        ("ida", ["not run"]),
        ("cvode", ["unfinished"]),
        ("scipy", ["not asked"]),
        ("rattle", ["fails"]),
    ]


def test_a_bound_of_the_drift_leaves_out_who_drifts_more_and_problems_without_constraints():
    rows = [*law("hht", 100.0, 2, drift=1e-14), *law("scipy", 10.0, 2, drift=1e-7)]
    kinds_of_it = {NOT_STIFF: ("pendulum",)}
    (free,), (held,) = (decide(rows, kinds_of_it, "time", (1e-4,), bound) for bound in (None, 1e-10))
    assert [place.entry for place in free.places] == ["scipy", "hht"]
    assert [(place.entry, len(place.costs)) for place in held.places] == [("hht", 1), ("scipy", 0)]
    assert held.places[1].missing == {("pendulum", 1e-4): "drifts"}
    unheld = [*law("hht", 100.0, 2), *law("scipy", 10.0, 2)]  # no drift was measured, whatever the kind is said to be
    assert decide(unheld, kinds_of_it, "time", (1e-4,), 1e-10) == ()
    (mixed,) = decide(rows + law("hht", 1.0, 2, problem="andrews"), ALL, "time", (1e-4,), 1e-10)
    assert mixed.problems == ("pendulum",)


def test_an_error_that_no_reference_can_judge_is_no_row_and_one_that_nobody_reaches_is_an_empty_one():
    rows = law("hht", 100.0, 2)
    for row in rows:
        row.metrics["errors"]["digits"] = 3
    found = decide(rows, {NOT_STIFF: ("pendulum",)}, "time", (1e-2, 1e-4))
    assert [choice.target for choice in found] == [1e-2]
    (empty,) = decide(ladder([run("hht", 1e-1, 0.5, 10)], refinements=1), {NOT_STIFF: ("pendulum",)}, "time", (1e-4,))
    assert not empty.places[0].costs


@pytest.mark.parametrize("bound", BOUNDS)
def test_no_two_solvers_change_their_order_when_a_third_comes_or_goes(bound):
    rows = campaign()

    def order(kept):
        found = decide(kept, kinds(kept), "time", (1e-2, 1e-4), bound)
        return {(c.kind, c.target, *pair) for c in found for pair in combinations([p.entry for p in c.places], 2)}

    whole, solvers = order(rows), sorted({row.solver for row in rows})
    for gone in random.Random(2).sample(solvers, 4):
        name = gone.replace("'", "")
        assert order([row for row in rows if row.solver != gone]) == {pair for pair in whole if name not in pair}


def test_drift_and_cost_are_those_of_the_run_that_is_accurate_enough_beside_hht():
    rows = [*law("hht", 100.0, 2, drift=2e-15), *law("scipy(method=DOP853)", 20.0, 2, drift=3e-8)]
    (line,) = drift_costs(rows, "evaluations", 1e-4)["scipy(method=DOP853)"]
    assert (line.problem, line.drift) == ("pendulum", 3e-8)
    assert line.ratio == pytest.approx(0.2)
    assert drift_costs([row for row in rows if row.solver != "hht"], "time") == {}


def test_kinds_are_those_of_the_problem_mixed_ones_and_those_where_every_run_failed_too():
    sizes = {"pendulum": (2, 1, 0), "ball": (6, 1, 2), "knife": (3, 0, 1), "chain": (9, 0, 0), "broken": (2, None, None)}
    rows = [failed("ida", 1e-3, problem=name) for name in [*sizes, "crashed"]]
    tags = {"chain": ["stiff"], "pendulum": ["nonlinear reaction"]}
    for row, (n, m, p) in zip(rows, sizes.values(), strict=False):
        row.metrics["system"] = {"n": n, "m": m, "p": p, "tags": tags.get(row.problem, [])}
    found = {name: kind.text for kind, names in kinds(rows[::-1]).items() for name in names}
    assert list(found) == ["pendulum", "ball", "knife", "chain", "broken", "crashed"], "in the order of their constraints"
    assert found == {
        "pendulum": "position constraints, nonlinear reaction, not stiff",
        "ball": "position and velocity constraints, not stiff",
        "knife": "velocity constraints, not stiff",
        "chain": "no constraints, stiff vibrations",
        "broken": "constraints not recorded, not stiff",
        "crashed": "constraints not recorded, stiffness not recorded",
    }


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 0, 2)])
def test_a_row_that_knows_less_of_its_problem_does_not_hide_one_that_knows_more(order):
    rows = [failed("ida", 10.0**-k) for k in range(3)]
    rows[0].metrics["system"] = {"n": 2, "m": 1, "p": 0, "tags": ["stiff"]}
    rows[1].metrics["system"] = {"n": 2, "m": None, "p": None, "tags": ["stiff"]}
    assert [kind.text for kind in kinds([rows[k] for k in order])] == ["position constraints, stiff vibrations"]


@pytest.mark.parametrize(
    ("tags", "forces"),
    [
        (["damped"], "not stiff"),
        (["flexible"], "stiff vibrations"),
        (["stiff", "damped"], "stiff dampers"),
        (["stiff", "damped", "contact"], "contact"),
    ],
)
def test_beams_bushings_and_contact_are_kinds_of_their_own(tags, forces):
    row = failed("ida", 1e-3)
    row.metrics["system"] = {"n": 2, "m": 0, "p": 0, "tags": tags}
    assert [kind.text for kind in kinds([row])] == [f"no constraints, {forces}"]
