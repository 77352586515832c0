"""Every solver and form on every kind of constraint against closed solutions; what a form cannot do is declined."""

from dataclasses import replace

import numpy as np
import pytest

from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.request import Request
from hhtbench.solution.result import Status
from solvers import cvode, diffrax_ode, ida
from tests.adapters.scenes import EVERY, HOST, KINDS, ON_HOST, RING, errors, problem

ROWS = np.linspace(0.0, 1.0, 7)
COMPILED = {  # diffrax compiles for seconds; the claims of tests/conformance hold Tsit5 to the other kinds
    "position": "Kvaerno5",
    "variable mass": "Dopri8",
    "nonlinear reaction": "Tsit5",
}
CASES = [(kind, solver) for kind in KINDS for solver in HOST]
CASES += [(kind, diffrax_ode.solver(method=method)) for kind, method in COMPILED.items()]


def eliminates(solver):
    return solver.form == "ode"


@pytest.mark.parametrize(("kind", "solver"), CASES, ids=[f"{kind}-{solver.name}" for kind, solver in CASES])
def test_motion_and_multipliers_are_those_of_the_closed_solution(kind, solver):
    scene = problem(kind)
    asked = Request(rtol=1e-8, t_eval=ROWS)
    reason = solver.accepts(scene, asked)
    if kind == "nonlinear reaction" and eliminates(solver):
        assert "nonlinear" in reason
        return
    if kind == "unconstrained" and solver.form not in ("ode", "index1", "ggl"):
        assert "the system has none" in reason
        return
    assert reason is None
    solution = solver.solve(scene, asked)
    assert solution.status is Status.success, solution.message
    np.testing.assert_array_equal(solution.t, ROWS)
    assert max(errors(solution, scene.exact)) < 5e-6  # of motions of size one at rtol 1e-8


@pytest.mark.parametrize("kind", ["position", "rheonomic", "variable mass", "mixed"])
def test_ida_solves_index_three_at_loose_tolerances(kind):
    """The velocities stay in its error test, which index 3 passes at loose tolerances only."""
    scene = problem(kind)
    solution = ida.solver(form="index3").solve(scene, Request(rtol=1e-3, t_eval=ROWS))
    assert solution.success
    assert errors(solution, scene.exact)[0] < 0.05
    assert "index is 2" in ida.solver(form="index3").accepts(problem("velocity"), Request(rtol=1e-3))


def lam_of(motion):
    return np.concatenate([motion.lam, motion.mu])


@pytest.mark.parametrize("kind", ["position", "mixed", "velocity"])
@ON_HOST
def test_the_multipliers_that_a_form_holds_are_told_beside_the_recovered_ones(kind, solver):
    """At rows inside steps too; less accurate than those that follow from q and v, and no copy of them."""
    scene = problem(kind)
    solution = solver.solve(scene, Request(rtol=1e-8, t_eval=ROWS))
    if eliminates(solver):
        assert solution.carried is None
        return
    own = np.concatenate([solution.carried["lam"], solution.carried["mu"]], axis=1)
    true = np.array([lam_of(scene.exact(t)) for t in ROWS])
    assert np.abs(own - true).max() < 1e-2
    assert np.abs(own - np.concatenate([solution.lam, solution.mu], axis=1)).max() > 1e-12
    steps = solver.solve(scene, Request(rtol=1e-8))
    assert steps.carried["lam"].shape == steps.lam.shape


@EVERY
def test_an_interval_of_no_length_gives_its_one_row(solver):
    solution = solver.solve(problem(t_span=(0.5, 0.5)), Request(rtol=1e-6))
    assert solution.status is Status.success
    assert solution.t.tolist() == [0.5]
    assert solution.lam.shape == (1, 1)


@pytest.mark.parametrize("form", ["ggl", "index1", "index2"])
def test_multipliers_do_not_steer_the_steps(form):
    """A unit of force 1e6 times smaller makes lam 1e6 times larger; in the error test that would change every step."""

    def run(size):
        system = NumpySystem(**RING, reaction=lambda t, q, lam: -q * lam[0] / size)
        return ida.solver(form=form).solve(
            replace(problem(system=system), lam_guess=None), Request(rtol=1e-6, max_seconds=20.0)
        )

    first, second = run(1.0), run(1e6)
    assert first.counters.steps_accepted == pytest.approx(second.counters.steps_accepted, rel=0.02)
    np.testing.assert_allclose(1e6 * first.lam[-1], second.lam[-1], rtol=1e-6)


def test_absolute_tolerances_default_to_the_scales_of_the_problem():
    solver = cvode.solver()
    scaled = solver.solve(problem(scales=Scales(q=2.0, v=3.0)), Request(rtol=1e-6))
    vector = solver.solve(problem(), Request(rtol=1e-6, atol=np.array([2e-6, 2e-6, 3e-6, 3e-6])))
    number = solver.solve(problem(), Request(rtol=1e-6, atol=1e-10))
    each = solver.solve(problem(), Request(rtol=1e-6, atol=np.array([1e-10, 1e-10])))
    np.testing.assert_array_equal(scaled.t, vector.t)
    np.testing.assert_array_equal(number.t, each.t)
    assert number.t.size > scaled.t.size
