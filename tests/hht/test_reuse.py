"""Jacobians and factorisations are kept over steps while Newton's iteration contracts."""

from dataclasses import replace

import numpy as np
import pytest
from solvers.hht.newton import Iteration

import hhtbench as hb
from solvers.hht import HHT, engine

MATRIX = 3.0  # residual evaluations that a matrix of the pendulum costs at least, measured


def solve(problem, steps):
    return HHT(problem.system, alpha=-0.05, engine="host").solve(problem.t_span, problem.q0, problem.v0, steps=steps)


def with_new_matrices(*arguments, **options):
    """Newton's iteration with a new matrix for every step and for every iteration but the second."""
    iteration = Iteration(*arguments, **options)
    always = replace(iteration.options, other_step=-1.0, refresh_rate=0.0)
    object.__setattr__(iteration, "options", always)
    return iteration


def test_the_pendulum_factorises_less_than_once_in_ten_steps_with_unchanged_errors_and_less_work(monkeypatch):
    """h = 1e-3, against a new matrix in every step."""
    problem = hb.load_problem("jay_negrut_pendulum")
    steps = 4000
    kept = solve(problem, steps)
    with monkeypatch.context() as patch:
        patch.setattr(engine, "Iteration", with_new_matrices)
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
