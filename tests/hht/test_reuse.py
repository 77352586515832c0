"""Jacobians and factorisations are kept over steps while Newton's iteration contracts."""

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.lowering.caching import Cache
from solvers.hht import HHT
from solvers.hht.run import functions, idle
from solvers.hht.step.newton import NewtonOptions

MATRIX = 3.0  # residual evaluations that a matrix of the pendulum costs at least, measured


def solve(problem, steps):
    return HHT(problem.system, alpha=-0.05).solve(problem.t_span, problem.q0, problem.v0, steps=steps)


def test_the_pendulum_factorises_less_than_once_in_ten_steps_with_unchanged_errors_and_less_work(monkeypatch):
    """h = 1e-3, against a new matrix for every step and for every iteration but the second."""
    problem = hb.load_problem("jay_negrut_pendulum")
    steps = 4000
    kept = solve(problem, steps)
    monkeypatch.setattr(functions, "NewtonOptions", lambda: NewtonOptions(other_step=-1.0, refresh_rate=0.0))
    monkeypatch.setattr(functions, "_known", Cache(16))
    monkeypatch.setattr(idle, "_idle", [])
    fresh = solve(problem, steps)
    assert fresh.counters.factorisations >= steps
    assert kept.counters.factorisations < steps / 10
    exact = problem.exact(4.0)
    errors = [max(np.abs(s.q[-1] - exact.q).max(), np.abs(s.v[-1] - exact.v).max()) for s in (kept, fresh)]
    assert errors[0] == pytest.approx(errors[1], rel=1e-6)
    work = [s.counters.residual_evaluations + MATRIX * s.counters.factorisations for s in (kept, fresh)]
    assert work[0] < work[1]


def test_linear_constant_systems_are_factorised_once():
    problem = hb.load_problem("oscillator_chain")
    solution = HHT(problem.system).solve((0.0, 0.1), problem.q0, problem.v0, steps=100)
    assert solution.counters.factorisations == 1
    assert solution.counters.jacobian_evaluations == 1
