"""Libraries that lie about their success, their rows or their status."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.solution.result import Status
from solvers import cvode, ida, scipy_ivp
from tests.adapters.liar import lying
from tests.adapters.scenes import LOOSE, problem


def set_to(**values):
    def tamper(result):
        for name, value in values.items():
            setattr(result, name, value(result))

    return tamper


LIES = {
    "not finite": set_to(y=lambda r: np.full_like(r.y, np.nan)),
    "off the circle": set_to(y=lambda r: 1.2 * r.y),
}


@pytest.mark.parametrize("lie", LIES)
@pytest.mark.parametrize(("module", "name"), [(ida, "IDA"), (cvode, "CVODE")], ids=["ida", "cvode"])
def test_a_success_that_is_none_is_unreliable(module, name, lie, monkeypatch):
    monkeypatch.setattr(module, name, lying(getattr(module, name), LIES[lie]))
    solution = hb.solve(problem(), module.solver(), rtol=1e-6)
    assert solution.status is Status.unreliable, solution.message
    assert np.isfinite(solution.q).all()
    if lie != "off the circle":
        assert solution.counters.steps_accepted == 4, "the bad step was taken"


@pytest.mark.parametrize(
    ("rtol", "factor", "believed"),
    [(1e-2, 1.05, True), (1e-2, 1.2, False), (1e-5, 1.05, True), (1e-7, 1 + 1e-4, True), (1e-7, 1.01, False)],
)
def test_the_bound_of_belief_follows_the_tolerance_up_to_a_tenth(rtol, factor, believed, monkeypatch):
    monkeypatch.setattr(ida, "IDA", lying(ida.IDA, set_to(y=lambda r: factor * r.y)))
    assert hb.solve(problem(), ida.solver(), rtol=rtol).success == believed


def test_the_largest_violation_is_told_with_its_time(monkeypatch):
    """Off the circle from the fifth step on, most at half time: there g / |q_1 + q_2| = 0.625 / 1.5 / 1.413."""
    monkeypatch.setattr(ida, "IDA", lying(ida.IDA, set_to(y=lambda r: (1.5 - abs(r.t - 0.5)) * r.y)))
    solution = hb.solve(problem(), ida.solver(), rtol=1e-6, t_eval=[0.0, 0.25, 0.5, 0.75, 1.0])
    assert solution.status is Status.unreliable
    assert "g[0] is violated by up to 0.29 of its size, most at t = 0.5" in solution.message


@pytest.mark.parametrize("module", [ida, cvode], ids=["ida", "cvode"])
def test_time_that_stands_still_ends_the_solve(module, monkeypatch):
    name, seen = "IDA" if module is ida else "CVODE", []

    def stop(result):
        seen.append(result.t)
        result.t = seen[0]

    monkeypatch.setattr(module, name, lying(getattr(module, name), stop))
    solution = module.solver().solve(problem(), LOOSE)
    assert solution.status is Status.step_too_small
    assert solution.counters.steps_accepted == 5


def test_an_end_that_was_not_reached_is_unreliable(monkeypatch):
    class Early(scipy_ivp.integrate.DOP853):
        def step(self):
            message = super().step()
            self.status = "finished"
            return message

    monkeypatch.setattr(scipy_ivp.integrate, "DOP853", Early)
    solution = scipy_ivp.solver(method="DOP853").solve(problem(), LOOSE)
    assert solution.status is Status.unreliable
    assert 0 < solution.t.size < 5

    monkeypatch.setattr(type(ida.solver()), "drive", lambda self, run: None)
    solution = ida.solver().solve(problem(), LOOSE)
    assert solution.status is Status.unreliable
    assert "stopped at t = 0" in solution.message


def test_a_library_that_raises_costs_its_own_solve_only(monkeypatch):
    class Broken:
        def __init__(self, *_, **__):
            raise RuntimeError("made")

    monkeypatch.setattr(ida, "IDA", Broken)
    solution = ida.solver().solve(problem(), LOOSE)
    assert solution.status is Status.unreliable
    assert "RuntimeError" in solution.message


@pytest.mark.parametrize("module", [ida, cvode], ids=["ida", "cvode"])
@pytest.mark.parametrize(
    ("flag", "status"), [(-3, Status.step_too_small), (-4, Status.newton_failed), (-99, Status.unreliable)]
)
def test_flags_of_sundials_have_our_names(module, flag, status, monkeypatch):
    name = "IDA" if module is ida else "CVODE"
    monkeypatch.setattr(module, name, lying(getattr(module, name), set_to(status=lambda r: flag)))
    solution = module.solver().solve(problem(), LOOSE)
    assert solution.status is status
    assert solution.counters.steps_accepted == 4 == solution.t.size - 1
