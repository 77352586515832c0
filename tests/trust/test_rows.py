"""What a result shows without any physics: every fault is named by the check that finds it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import hhtbench as hb
from hhtbench import Counters, NumpySystem, Problem, Request, Solution, Status
from hhtbench.checks.result.repeated import ends_elsewhere, impossible_work
from hhtbench.checks.result.success import doubt_about
from tests.trust.faulty import Returning

FALL = Problem(name="fall", system=NumpySystem(force=lambda t, q, v: 0 * q - 9.81), t_span=(0.0, 1.0), q0=[1.0], v0=[0.0])
ASKED = Request(rtol=1e-4, t_eval=np.linspace(0.0, 1.0, 5))


def fallen(t: Any = None, **changes: Any) -> Solution:
    times = np.asarray(ASKED.t_eval if t is None else t, dtype=float)
    none = np.zeros((times.size, 0))
    true: dict[str, Any] = {"t": times, "q": 1 - 9.81 * times[:, None] ** 2 / 2, "v": -9.81 * times[:, None]}
    true |= {"lam": none, "mu": none, "status": Status.success, "message": "there"}
    return Solution(**{**true, **changes})


def with_nan(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array[2] = np.nan
    return array


GOOD = fallen()
WRONG = {
    "type": [None, 3.0, replace(GOOD, status="success")],
    "shapes": [
        replace(GOOD, q=GOOD.q[:-1]),
        replace(GOOD, v=np.zeros((5, 2))),
        replace(GOOD, t=GOOD.t[:, None]),
        replace(GOOD, q=GOOD.q.tolist()),
        replace(GOOD, q=GOOD.q.astype(complex)),
        replace(GOOD, lam=np.zeros((4, 0))),
    ],
    "finiteness": [replace(GOOD, **{name: with_nan(getattr(GOOD, name))}) for name in ("q", "v", "t")],
    "order of times": [fallen([0.0, 0.5, 0.25, 0.75, 1.0])],
    "end": [fallen([0.0, 0.25, 0.5]), fallen(np.zeros(0)), fallen([0.0, 0.25, 0.5, 0.75, 1.001])],
    "end: a terminal event is reported": [
        fallen([0.0, 0.25, 0.4], status=Status.event),
        fallen([0.0, 0.25, 0.4], status=Status.event, t_events=(np.array([0.25]), np.zeros(0))),
    ],
    "output times": [fallen([0.0, 0.5, 1.0]), fallen([0.0, 0.26, 0.5, 0.75, 1.0])],
    "start": [replace(GOOD, q=GOOD.q + 0.01), replace(GOOD, v=GOOD.v - 0.01)],
    "counters": [
        replace(GOOD, counters=Counters(residual_evaluations=0, steps_accepted=7)),
        replace(GOOD, counters=Counters(residual_evaluations=3, steps_accepted=7)),
        replace(GOOD, counters=Counters(residual_evaluations=9, linear_solves=-1)),
        replace(GOOD, counters=Counters(residual_evaluations=1e9)),  # type: ignore[arg-type]
    ],
}


@pytest.mark.parametrize(("check", "wrong"), [(check, one) for check, many in WRONG.items() for one in many])
def test_what_is_wrong_is_named_by_its_check(check: str, wrong: Any):
    assert doubt_about(FALL, ASKED, wrong).startswith(check)


def test_the_truth_is_believed():
    assert doubt_about(FALL, ASKED, GOOD) == ""
    backward = Problem(**{**vars(FALL), "t_span": (1.0, 0.0), "q0": GOOD.q[-1], "v0": GOOD.v[-1]})
    assert doubt_about(backward, Request(rtol=1e-4, t_eval=ASKED.t_eval[::-1]), fallen(ASKED.t_eval[::-1])) == ""
    assert doubt_about(FALL, Request(rtol=1e-4), fallen([0.0, 0.1, 1.0])) == ""


def test_a_start_may_be_off_by_the_tolerance():
    assert doubt_about(FALL, replace(ASKED, rtol=1e-2), replace(GOOD, q=GOOD.q + 0.009)) == ""


def test_rows_end_with_the_terminal_event_and_a_failure_claims_nothing():
    ended: dict[str, Any] = {"status": Status.event, "counters": Counters(residual_evaluations=4)}
    stopped = fallen([0.0, 0.25, 0.4], t_events=(np.array([0.1]), np.array([0.4])), **ended)
    assert doubt_about(FALL, ASKED, stopped) == ""
    assert doubt_about(FALL, ASKED, fallen([0.0, 0.25], status=Status.newton_failed)) == ""


def test_a_solver_that_says_nothing_about_its_work_has_reported_nothing():
    assert doubt_about(FALL, ASKED, GOOD) == ""
    assert GOOD.counters.residual_evaluations is None
    assert GOOD.counters.steps_accepted is None


def test_rows_at_the_ends_of_steps_are_counted():
    told = Counters(residual_evaluations=9, steps_accepted=4)
    assert doubt_about(FALL, Request(rtol=1e-4), fallen(counters=told)) == ""
    halved = replace(told, steps_accepted=2)
    assert doubt_about(FALL, ASKED, fallen(counters=halved)) == ""
    found = doubt_about(FALL, Request(rtol=1e-4), fallen(counters=halved))
    assert found == "counters: 5 rows at the ends of steps are too many for 2 steps."


def test_more_work_than_there_was_time_for_is_a_fault():
    many = Counters(residual_evaluations=10**9)
    assert impossible_work(many, 0.01).startswith("counters: 1e+09 residual_evaluations")
    assert impossible_work(many, 1.0) == ""


def test_two_solves_of_the_same_must_end_alike():
    alike, other = fallen([1.0]), fallen([1.0], v=np.array([[-5.0]]))
    assert ends_elsewhere(FALL, ASKED, GOOD, alike) == ""
    assert ends_elsewhere(FALL, ASKED, GOOD, other).startswith("repetition: ")
    nearly = fallen([1.0], q=GOOD.q[-1:] + 0.01)
    assert ends_elsewhere(FALL, ASKED, GOOD, nearly) == ""
    assert ends_elsewhere(FALL, replace(ASKED, rtol=1e-8), GOOD, nearly).startswith("repetition: ")


def test_solve_does_not_believe_a_plugin_either():
    for returned, believed in ((WRONG["shapes"][0], False), (GOOD, True)):
        found = hb.solve(FALL, Returning(returned), rtol=1e-4, t_eval=ASKED.t_eval)
        assert found.success is believed
        assert believed or (found.status is Status.unreliable and found.message.startswith("shapes"))
