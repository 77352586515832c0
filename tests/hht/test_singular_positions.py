"""Positions where the constraints lose rank: the right branch, or a status; never silence (row P7)."""

import jax
import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

import hhtbench as hb
from hhtbench.conformance.scenes import circles as scenes
from hhtbench.solution.result import Status
from solvers._start import Failure
from solvers.hht.run.stepper import Accepted, Stepper
from tests.performance import singular
from tests.sample import slow


@pytest.mark.parametrize("steps", [50, 333, 1000])
def test_prescribed_steps_through_a_dead_point_keep_the_branch_or_tell(steps):
    """What cannot be right must not be called success: the energy tells a wrong branch taken with a jump of v."""
    problem = hb.load_problem("four_bars(t_end=1.0)")
    solution = hb.load_solver("hht").solve(problem, hb.Request(steps=steps))
    if solution.status is not Status.success:
        assert solution.status in (Status.newton_failed, Status.singular_iteration_matrix)
        return
    exact = np.array([problem.exact(float(t)).q for t in solution.t])
    assert np.abs(solution.q - exact).max() < 12 * steps**-2.0, "measured 9 h^2; the other branch is 1 m away"


def on_crossing_curves(angle, bent, push):
    """A point on y = bent sin 3x, which y = bent sin 3x + angle x crosses at x = 0, pushed along x."""

    def off(q):
        return q[1] - bent * np.sin(3.0 * q[0])

    def rows(t, q):
        both, slope = off(q), -3.0 * bent * np.cos(3.0 * q[0])
        return np.array([[slope * (2.0 * both - angle * q[0]) - angle * both, 2.0 * both - angle * q[0]]])

    return hb.NumpySystem(
        force=lambda t, q, v: np.array([push, 0.0]),
        constraint=lambda t, q: np.array([off(q) * (off(q) - angle * q[0])]),
        constraint_jacobian=rows,
    )


BARS = hb.load_problem("four_bars(n_windows=3, t_end=1.0)")
FLAT = brentq(lambda t: BARS.exact(t).q[2], 0.6, 0.8)  # [s]: the first position with horizontal bars


def stop_runs(monkeypatch, edge):
    """Make every run fail at ``edge`` [s], as if Newton's iteration failed from there on."""
    advance = Stepper._advance

    def until_there(self, state, watch, stop, rows, horizon):
        if state.t == edge:
            return Accepted(state, watch, ended=Failure(Status.newton_failed, "no step goes on"))
        return advance(self, state, watch, edge if state.t < edge else stop, rows, horizon)

    monkeypatch.setattr(Stepper, "_advance", until_there)


@pytest.fixture
def failing(monkeypatch):
    """Runs of BARS fail just before their bars are horizontal."""
    stop_runs(monkeypatch, FLAT - 1e-4)


@pytest.mark.parametrize(
    ("alpha", "tolerance"),
    [(0.0, 1e-3), (-0.3, 1e-5), *(slow(*x) for x in ((0.0, 1e-5), (0.0, 1e-7), (-0.3, 1e-3), (-0.3, 1e-7)))],
)
def test_a_run_that_fails_beside_a_singular_position_goes_on_across_it(failing, alpha, tolerance):
    solution = hb.HHT(BARS.system, alpha=alpha).solve((0.0, 1.0), BARS.q0, BARS.v0, rtol=tolerance)
    assert singular.kind_of(BARS, solution) == "across", solution.message
    assert solution.t.size == solution.counters.steps_accepted + 1
    assert np.all(np.diff(solution.t) > 0.0)
    every = slice(None, None, max(1, solution.t.size // 50))
    errors = [np.abs(q - BARS.exact(float(t)).q).max() for t, q in zip(solution.t[every], solution.q[every], strict=True)]
    assert max(errors) < 20.0 * tolerance
    assert np.abs(jax.vmap(BARS.system.constraint, (None, 0))(0.0, solution.q)).max() < 1e-11


def test_what_cannot_be_stepped_over_is_told_with_the_rank_and_the_rows(failing):
    hht = hb.HHT(BARS.system, events=[hb.Event(lambda t, q, v: t - 2.0)])
    watched = hht.solve((0.0, 1.0), BARS.q0, BARS.v0, rtol=1e-5)
    by_hand = hb.HHT(BARS.system)
    by_hand.init_step(0.0, BARS.q0, BARS.v0, rtol=1e-5)
    stepped = by_hand.step(1.0, "normal", tstop=1.0)
    short = hb.HHT(BARS.system).solve((0.0, FLAT + 1e-7), BARS.q0, BARS.v0, rtol=1e-5)
    for status, message in ((watched.status, watched.message), (stepped, by_hand.message), (short.status, short.message)):
        assert status is Status.singular_iteration_matrix
        assert f"lose rank at t = {FLAT:.5f}"[:-1] in message
        assert "rank 17 of 20 rows" in message
    assert "events" in watched.message
    assert "one by one" in by_hand.message
    assert "just beyond" in short.message


def test_curves_that_meet_at_a_small_angle_are_not_told_apart_by_coarse_steps(monkeypatch):
    length, _ = quad(lambda x: np.hypot(1.0, 3.0 * np.cos(3.0 * x)), -1.0, 0.0)
    stop_runs(monkeypatch, length / 2.0 - 3e-3)
    system, along = on_crossing_curves(angle=0.1, bent=1.0, push=0.0), np.array([1.0, 3.0 * np.cos(3.0)])
    start = np.array([-1.0, -np.sin(3.0)]), 2.0 * along / np.linalg.norm(along)
    solution = hb.HHT(system).solve((0.0, 1.4), *start, rtol=1e-2, atol=1e-2)
    assert solution.status is Status.singular_iteration_matrix
    assert "rank 0 of 1 rows" in solution.message
    assert "nearly the same direction" in solution.message
    finer = hb.HHT(system).solve((0.0, 1.4), *start, rtol=1e-4, atol=1e-4)
    assert finer.status is Status.success, finer.message
    np.testing.assert_allclose(finer.q[-1, 1], np.sin(3.0 * finer.q[-1, 0]), atol=1e-12)  # on the curve where it began


def test_a_motion_that_comes_to_rest_where_curves_meet_is_not_led_across(monkeypatch):
    """x = -(1 - t)^2: nothing says on which of the two lines it goes back."""
    stop_runs(monkeypatch, 0.99)
    system = on_crossing_curves(angle=1.0, bent=0.0, push=-2.0)
    solution = hb.HHT(system).solve((0.0, 1.5), [-1.0, 0.0], [2.0, 0.0], rtol=1e-5, atol=1e-5)
    assert solution.status is Status.singular_iteration_matrix
    assert "comes to rest" in solution.message


def test_a_failure_far_from_any_singular_position_keeps_its_own_cause(monkeypatch):
    """The bars are horizontal in 0.05 s, a fifth of the motion's own time: a thousandth would be near."""
    stop_runs(monkeypatch, FLAT - 0.05)
    solution = hb.HHT(BARS.system).solve((0.0, 1.0), BARS.q0, BARS.v0, rtol=1e-5)
    assert (solution.status, solution.message) == (Status.newton_failed, "no step goes on")


def test_from_other_phases_every_run_keeps_the_branch_or_names_the_lost_rank():
    """A small part of ``python -m tests.performance.singular``."""
    kinds = singular.counted(1, 4, -0.05) + singular.counted(5, 2, 0.0, (1e-3, 1e-5, 1e-6))
    assert singular.passed(kinds), kinds
    assert kinds["right"] + kinds["across"] == kinds.total(), kinds


def test_a_crossing_counts_as_a_step_and_there_are_not_crossings_without_end(failing):
    few = hb.HHT(BARS.system).solve((0.0, 1.0), BARS.q0, BARS.v0, rtol=1e-3)
    assert singular.kind_of(BARS, few) == "across"
    taken = few.counters.steps_accepted + int(few.message.split("the last ")[1].split(".")[0]) - 1
    enough, less = (
        hb.HHT(BARS.system).solve((0.0, 1.0), BARS.q0, BARS.v0, rtol=1e-3, max_num_steps=taken + more) for more in (1, 0)
    )
    assert enough.success
    assert less.status is Status.max_steps


def test_a_failure_of_constraints_that_always_lean_keeps_its_own_cause(monkeypatch):
    """Their least singular value is 7e-6 all along: nothing is lost there."""
    problem = scenes.leaning([[1.0, 0.0], [1.0, 1e-5]], 2.0)
    stop_runs(monkeypatch, 1.0)
    solution = hb.HHT(problem.system).solve((0.0, 2.0), problem.q0, problem.v0, rtol=1e-3)
    assert (solution.status, solution.message) == (Status.newton_failed, "no step goes on")
