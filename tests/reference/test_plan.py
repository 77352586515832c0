"""Plans of references: what is read, refused, chosen."""

import numpy as np
import pytest

from hhtbench.campaign.reference.certify import times_of
from hhtbench.campaign.reference.plan import RTOL, SECOND, choose, load_plan, registered_folder, registered_plans
from hhtbench.catalogue.registry import load_problem
from hhtbench.protocol.errors import NotFoundError, ProblemError

TWO = """
[chain_short]
spec = "planar_chain(n_links=1)"
times = [1.0]

[chain_long]
spec = "planar_chain(n_links=64)"
times = [0.25, 1]
grid = 5
first = "ida(form=ggl)"
second = ["projected", "cvode(form=ode)"]
rtol = 1e-10
note = "chaotic"
"""


@pytest.fixture
def plan_of(tmp_path):
    def read(text):
        (tmp_path / "plan.toml").write_text(text, encoding="utf-8")
        return load_plan(tmp_path / "plan.toml")

    return read


def test_entry_holds_what_the_file_says_and_defaults_for_the_rest(plan_of):
    short, long = plan_of(TWO).values()
    assert (short.name, short.spec, short.times) == ("chain_short", "planar_chain(n_links=1)", (1.0,))
    assert (short.rtol, short.second, short.note) == (RTOL, SECOND, "")
    assert (long.times, long.grid, long.first) == ((0.25, 1), 5, "ida(form=ggl)")
    assert (long.second, long.rtol, long.note) == (("projected", "cvode(form=ode)"), 1e-10, "chaotic")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[a]\ntimes = [1.0]", r"\[a\] of the plan must hold spec and times and may hold .*rtol"),
        ("[a]\nspec = 'andrews'\ntimes = [1]\nrtoll = 1e-3", r"\[a\] of the plan must hold spec and times and may hold"),
        ("[a]\nspec = 'andrews'\ntimes = [1]\nname = 'b'", r"\[a\] of the plan must hold"),
        ("a = 3", r"\[a\] of the plan must hold"),
        ("[a\n", r"the plan plan.toml cannot be read: Expected"),
    ],
)
def test_wrong_plan_is_refused_with_what_it_may_hold(plan_of, text, said):
    with pytest.raises(ProblemError, match=said):
        plan_of(text)


def test_missing_plan_is_named(tmp_path):
    with pytest.raises(ProblemError, match=r"the plan none.toml cannot be read"):
        load_plan(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("names", "chosen"),
    [
        ((), ["chain_short", "chain_long"]),
        (("chain_long",), ["chain_long"]),
        (("planar_chain",), ["chain_short", "chain_long"]),
        (("planar_chain(n_links=1)",), ["chain_short"]),
        (("chain_long", "planar_chain"), ["chain_long", "chain_short"]),
    ],
)
def test_entries_are_chosen_by_their_name_their_spec_or_their_problem_each_once(plan_of, names, chosen):
    assert [entry.name for entry in choose(plan_of(TWO), names)] == chosen


def test_unknown_name_suggests_the_closest(plan_of):
    said = r"'chain_shrot'\. Did you mean chain_short\? Planned: chain_long, chain_short\."
    with pytest.raises(NotFoundError, match=said):
        choose(plan_of(TWO), ("chain_shrot",))


def test_library_registers_its_plan_beside_its_references():
    assert load_plan(registered_folder() / "plan.toml") == registered_plans()


@pytest.mark.parametrize(
    ("times", "grid", "expected"),
    [
        ((0.3, 1.0), 0, [0.3, 1.0]),
        ((0.3,), 4, [0.0, 0.25, 0.3, 0.5, 0.75, 1.0]),
        ((1.0, 0.25), 4, [0.0, 0.25, 0.5, 0.75, 1.0]),
        ((0.1 + 0.2,), 10, [0.0, 0.1, 0.2, 0.1 + 0.2, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0]),  # 0.30000000000000004 for 0.3
    ],
)
def test_stated_times_and_the_grid_are_merged_each_once(planned, times, grid, expected):
    entry = planned("method=B, form=ode", times=times, grid=grid)
    found = times_of(entry, load_problem(entry.spec))
    np.testing.assert_allclose(found, expected, rtol=1e-15)
    assert set(times) <= set(found)


def test_stated_time_outside_of_the_interval_is_refused(planned):
    entry = planned(times=(0.5, 1.5))
    with pytest.raises(ProblemError, match=r"fall: the time 1.5 s lies outside of .*:fall, \[0, 1\] s"):
        times_of(entry, load_problem(entry.spec))
