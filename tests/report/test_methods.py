"""When to take which kind of method: sentences grouped from the rows of the table to decide by."""

from __future__ import annotations

import pytest

from hhtbench.campaign.analysis.kinds import DAMPERS, Kind
from hhtbench.report.decisions import choices_of
from hhtbench.report.methods import method_of
from hhtbench.report.recommendations import recommendations
from tests.analysis.laws import law
from tests.report.test_first_screen import KIND, WHOLE


def test_the_first_sentences_say_for_which_scenes_to_take_which_kind_of_method():
    """On andrews, here with stiff dampers, HHT costs a quarter of IDA; on the soft pendulum ten times explicit steps."""
    rows = [*law("projected(method=DOP853)", 100.0, 2), *law("hht", 1000.0, 2), *law("scipy(method=Radau)", 9000.0, 2)]
    rows += [*law("hht", 100.0, 2, problem="andrews"), *law("ida(form=ggl)", 400.0, 2, problem="andrews")]
    kinds = {KIND: ("pendulum",), Kind(constraints="no constraints", forces=DAMPERS): ("andrews",)}
    first, second, third, *_ = recommendations(choices_of(rows, kinds, WHOLE), WHOLE.level, ())
    assert first == (
        "Take HHT for unconstrained systems with stiff dampers at 1e-2 and 1e-4 "
        "(1 problem, other kinds of methods cost 4 times as much where they reach it)."
    )
    assert second.startswith(
        "Take an explicit method for joints with smooth forces at 1e-2 and 1e-4 "
        "(1 problem, other kinds of methods cost 10 times"
    )
    assert third == "No row has BDF or Radau as the cheapest."


def test_a_rival_that_is_cheaper_where_it_gets_is_said_to_reach_fewer_problems():
    rows = [*law("hht", 1000.0, 2), *law("hht", 1000.0, 2, problem="andrews"), *law("ida(form=ggl)", 400.0, 2)]
    kinds = {KIND: ("pendulum", "andrews")}
    first, *_ = recommendations(choices_of(rows, kinds, WHOLE), WHOLE.level, ())
    assert first.endswith("other kinds of methods cost 0.4 times as much where they reach it, on fewer problems).")


@pytest.mark.parametrize(
    ("entry", "method"),
    [
        ("hht(alpha=-0.05), steps=N", "HHT"),
        ("hht_i3(alpha=-0.05), steps=N", "another alpha method with constant steps"),
        ("projected(method=DOP853)", "an explicit method"),
        ("cvode(form=ode, method=adams)", "an explicit method"),
        ("cvode(form=ode, method=bdf)", "BDF"),
        ("minimal(method=bdf, solver=cvode)", "BDF"),
        ("ida(form=index1)", "BDF"),
        ("scipy(method=LSODA)", "BDF"),
        ("scipy(method=Radau)", "Radau"),
        ("collocation(form=ggl)", "Radau"),
        ("rattle, steps=N", "an explicit method"),
        ("cvode(form=ode)", "BDF"),
        ("scipy", "Radau"),
    ],
)
def test_solvers_belong_to_kinds_of_methods(entry, method):
    assert method_of(entry) == method
