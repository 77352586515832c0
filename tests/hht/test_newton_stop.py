"""Under error control force rows stop where the error allows, (H35); matrices are kept while it contracts."""

import numpy as np
import pytest

import hhtbench as hb
from solvers.hht import HHT
from solvers.hht.run import functions
from solvers.hht.step.newton import NewtonOptions
from solvers.hht.step.stopping import corrected, enough, is_roundoff
from solvers.kernel import memory as mem
from solvers.kernel.linear.matrix import renew
from tests.hht.scenes import Q0, V0, Pendulum, forget_engines

LIBRARY = ("andrews", "arevalo_circle", "jay_negrut_test1", "knife_edge", "simple_pendulum", "stiff_spring_pendulum")


def solve(name, **request):
    return hb.solve(hb.load_problem(name), "hht", **request)


def prescribed_steps(name):
    problem = hb.load_problem(name)
    return HHT(problem.system, alpha=0.0).solve(problem.t_span, problem.q0, problem.v0, steps=2000)


def evaluations(solution):
    return solution.counters.residual_evaluations / solution.counters.steps_accepted


@pytest.mark.parametrize("name", LIBRARY)
def test_a_controlled_step_takes_at_most_three_evaluations(name):
    assert evaluations(solve(name, rtol=1e-3)) < 3.0


def test_force_rows_stop_early_under_error_control_and_go_to_roundoff_in_prescribed_steps(monkeypatch):
    controlled, prescribed = solve("simple_pendulum", rtol=1e-3), prescribed_steps("simple_pendulum")
    monkeypatch.setattr(functions, "NewtonOptions", lambda **given: NewtonOptions(**given, remaining=0.0))
    forget_engines(monkeypatch)
    roundoff = solve("simple_pendulum", rtol=1e-3)
    assert evaluations(controlled) < min(2.2, 0.7 * evaluations(roundoff))  # two are the least: guess and correction
    assert controlled.counters.steps_accepted == pytest.approx(roundoff.counters.steps_accepted, rel=0.02)
    assert np.array_equal(prescribed_steps("simple_pendulum").q, prescribed.q)


@pytest.mark.parametrize(("name", "rtol"), [("planar_chain", 1e-2), ("bricard", 1e-3)])
def test_large_steps_of_closed_and_long_chains_are_hardly_ever_begun_again(name, rtol):
    """(H46): with the last lam0 for the next one 21 of 122 steps were, and 130 of 186."""
    counters = solve(name, rtol=rtol).counters
    assert counters.steps_rejected_newton <= 0.05 * counters.steps_accepted


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_iterations_of_large_systems_end_at_the_roundoff_that_is_measured(engine):
    """Links of 1/200 m in places of 1 m: without a look at roundoff 46 iterations and 18 matrices are made."""
    chain = hb.load_problem("planar_chain(n_links=200)")
    counters = HHT(chain.system, rho_inf=0.9, engine=engine).solve((0.0, 1e-3), chain.q0, chain.v0, steps=10).counters
    assert counters.jacobian_evaluations <= 12
    assert counters.newton_iterations <= 28


def test_sizes_and_roundoff_of_a_far_iterate_do_not_end_the_iteration_with_the_next_matrix():
    """With them a governor's step at rtol 0.1 ended at 3e-10 m/s in its velocity rows."""
    solver = HHT(Pendulum(), engine="python")
    solver.init_step(0.0, Q0, V0, step=0.01)
    solver.step()
    z, counts = solver._engine.loops.z, np.zeros(len(mem.COUNTS), dtype=int)
    sizes, tolerance = mem.view(z, mem.RECIPROCAL).copy(), enough(z)
    mem.view(z, mem.X)[:] = 1e9
    corrected(z, 0, mem.C_RESIDUAL, False, counts)
    assert not is_roundoff(z, 0, counts)
    mem.view(z, mem.NOISE)[:] = 1.0
    renew(z, 0, 0.01, counts)
    assert enough(z) == tolerance
    assert np.array_equal(mem.view(z, mem.RECIPROCAL), sizes)


MATRIX = 3.0  # residual evaluations that a matrix of the pendulum costs at least, measured


def with_steps(problem, steps):
    return HHT(problem.system, alpha=-0.05).solve(problem.t_span, problem.q0, problem.v0, steps=steps)


def test_the_pendulum_factorises_less_than_once_in_ten_steps_with_unchanged_errors_and_less_work(monkeypatch):
    """h = 1e-3, against a new matrix for every step and for every iteration but the second."""
    problem = hb.load_problem("jay_negrut_pendulum")
    steps = 4000
    kept = with_steps(problem, steps)
    monkeypatch.setattr(functions, "NewtonOptions", lambda: NewtonOptions(other_step=-1.0, refresh_rate=0.0))
    forget_engines(monkeypatch)
    fresh = with_steps(problem, steps)
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
