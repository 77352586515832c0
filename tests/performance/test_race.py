"""Who is fastest at equal error, with and without a bound on drift, on rows that follow known formulas."""

import pytest

from hhtbench.analysis import race
from tests.analysis.laws import EVALUATION, failed, law

HHT = "hht(alpha=-0.05)"
DOP853 = "scipy(method=DOP853)"
SETTINGS = (1e-1, 1e-2, 1e-3, 1e-4)


def field(hht=10.0, hht_drift=1e-15):
    """At error 1e-2: HHT 100, ida 200, projected 400, DOP853 50 evaluations; only DOP853 and ida drift."""
    return [
        *law(HHT, hht, 2, SETTINGS, hht_drift),
        *law("ida(form=ggl)", 20.0, 2, SETTINGS, 1e-9),
        *law("projected(method=DOP853)", 40.0, 2, SETTINGS, 1e-16),
        *law(DOP853, 5.0, 2, SETTINGS, 1e-3),
    ]


def line(rows, target=1e-2):
    (found,) = race(rows, (target,))
    return found


def test_costs_are_taken_at_the_same_error():
    found = line(field(), 1e-3)
    evaluations = 10.0 * 1e-3**-0.5
    assert found.subject.value == pytest.approx(evaluations * EVALUATION)
    assert found.factor(found.other) == pytest.approx(0.5)


def test_drift_bounds_the_holders_and_not_the_others():
    found = line(field())
    assert found.holder.entry == "projected(method=DOP853)", "ida is faster and drifts by 1e-9"
    assert found.other.entry == found.explicit.entry == DOP853
    assert found.steady
    assert found.best_holder is True
    assert found.factor(found.holder) == pytest.approx(4.0)
    assert found.drifting["ida(form=ggl)"].kind == "drifts"


def test_an_explicit_method_that_is_faster_is_told_and_one_that_is_slower_is_not():
    assert line(field()).explicit_is_faster
    assert not line(field(hht=4.0)).explicit_is_faster
    assert not line([row for row in field() if row.solver != DOP853]).explicit_is_faster


def test_a_projected_method_is_not_the_explicit_one():
    rows = [row for row in field() if row.solver != DOP853]
    assert line(rows).explicit is None


def test_a_drifting_hht_is_shown_with_its_time_but_wins_nothing():
    found = line(field(hht_drift=1e-6))
    assert found.subject is not None
    assert not found.steady
    assert found.best_holder is False


def test_who_does_not_get_there_has_a_reason():
    rows = [failed(HHT, 1e-2, "deadline", "too long"), *field()[4:]]
    found = line(rows)
    assert found.subject is None
    assert found.missing[HHT].kind == "fails"
    assert found.best_holder is False
    assert found.explicit_is_faster, "it gets there alone"


def test_a_slower_hht_is_not_the_best_holder():
    assert line(field(hht=100.0)).best_holder is False


def test_every_problem_has_a_line_for_every_target():
    rows = field() + law(HHT, 1.0, 2, SETTINGS, 1e-15, problem="andrews")
    assert [(found.problem, found.target) for found in race(rows, (1e-2, 1e-3))] == [
        ("pendulum", 1e-2),
        ("pendulum", 1e-3),
        ("andrews", 1e-2),
        ("andrews", 1e-3),
    ]
    alone = race(rows, (1e-2,))[1]
    assert alone.best_holder is True
    assert alone.holder is None
