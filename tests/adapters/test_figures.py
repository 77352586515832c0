"""The figures that issue 3 sets, and every solver and form against every other on the registered problems."""

import importlib

import numpy as np
import pytest

from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.request import Request
from solvers import diffrax_ode, ida, scipy_ivp
from tests.adapters.scenes import ALL, HOST

PROBLEMS = (
    "jay_negrut_test1",
    "jay_negrut_pendulum",
    "andrews",
    "knife_edge",
    "rolling_disk3d_steady",
    "oscillator_chain",
)
TIGHT = 1e-9
WORST = 5e-5  # of the problem's scales at rtol 1e-9: Andrews and the disk multiply errors by 1e4 and more


def registered(name):
    return importlib.import_module(f"problems.{name}").problem()


@pytest.fixture(scope="module")
def andrews():
    return registered("andrews")


def end_errors(scene, solution):
    """Scaled errors of q and v at the end."""
    if scene.exact is not None:
        at = scene.exact(solution.t[-1])
        q, v = at.q, at.v
    else:
        row = list(scene.reference["t"]).index(solution.t[-1])
        q, v = scene.reference["q"][row], scene.reference["v"][row]
    pairs = ((solution.q[-1], q, scene.scales.q), (solution.v[-1], v, scene.scales.v))
    return tuple(float(np.max(np.abs(found - wanted) / scale)) for found, wanted, scale in pairs)


@pytest.mark.parametrize("name", PROBLEMS)
def test_every_form_and_solver_agrees_with_the_solution_within_its_error(name):
    scene = registered(name)
    solved = set()
    for solver in [*HOST, *((diffrax_ode.solver(method="Tsit5"),) if name == "andrews" else ())]:
        asked = Request(rtol=TIGHT, t_eval=[scene.t_span[1]], max_seconds=60.0)
        if solver.accepts(scene, asked) is None:
            solution = solver.solve(scene, asked)
            assert solution.success, f"{solver.name}: {solution.message}"
            assert max(end_errors(scene, solution)) < WORST, solver.name
            solved.add(solver.form)
    assert len(solved) >= 2


@pytest.mark.parametrize(
    "solver",
    [scipy_ivp.solver(method="Radau"), scipy_ivp.solver(method="DOP853"), next(s for s in ALL if "adams" in s.name)],
    ids=lambda solver: solver.name,
)
def test_three_reference_solvers_reach_andrews_reference_within_1e_8(andrews, solver):
    rtol = 1e-13 if "adams" in solver.name else 1e-10
    solution = solver.solve(andrews, Request(rtol=rtol, t_eval=[0.03]))
    assert solution.success
    assert max(end_errors(andrews, solution)) < 1e-8


def test_ida_holds_andrews_loops_over_all_its_internal_steps(andrews):
    """At the end alone |g| is 1e-16 and flatters it.  The residual evaluations are those of the integration."""
    solver = ida.solver(form="ggl")
    steps = solver.solve(andrews, Request(rtol=1e-6))
    end = solver.solve(andrews, Request(rtol=1e-6, t_eval=[0.03]))
    np.testing.assert_array_equal(steps.q[-1], end.q[-1])  # one and the same sequence of steps
    levels = ConstraintLevels(derive(andrews.system, 0.0, andrews.q0, andrews.v0))
    drift = [np.abs(levels.at(t, q, v).position).max() for t, q, v in zip(steps.t, steps.q, steps.v, strict=True)]
    assert steps.counters.steps_accepted == steps.t.size - 1 > 500
    assert max(drift) < 1e-8
    assert drift[-1] < 1e-12
    assert end.counters.residual_evaluations < 2000


def test_ida_solves_andrews_on_four_forms(andrews):
    for form in ("ggl", "index1", "integrated", "index2"):
        solution = ida.solver(form=form).solve(andrews, Request(rtol=1e-11, t_eval=[0.03]))
        assert solution.success
        assert max(end_errors(andrews, solution)) < 1e-7
