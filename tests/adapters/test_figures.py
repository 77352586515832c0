"""The figures that the comparison must reach, and every solver and form against every other on the registered problems."""

import importlib
from itertools import combinations

import numpy as np
import pytest

from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.solution.request import Request
from solvers import diffrax_ode, ida, scipy_ivp
from tests.adapters.scenes import ALL, HOST

TIGHT = 1e-9
APART = {  # three times the largest distance between two solvers at rtol 1e-9, in units of the problem's scales
    "jay_negrut_test1": 1.5e-7,
    "jay_negrut_pendulum": 4e-6,
    "andrews": 6e-5,  # it and the disk multiply errors by 1e4 and more
    "knife_edge": 6e-7,
    "rolling_disk3d_steady": 8e-5,
    "oscillator_chain": 3e-5,
}
INSTANTS = 8  # of comparison, the end included


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


def trajectories(scene, solvers, times):
    """Solver -> scaled q and v at ``times``, of those that take the problem; and the forms they use."""
    found, used = {}, set()
    for solver in solvers:
        asked = Request(rtol=TIGHT, t_eval=times, max_seconds=60.0)
        if solver.accepts(scene, asked) is None:
            solution = solver.solve(scene, asked)
            assert solution.success, f"{solver.name}: {solution.message}"
            found[solver.name] = np.hstack([solution.q / scene.scales.q, solution.v / scene.scales.v])
            used.add(solver.form)
    return found, used


@pytest.mark.parametrize("name", APART)
def test_every_form_and_solver_agrees_with_every_other_within_their_errors(name):
    """Pair by pair over the trajectory, and with the closed solution where there is one."""
    scene = registered(name)
    times = np.linspace(*scene.t_span, INSTANTS + 1)[1:]
    solvers = [*HOST, *((diffrax_ode.solver(method="Tsit5"),) if name == "andrews" else ())]
    found, used = trajectories(scene, solvers, times)
    assert len(used) >= 2
    if scene.exact is not None:
        motions = [scene.exact(t) for t in times]
        found["exact"] = np.array([np.append(at.q / scene.scales.q, at.v / scene.scales.v) for at in motions])
    for (one, rows), (other, others) in combinations(found.items(), 2):
        apart = np.abs(rows - others).max(axis=1)
        assert apart.max() < APART[name], f"{one} and {other} at t = {times[apart.argmax()]:g}"


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
    """At the end alone |g| is 1e-16 and flatters it.  Drift and evaluations are those of one and the same run."""
    steps = ida.solver(form="ggl").solve(andrews, Request(rtol=1e-6))
    levels = ConstraintLevels(derive(andrews.system, 0.0, andrews.q0, andrews.v0))
    drift = [np.abs(levels.at(t, q, v).position).max() for t, q, v in zip(steps.t, steps.q, steps.v, strict=True)]
    assert steps.counters.steps_accepted == steps.t.size - 1 > 500
    assert max(drift) < 1e-8
    assert drift[-1] < 1e-12
    assert steps.counters.residual_evaluations < 2000
    assert steps.counters.output_evaluations == steps.t.size, "one for the multipliers of each row, apart from those"


def test_ida_solves_andrews_on_four_forms(andrews):
    for form in ("ggl", "index1", "integrated", "index2"):
        solution = ida.solver(form=form).solve(andrews, Request(rtol=1e-11, t_eval=[0.03]))
        assert solution.success
        assert max(end_errors(andrews, solution)) < 1e-7
