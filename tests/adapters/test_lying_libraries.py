"""Libraries that lie about their success, their rows or their status."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.request import Request
from hhtbench.result import Status
from solvers import cvode, diffrax_ode, ida, scipy_ivp
from tests.adapters.liar import lying
from tests.adapters.scenes import HOST, numpy_ring, problem

TSIT5 = diffrax_ode.solver(method="Tsit5")
EVERY = pytest.mark.parametrize("solver", [*HOST, TSIT5], ids=lambda solver: solver.name)
ON_HOST = pytest.mark.parametrize("solver", HOST, ids=lambda solver: solver.name)
LOOSE = Request(rtol=1e-6)


def set_to(**values):
    def tamper(result):
        for name, value in values.items():
            setattr(result, name, value(result))

    return tamper


LIES = {
    "not finite": set_to(y=lambda r: np.full_like(r.y, np.nan)),
    "time goes back": set_to(t=lambda r: -1.0),
    "past the end": set_to(t=lambda r: 2.0),
    "off the circle": set_to(y=lambda r: 1.2 * r.y),
    "too short": set_to(y=lambda r: r.y[:-1]),
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


def test_rows_that_are_missing_are_unreliable(monkeypatch):
    real = type(ida.solver()).drive

    def short(self, run):
        real(self, run)
        run._asked.drop_last()

    monkeypatch.setattr(type(ida.solver()), "drive", short)
    solution = hb.solve(problem(), ida.solver(), rtol=1e-6, t_eval=[0.0, 0.5, 1.0])
    assert solution.status is Status.unreliable
    assert solution.message.startswith("end: success was reported, but the last time is 0.5")


def test_a_library_that_raises_costs_its_own_solve_only(monkeypatch):
    class Broken:
        def __init__(self, *_, **__):
            raise RuntimeError("made")

    monkeypatch.setattr(ida, "IDA", Broken)
    solution = ida.solver().solve(problem(), LOOSE)
    assert solution.status is Status.unreliable
    assert "RuntimeError" in solution.message


def raising_at(call, raised, calls):
    def force(t, q, v):
        calls.append(t)
        if len(calls) == call:
            raise raised
        return np.zeros(2)

    return numpy_ring(force=force)


def test_a_library_that_swallows_an_exception_and_tries_again_does_not_hide_it(monkeypatch):
    raised, calls, steps = ArithmeticError("made"), [], []

    class Swallower(lying(ida.IDA, lambda result: None)):
        def step(self, *arguments, **options):
            steps.append(len(calls))
            for _ in range(3):
                try:
                    self.last = super().step(*arguments, **options)
                    return self.last
                except ArithmeticError:
                    self.last.t += 1e-4
            return self.last

    monkeypatch.setattr(ida, "IDA", Swallower)
    with pytest.raises(ArithmeticError) as caught:
        ida.solver().solve(raising_at(50, raised, calls), LOOSE)
    assert caught.value is raised
    assert len(calls) == 50, "a function was called again after it raised"
    assert steps[-1] < 50, "the library was stepped again"


def test_a_library_that_wraps_an_exception_does_not_hide_it(monkeypatch):
    raised, calls = ArithmeticError("made"), []

    class Wrapper(lying(ida.IDA, lambda result: None)):
        def step(self, *arguments, **options):
            try:
                return super().step(*arguments, **options)
            except ArithmeticError as error:
                raise RuntimeError("the residual function failed") from error

    monkeypatch.setattr(ida, "IDA", Wrapper)
    with pytest.raises(ArithmeticError) as caught:
        ida.solver().solve(raising_at(50, raised, calls), LOOSE)
    assert caught.value is raised


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
