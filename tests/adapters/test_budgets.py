"""``max_seconds`` holds for all of a solve: tracing, compiling, steps, output rows and their multipliers."""

import re
import time

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.errors import BudgetSpent
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.counting import Clock, Work, preparing, timed
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers.hht.run import history

SOLVERS = ["hht", "hht(engine=python)", "ida", "cvode", "scipy(method=Radau)", "diffrax", "projected", "collocation"]


TRACED = []


class SlowToTrace(hb.System):
    """A pendulum whose force takes its time whenever Python runs it."""

    mark: float = 0.0

    def force(self, t, q, v):
        TRACED.append(t)
        time.sleep(0.4)
        return jnp.stack([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1) / 2])


@pytest.mark.parametrize("solver", SOLVERS)
def test_the_budget_is_looked_at_between_traces_and_the_status_says_where_the_time_went(solver):
    """One trace more than fits into the budget may be begun."""
    system = SlowToTrace(mark=float(SOLVERS.index(solver)))
    problem = hb.Problem(name="slow", system=system, t_span=(0, 1), q0=[1, 0], v0=[0, 0])
    TRACED.clear()
    loaded = hb.load_solver(solver)
    solution = hb.solve(problem, loaded, rtol=1e-3, max_seconds=0.3)
    assert solution.status is Status.deadline
    assert solution.t.size <= 1
    told = re.search(r"\(([\d.]+) s for preparations in all: imports, traces, compilations\)", solution.message)
    assert told, solution.message
    assert float(told[1]) > 0.3
    assert len(TRACED) <= 2, "one, or a function that traces it twice"


def slow_pendulum(seconds):
    def force(t, q, v):
        time.sleep(seconds)
        return np.array([0.0, -9.81])

    return NumpySystem(
        force=force,
        constraint=lambda t, q: np.array([(q @ q - 1) / 2]),
        constraint_jacobian=lambda t, q: q[None, :],
        constraint_acceleration=lambda t, q, v: np.array([v @ v]),
        force_jacobians=lambda t, q, v: (None, None),
    )


@pytest.mark.parametrize("solver", ["hht", "ida", "scipy(method=BDF)"])
def test_multipliers_of_many_rows_do_not_overrun_the_budget(solver):
    """The steps take a tenth of a second or two; multipliers at 5,000 rows would take more than ten."""
    problem = hb.Problem(name="slow", system=slow_pendulum(0.002), t_span=(0, 0.2), q0=[1, 0], v0=[0, 0])
    hb.load_solver(solver).warm_up(problem, Request(rtol=1e-2, atol=1e-2))
    solution = hb.solve(problem, solver, rtol=1e-2, atol=1e-2, t_eval=np.linspace(0, 0.2, 5000), max_seconds=1.0)
    assert solution.status is Status.deadline
    assert solution.t[-1] == 0.2, "no row is lost"
    assert np.isfinite(solution.q).all()
    recovered = int(re.search(r"ended when (\d+) of 5000 rows had their multipliers", solution.message)[1])
    assert recovered < 1.2 * 1.0 / 0.002
    np.testing.assert_allclose(solution.lam[:recovered, 0], 3 * 9.81 * solution.q[:recovered, 1], atol=2.0)


@pytest.mark.parametrize("solver", SOLVERS)
def test_a_budget_that_is_over_at_once_ends_in_a_status(solver):
    solution = hb.solve("simple_pendulum", solver, rtol=1e-5, max_seconds=1e-9)
    assert solution.status is Status.deadline
    assert solution.t.size <= 1, "the start is there where the problem was prepared before"


@pytest.mark.parametrize("solver", ["hht", "ida", "scipy(method=Radau)", "collocation"])
def test_a_slow_function_of_a_numpy_system_that_declares_no_derivatives_is_stopped(solver):
    """Differences of its constraint alone, for ten coordinates, are some hundred calls before the first step."""
    calls = []

    def constraint(t, q):
        calls.append(t)
        time.sleep(0.005)
        return np.array([(q @ q - 1) / 2])

    system = NumpySystem(force=lambda t, q, v: -0.1 * q, constraint=constraint)
    q0 = np.eye(10)[0]
    problem = hb.Problem(name="slow", system=system, t_span=(0, 100), q0=q0, v0=np.zeros(10))
    solution = hb.solve(problem, solver, rtol=1e-6, max_seconds=0.3)
    assert solution.status is Status.deadline
    assert len(calls) < (1.2 * 0.3 + 0.2) / 0.005


def test_rows_that_find_no_time_are_left_out_and_said(monkeypatch):
    """A hundred blocks of rows that would take three seconds."""

    def slow(structure):
        layout = history.RowLayout(structure)
        interpolate = layout.interpolate
        layout.interpolate = lambda *arguments: time.sleep(0.03) or interpolate(*arguments)
        return layout

    monkeypatch.setattr(history, "BLOCK", 10)
    monkeypatch.setattr(history, "row_layout", slow)
    free = hb.Problem(name="free", system=NumpySystem(force=lambda t, q, v: -q), t_span=(0, 1), q0=[1.0], v0=[0.0])
    solution = hb.solve(free, "hht", steps=10, t_eval=np.linspace(0, 1, 1000), max_seconds=1.0)
    assert solution.status is Status.deadline
    kept = int(re.search(r"ended when (\d+) of 1000 rows were interpolated", solution.message)[1])
    assert 0 < kept == solution.t.size == len(solution.q) <= 10 * 1.2 / 0.03
    np.testing.assert_allclose(solution.q[:, 0], np.cos(solution.t), atol=1e-2)


def test_what_a_budget_was_spent_on_is_told():
    with (
        timed(0.05) as clock,
        pytest.raises(BudgetSpent, match=r"while tracing f, 0.06[0-9]* s that .* \(0.06[0-9]* s for preparations"),
    ):
        with preparing("tracing f"):
            time.sleep(0.06)
        with preparing("tracing g"):
            raise AssertionError("it was begun")
    assert clock.prepared.keys() == {"tracing f"}
    Work(clock=Clock()).check_time()  # without a limit it never ends


def test_a_solve_inside_a_callback_has_a_budget_of_its_own():
    inner = []

    def force(t, q, v):
        if not inner:
            free = NumpySystem(force=lambda t, q, v: -q)
            problem = hb.Problem(name="inner", system=free, t_span=(0, 1), q0=[1.0], v0=[0.0])
            inner.append(hb.solve(problem, "hht", step=0.1, max_seconds=60.0))
        return -q

    outer = hb.Problem(name="outer", system=NumpySystem(force=force), t_span=(0, 1e9), q0=[1.0], v0=[0.0])
    assert hb.solve(outer, "hht", step=0.1, max_seconds=0.3).status is Status.deadline
    assert inner[0].status is Status.success
