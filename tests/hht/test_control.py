"""Error control: what is asked for comes, and steps obey their bounds."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hhtbench as hb
from solvers.hht import HHT
from solvers.hht.control.controller import ControlOptions
from solvers.hht.control.tolerances import make_tolerances
from solvers.hht.equations.formulas import growth
from tests.hht.scenes import JAX_PENDULUM, Q0, V0, pendulum_at
from tests.sample import slow

# --- what is asked for comes


def local_solution(problem, state, t1, other):
    """[q, v] (2n,) at ``t1`` of the exact motion through ``state``, by another method of order eight or more."""
    own = replace(problem, t_span=(state.t, t1), q0=state.q, v0=state.v, exact=None, reference=None)
    solution = hb.solve(own, other, rtol=1e-13, atol=1e-15, t_eval=np.array([t1]))
    assert solution.success, solution.message
    return np.concatenate([solution.q[-1], solution.v[-1]])


@pytest.mark.parametrize(
    ("spec", "other"),
    [
        ("jay_negrut_pendulum", "projected(method=DOP853)"),
        ("knife_edge", "projected(method=DOP853)"),
        ("rolling_disk3d_steady", "projected(method=DOP853)"),
        ("andrews", "projected(method=DOP853)"),
        slow("flyball_governor", "projected(method=DOP853)"),
        ("jay_negrut_test1", "collocation"),  # its reaction is nonlinear in the multipliers
    ],
)
@pytest.mark.parametrize("method", [{"alpha": -0.05}, {"alpha": -0.3, "reaction": "midpoint"}], ids=str)
def test_the_estimate_is_the_local_error(spec, other, method):
    """Position, velocity-level and mixed constraints; every third of sixteen steps, in the norm of the error test."""
    problem, rtol, ratios = hb.load_problem(spec), 1e-5, []
    hht = HHT(problem.system, **method)
    guesses = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
    hht.init_step(problem.t_span[0], problem.q0, problem.v0, rtol=rtol, **guesses)
    tolerances = make_tolerances(rtol, None, hht.state, hht.state.f)
    for index in range(16):
        before = hht.state
        assert hht.step() is hb.Status.success
        if index % 3 == 2:
            true = np.concatenate([hht.state.q, hht.state.v]) - local_solution(problem, before, hht.state.t, other)
            ratios.append(hht.state.memory.error / tolerances.size(before, hht.state, true))
    assert 0.9 <= np.median(ratios) <= 1.1
    assert all(0.7 <= ratio <= 1.4 for ratio in ratios)


def test_tolerances_per_component_tighten_what_they_name():
    """The speed is asked for a thousand times tighter than the place."""
    loose = HHT(JAX_PENDULUM).solve((0.0, 1.0), Q0, V0, rtol=0.0, atol=1e-3)
    tight = HHT(JAX_PENDULUM).solve((0.0, 1.0), Q0, V0, rtol=0.0, atol=[1e-3, 1e-3, 1e-6, 1e-6])
    relative = HHT(JAX_PENDULUM).solve((0.0, 1.0), Q0, V0, rtol=[1e-3, 1e-3, 1e-6, 1e-6], atol=0.0)
    assert tight.counters.steps_accepted > 5 * loose.counters.steps_accepted
    assert relative.counters.steps_accepted > 5 * loose.counters.steps_accepted
    assert np.abs(tight.v[-1] - pendulum_at(1.0)[1]).max() < 2e-5


@pytest.mark.parametrize(
    ("rtol", "alpha", "stiffness", "steps", "error"),
    [(1e-3, alpha, stiffness, 300, 5e-3) for alpha in (-0.05, -0.3) for stiffness in ("1e6", "1e10", "1e12")]
    + [(3e-3, -0.1, stiffness, 100, 9e-3) for stiffness in ("1e8", "1e10", "1e12")],
)
def test_stiff_springs_are_passed_over_at_the_accuracy_asked_for(rtol, alpha, stiffness, steps, error):
    """Only the filter of (H25) makes this finish: the reference is the rigid rod, 1/k away.

    That a spring which has turned is not left unbalanced shows in the imbalance alone: increments by a matrix of its old
    direction are small there.
    """
    rigid = hb.load_problem("stiff_spring_pendulum(stiffness=inf)").reference
    problem = hb.load_problem(f"stiff_spring_pendulum(stiffness={stiffness})")
    solution = hb.load_solver(f"hht(alpha={alpha})").solve(problem, hb.Request(rtol=rtol, t_eval=rigid["t"]))
    assert solution.success
    assert solution.counters.steps_accepted < steps
    assert np.abs(solution.q - rigid["q"]).max() / np.max(problem.scales.q) < error


# --- the length of steps


@given(
    errors=st.lists(st.floats(0, 1), min_size=1, max_size=60),
    rejected=st.lists(st.booleans(), min_size=60, max_size=60),
)
@settings(max_examples=300, deadline=None)
def test_the_controller_never_grows_by_more_than_a_half(errors, rejected):
    """Row M10, whatever errors come."""
    options, last = ControlOptions(), -1.0
    for error, again in zip(errors, rejected, strict=False):
        factor = growth(options, error, last, again)
        assert options.shrink <= factor <= 1.5
        assert factor <= 1.0 or not again
        last = error


def test_bounds_of_the_step_are_kept():
    free = HHT(JAX_PENDULUM).solve((0.0, 1.0), Q0, V0, rtol=1e-3)
    short = HHT(JAX_PENDULUM, max_step=0.004, first_step=0.001).solve((0.0, 1.0), Q0, V0, rtol=1e-3)
    long = HHT(JAX_PENDULUM, min_step=0.02).solve((0.0, 1.0), Q0, V0, rtol=1e-2)
    assert np.abs(short.steps_data.h).max() <= 0.004 < free.steps_data.h.max()
    assert short.steps_data.h[0] == 0.001
    assert long.success
    assert long.steps_data.h[:-1].min() >= 0.02
    assert free.t[-1] == short.t[-1] == 1.0
