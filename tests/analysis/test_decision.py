from __future__ import annotations

import random
from itertools import combinations

import pytest

from hhtbench.analysis import BOUNDS, Kind, decide, drift_costs, kinds
from tests.analysis.laws import failed, law, run
from tests.report.synthetic import rows as campaign

NOT_STIFF = Kind(constraints="position constraints", stiff=False)
ALL = {NOT_STIFF: ("pendulum", "andrews")}


def two_problems(solver, first, second):
    return [*law(solver, first, 2), *law(solver, second, 2, problem="andrews")]


def test_the_smallest_geometric_mean_is_the_cheapest_and_the_second_is_told_with_its_ratio():
    rows = [*two_problems("hht", 100.0, 100.0), *two_problems("ida", 400.0, 10.0), *two_problems("scipy", 300.0, 300.0)]
    (choice,) = decide(rows, ALL, "evaluations", (1e-4,))
    assert [place.entry for place in choice.places] == ["ida", "hht", "scipy"]  # means 63, 100, 300
    assert choice.places[0].mean == pytest.approx(100 * (400 * 10) ** 0.5)
    assert choice.places[1].ratio(choice.places[0]) == pytest.approx(100 / (400 * 10) ** 0.5)


def test_a_problem_that_is_not_reached_counts_what_the_campaign_allowed():
    rules = {"accuracies": [1e-4], "max_seconds": 1.0, "pair_seconds": 4.0, "refinements": 9}
    rows = [*two_problems("hht", 100.0, 100.0), *law("ida", 10.0, 2)]
    rows.append(failed("ida", 1e-4, "declined", problem="andrews"))
    for row in rows:
        row.request["rules"] = rules
    (choice,) = decide(rows, ALL, "time", (1e-4,))
    assert [(place.entry, len(place.costs)) for place in choice.places] == [("hht", 2), ("ida", 1)]
    assert choice.places[1].mean == pytest.approx((0.01 * 4.0) ** 0.5)
    assert choice.places[1].ratio(choice.places[0]) == pytest.approx((0.1 * 40.0) ** 0.5)


def test_who_was_not_run_on_all_problems_is_not_ranked():
    rows = [*two_problems("hht", 100.0, 100.0), *law("ida", 10.0, 2)]
    (choice,) = decide(rows, ALL, "time", (1e-4,))
    assert [place.entry for place in choice.places] == ["hht"]
    assert [(place.entry, place.ratio(choice.places[0])) for place in choice.partial] == [("ida", pytest.approx(0.1))]


def test_a_bound_of_the_drift_leaves_out_who_drifts_more_and_kinds_without_constraints():
    rows = [*law("hht", 100.0, 2, drift=1e-14), *law("scipy", 10.0, 2, drift=1e-7)]
    kinds_of_it = {NOT_STIFF: ("pendulum",)}
    (free,), (held,) = (decide(rows, kinds_of_it, "time", (1e-4,), bound) for bound in (None, 1e-10))
    assert [place.entry for place in free.places] == ["scipy", "hht"]
    assert [place.entry for place in held.places] == ["hht"]
    assert decide(rows, {Kind(constraints="no constraints", stiff=False): ("pendulum",)}, "time", (1e-4,), 1e-10) == ()


def test_an_error_that_no_reference_can_judge_is_no_row_and_one_that_nobody_reaches_is_an_empty_one():
    rows = law("hht", 100.0, 2)
    for row in rows:
        row.metrics["errors"]["digits"] = 3
    found = decide(rows, {NOT_STIFF: ("pendulum",)}, "time", (1e-2, 1e-4))
    assert [choice.target for choice in found] == [1e-2]
    (empty,) = decide([run("hht", 1e-1, 0.5, 10)], {NOT_STIFF: ("pendulum",)}, "time", (1e-4,))
    assert empty.places == ()


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
    sizes = {"pendulum": (2, 1, 0), "ball": (6, 1, 2), "knife": (3, 0, 1), "chain": (9, 0, 0)}
    rows = [failed("ida", 1e-3, problem=name) for name in [*sizes, "crashed"]]
    for row, (n, m, p) in zip(rows, sizes.values(), strict=False):
        row.metrics["system"] = {"n": n, "m": m, "p": p, "tags": ["stiff" if row.problem == "chain" else "damped"]}
    found = {name: kind.text for kind, names in kinds(rows).items() for name in names}
    assert found == {
        "pendulum": "position constraints, not stiff",
        "ball": "position and velocity constraints, not stiff",
        "knife": "velocity constraints, not stiff",
        "chain": "no constraints, stiff",
        "crashed": "constraints not recorded, stiffness not declared",
    }


def test_kinds_of_a_campaign_come_in_the_order_of_their_constraints():
    found = {problem: kind.constraints for kind, problems in kinds(campaign()).items() for problem in problems}
    assert list(dict.fromkeys(found.values())) == ["position constraints", "velocity constraints", "no constraints"]
    assert found["knife_edge"] == "velocity constraints"
    assert found["oscillator_chain(n=10)"] == "no constraints"
    assert len(found) == len({row.problem for row in campaign()})
