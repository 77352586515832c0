"""``select``: by rows, by runs, by features and a database; and where it cannot be told."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import hhtbench as hb
from hhtbench.advice import trading
from hhtbench.advice.candidates import Candidate
from hhtbench.advice.criteria import Criteria
from hhtbench.advice.database import ACCURACIES, read_database, reduced, write_database
from hhtbench.advice.features import NAMES, Probe
from hhtbench.advice.nearest import Space, compared, expected
from hhtbench.cli.main import main
from tests.advice.synthetic import database, features
from tests.advice.test_trading import CHEAP, MIDDLE
from tests.analysis.laws import law

CRITERIA = Criteria(accuracies=(1e-4,))


def told(known, looked, criteria=CRITERIA):
    return expected(known, Space.of(known), looked, criteria)


def test_the_winner_of_the_most_similar_scenes_is_expected_to_win():
    known = database()
    assert told(known, features(0.6)).order[0][0] == "swift"
    assert told(known, features(2.6)).order[0][0] == "steady"
    assert told(known, features(2.6)).agreed == 1.0


def test_a_problem_unlike_all_others_cannot_be_told():
    found = told(database(), features(0.6, size=4.0))
    assert found.distance > found.reach
    assert "away" in found.doubt


def test_neighbours_that_disagree_cannot_be_told():
    """On each of five scenes another solver is the cheapest by a factor of three."""
    known = database(families=5, each=1)
    mixed = []
    for number, one in enumerate(known.scenes):
        row = np.where(np.arange(len(known.entries)) == number, 1.0, 3.0)
        costs = {key: np.outer(row, np.ones(len(ACCURACIES))) for key in one.costs}
        mixed.append(replace(one, features=features(1.0), costs=costs))
    found = told(replace(known, scenes=tuple(mixed)), features(1.0))
    assert "of 5 neighbours only 20% have" in found.doubt


def test_a_rate_counts_beside_the_pace_and_not_beyond_what_explicit_steps_can_follow():
    """Twice the span turns all twice and leaves what is stiff as it was; 1e5 and 1e7 times the pace are alike."""
    at = [compared(features(*rates).vector)[NAMES.index("vibration")] for rates in ((2.0,), (2.3, 0.5, 0.3), (5.0,), (7.0,))]
    assert at == pytest.approx([2.0, 2.0, 4.0, 4.0])


@pytest.mark.parametrize(
    ("families", "each", "text"),
    [
        (1, 1, "too few known problems: on 1 somebody reaches this error, 5 are needed"),
        (1, 12, "the known problems are of one family, two are needed"),
    ],
)
def test_too_few_known_problems_cannot_tell_and_say_how_many_are_needed(families, each, text, tmp_path: Path):
    file = tmp_path / "few.json"
    write_database(database(families, each), file, "")
    found = hb.select("simple_pendulum", on="evaluations", database=file)
    assert found.taken is None
    assert found.text.startswith(f"Cannot tell: {text}")
    assert "inf" not in str(found)


def test_a_solver_of_a_database_is_named_as_solve_takes_it_and_beside_it_what_it_is_given(tmp_path: Path):
    file = tmp_path / "one.json"
    write_database(read_database().of_entries("hht(alpha=-0.05), steps=N".__eq__), file, "")
    found = hb.select("simple_pendulum", on="evaluations", database=file)
    assert (found.taken, found.taken_by, found.second, found.second_by) == ("hht(alpha=-0.05)", "steps", None, None)
    assert "no other is known." in found.text
    assert hb.solve("simple_pendulum", found.taken, t_span=(0.0, 0.1), **{found.taken_by: 20}).success


def test_a_database_is_written_and_read_to_two_percent(tmp_path: Path):
    known, file = database(), tmp_path / "database.json"
    write_database(known, file, "hhtbench study selection")
    again = read_database(file)
    assert again.entries == known.entries
    assert [one.spec for one in again.scenes] == [one.spec for one in known.scenes]
    for one, other in zip(again.scenes, known.scenes, strict=True):
        np.testing.assert_allclose(one.costs["time", None], other.costs["time", None], rtol=0.012)
        np.testing.assert_allclose(one.features.vector, other.features.vector, atol=5e-4)


@pytest.mark.parametrize(
    "damage",
    [
        lambda told: {"schema": told["schema"]},
        lambda told: {name: value for name, value in told.items() if name != "entries"},
        lambda told: told | {"entries": told["entries"][:1]},
        lambda told: told | {"scenes": []},
        lambda told: told | {"scenes": [{"spec": "a"}]},
        lambda told: told | {"scenes": [told["scenes"][0] | {"features": [1.0]}]},
        lambda told: told | {"scenes": 3},
        lambda told: told | {"accuracies": [1e-1]},
        lambda told: told | {"clock": 3},
        lambda told: told | {"budget": None},
        lambda told: [told],
    ],
)
def test_a_file_that_is_no_whole_database_of_this_hhtbench_is_refused(damage, tmp_path: Path):
    file = tmp_path / "database.json"
    write_database(database(), file, "")
    file.write_text(json.dumps(damage(json.loads(file.read_text()))))
    with pytest.raises(hb.ProblemError, match=r"database\.json is (no database|damaged)"):
        hb.select("simple_pendulum", database=file)


def test_a_store_that_a_trade_is_to_make_need_not_be_there(prices, monkeypatch, tmp_path: Path):
    file = tmp_path / "new.sqlite"
    asked = ["select", "fall", "--accuracy", "1e-2", "--on", "evaluations", "--store", str(file)]
    assert CliRunner().invoke(main, asked).exit_code == 2
    monkeypatch.setattr(trading, "CANDIDATES", (Candidate(CHEAP),))
    result = CliRunner().invoke(main, [*asked, "--seconds", "60"])
    assert result.exit_code == 0, result.output
    assert result.output.startswith(f"Take {CHEAP}")
    assert file.exists()


def test_rows_are_reduced_to_what_each_solver_paid_and_infinite_where_it_did_not_get_there():
    rows = [*law("ida", 50.0, 4, settings=(1e-1, 1e-3), drift=1e-5), *law("hht", 90.0, 4, drift=1e-13)]
    made = reduced(rows, {"pendulum": Probe(features=features(1.0), evaluations=10, seconds=1e-3)})
    free, held = (made.scenes[0].costs["evaluations", bound] for bound in (None, 1e-10))
    ida, hht = (made.entries.index(name) for name in ("ida", "hht"))
    np.testing.assert_allclose(free[ida], [50 * 100**0.25, 50 * 1000**0.25, np.inf, np.inf, np.inf])
    np.testing.assert_allclose(held[hht], 90 * np.array(ACCURACIES) ** -0.25)
    assert np.all(np.isinf(held[ida]))


def test_the_database_of_the_package_is_small_and_knows_eighty_scenes():
    file = Path(hb.__file__).parent / "advice" / "database.json"
    assert file.stat().st_size < 200_000
    known = read_database()
    assert len(known.scenes) >= 80
    assert len({one.family for one in known.scenes}) >= 20


def test_times_of_another_machine_are_refused_and_evaluations_used(tmp_path: Path):
    file = tmp_path / "other.json"
    known = database()
    write_database(replace(known, clock={**known.clock, "processor": "abacus"}), file, "")
    found = hb.select("simple_pendulum", accuracy=1e-4, database=file)
    assert found.on == "evaluations"
    assert "another machine (abacus" in found.reason
    write_database(replace(known, versions={"numpy": "0.1"}), file, "")
    assert "numpy 0.1, here" in hb.select("simple_pendulum", accuracy=1e-4, database=file).reason
    assert hb.select("simple_pendulum", accuracy=1e-4, on="evaluations", database=file).on == "evaluations"


def test_advice_from_features_shows_evidence_domain_and_reason():
    found = hb.select(hb.load_problem("simple_pendulum"), accuracy=1e-4, on="evaluations")
    assert found.taken is not None
    assert found.text.startswith(f"Take {found.taken}")
    assert "known problems, nearest: " in found.evidence
    assert "errors 0.01 to 1e-06; distance" in found.domain
    assert found.reason.startswith("n = 2, m/n = 0.5")


def test_an_error_outside_of_the_database_and_python_callables_by_time_cannot_be_told(tmp_path: Path):
    found = hb.select("simple_pendulum", accuracy=1e-9, on="evaluations")
    assert (found.taken, found.text.partition(":")[0]) == (None, "Cannot tell")
    file = tmp_path / "here.json"
    write_database(database(), file, "")
    system = hb.NumpySystem(force=lambda t, q, v: -q)
    problem = hb.Problem(name="p", system=system, t_span=(0.0, 1.0), q0=[1.0], v0=[0.0])
    assert "called in Python" in hb.select(problem, database=file).text


@pytest.mark.parametrize(
    ("asked", "text"),
    [
        ({"accuracy": 2e-2}, "knows errors from 0.01 to 1e-06; asked was 0.02"),
        ({"accuracy": 5e-7}, "knows errors from 0.01 to 1e-06; asked was 5e-07"),
        ({"drift": 1e-15}, "knows drifts of at most 1e-10; asked was 1e-15"),
    ],
)
def test_errors_and_drifts_beyond_those_of_the_database_cannot_be_told(asked, text):
    found = hb.select("simple_pendulum", on="evaluations", **asked)
    assert found.taken is None
    assert text in found.text


def test_a_bound_that_the_error_contains_is_none_and_a_tighter_one_is_the_known_one():
    free = hb.select("simple_pendulum", on="evaluations")
    loose = hb.select("simple_pendulum", on="evaluations", drift=1e-3)
    held = hb.select("simple_pendulum", on="evaluations", drift=1e-10)
    between = hb.select("simple_pendulum", on="evaluations", drift=1e-8)
    assert (loose.taken, loose.second) == (free.taken, free.second)
    assert "at an error of 0.0001 and any drift (asked: 0.001); " in loose.text
    assert (between.taken, between.second) == (held.taken, held.second) != (free.taken, free.second)
    assert "at an error of 0.0001 and a drift of at most 1e-10; " in held.text
    assert "at an error of 0.0001 and a drift of at most 1e-10 (asked: 1e-08); " in between.text


def test_the_error_that_was_compared_is_told():
    text = hb.select("simple_pendulum", on="evaluations", accuracy=3e-3).text
    assert "at an error of 0.001 (asked: 0.003); " in text


def test_functions_that_raise_cannot_be_told():
    def force(t, q, v):
        if t > 0.0:
            raise ValueError("the table ends at 0 s")
        return -q

    problem = hb.Problem(name="p", system=hb.NumpySystem(force=force), t_span=(0.0, 1.0), q0=[1.0], v0=[0.0])
    assert "ValueError: the table ends at 0 s" in hb.select(problem, on="evaluations").text


def test_runs_of_the_problem_itself_come_first_and_their_number_is_the_evidence(prices, tmp_path: Path):
    store = tmp_path / "runs.sqlite"
    hb.trade("fall", accuracies=[1e-2], solvers=[CHEAP, MIDDLE], on="evaluations", jobs=1, store=store, seconds=300)
    found = hb.select("fall", accuracy=1e-2, on="evaluations", store=store)
    assert (found.taken, found.second) == (CHEAP, MIDDLE)
    assert found.evidence.endswith("runs in runs.sqlite")
    assert found.domain == "this problem, error 0.01"
    assert found.text.endswith("The problem declares no scales: errors are in its own units.")
    assert "declares no scales" not in hb.select("simple_pendulum", on="evaluations").text


def test_the_command_prints_the_advice_and_leaves_with_one_where_it_cannot_tell(tmp_path: Path):
    file = tmp_path / "advice.json"
    result = CliRunner().invoke(main, ["select", "simple_pendulum", "--on", "evaluations", "--json", str(file)])
    assert result.exit_code == 0, result.output
    assert json.loads(file.read_text())["taken"] in result.output
    result = CliRunner().invoke(main, ["select", "simple_pendulum", "--accuracy", "1e-9", "--on", "evaluations"])
    assert result.exit_code == 1
    result = CliRunner().invoke(main, ["select", "simpel_pendulum"])
    assert result.exit_code == 2
    assert "Did you mean simple_pendulum" in result.output


@pytest.mark.parametrize(
    ("asked", "error", "text"),
    [
        ({"accuracy": 3.0}, hb.ProblemError, "between 0 and 1"),
        ({"seconds": -1.0}, hb.ProblemError, "must not be negative"),
        ({"on": "memory"}, hb.ProblemError, "time or evaluations"),
        ({"database": "absent.json"}, hb.ProblemError, "absent.json cannot be read"),
    ],
)
def test_wrong_use_is_refused(asked, error, text):
    with pytest.raises(error, match=text):
        hb.select("simple_pendulum", **asked)
    with pytest.raises(TypeError, match="belong to a spec"):
        hb.select(hb.load_problem("simple_pendulum"), seconds=3.0)
