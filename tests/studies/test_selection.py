"""Regret of advice, on databases whose winners are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hhtbench.advice.families import FAMILIES, WING, drawn, family_of
from hhtbench.advice.regret import ADVICE, BEST_FIXED, FREE, THUMB
from hhtbench.advice.study import judged, study_selection
from hhtbench.protocol.errors import ProblemError
from tests.advice.synthetic import database


def line(study, policy, held_out="family", on="time"):
    (judgement,) = [j for j in study.judgements if (j.held_out, j.on, j.drift) == (held_out, on, None)]
    return next(one for one in judgement.lines if one.policy == policy)


@pytest.fixture(scope="module")
def study():
    return judged(database())


@pytest.mark.parametrize("held_out", ["problem", "family"])
def test_advice_that_follows_the_winner_has_no_regret_and_closes_the_gap(study, held_out):
    found = line(study, FREE, held_out)
    assert found.mean == pytest.approx(1.0)
    assert found.closed == pytest.approx(1.0)
    assert (found.twice, found.right) == (1.0, 1.0)
    assert found.gain[1] <= 0.0


def test_what_the_features_cost_is_counted(study):
    free, paid = line(study, FREE), line(study, ADVICE)
    best = 1e-3 * np.array([1e-2, 1e-3, 1e-4, 1e-5, 1e-6]) ** -0.2
    expected = np.exp(np.mean(np.log(1 + 1e-6 / best)))
    assert paid.mean / free.mean == pytest.approx(expected)


def test_a_fixed_choice_pays_its_factor_where_another_wins(study):
    assert line(study, "swift").mean == pytest.approx(
        8.0**0.5
    )  # right on half of the scenes, 8 times too dear on the others
    assert line(study, "swift").twice == 0.5
    assert line(study, THUMB).mean == pytest.approx(20.0)  # ida(form=ggl), constrained
    assert line(study, BEST_FIXED).closed == 0.0


def test_a_choice_that_does_not_get_there_costs_the_budget():
    known = database()
    scenes = []
    for one in known.scenes:
        costs = {key: table.copy() for key, table in one.costs.items()}
        for table in costs.values():
            table[0] = np.inf
        scenes.append(replace(one, costs=costs))
    found = line(judged(replace(known, scenes=tuple(scenes))), "ida(form=ggl)")
    best = 1e-3 * np.array([1e-2, 1e-3, 1e-4, 1e-5, 1e-6]) ** -0.2
    assert found.mean == pytest.approx(np.exp(np.mean(np.log(known.budget / best))))


def test_too_few_families_are_refused():
    with pytest.raises(ProblemError, match="three families"):
        judged(database(families=2))


def test_at_least_eighty_scenes_are_drawn_the_same_every_time_within_their_ranges():
    specs = drawn()
    assert len(set(specs)) == len(specs) >= 80
    assert specs == drawn()
    for spec in specs:
        values = dict(pair.split("=") for pair in spec.partition("(")[2].rstrip(")").split(", "))
        for name, (low, high) in {**FAMILIES, **WING}[family_of(spec)].items():
            assert 0.99 * low - 0.01 <= float(values[name]) <= 1.01 * high + 0.01


@pytest.mark.long
def test_the_database_of_the_package_is_judged_without_a_run():
    found = study_selection()
    assert found.scenes >= 90
    assert {j.held_out for j in found.judgements} == {"problem", "family"}
    assert "closed gap" in str(found)
    advice = line(found, FREE)
    assert advice.right_high < 10.0 < advice.silent_high
    assert "95%: 88% within 2x, 95 % 5.2; the rest: 5%, 95 % 5.6e+02" in str(found)  # as docs/advice.md says
