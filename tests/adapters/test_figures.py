"""The figures that the comparison must reach, and every solver and form against every other on the registered problems."""

import importlib
from itertools import combinations

import numpy as np
import pytest

from hhtbench.lowering import ConstraintLevels, derive
from hhtbench.solution.request import Request
from solvers import diffrax_ode, ida
from tests.adapters.scenes import HOST
from tests.sample import slow

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


SAMPLE = ("andrews", "knife_edge", "rolling_disk3d_steady")  # constraints of the position, of the velocity, and of both


@pytest.mark.parametrize("name", [x if x in ("andrews", "knife_edge") else slow(x) for x in APART])
def test_every_form_and_solver_agrees_with_every_other_within_their_errors(name):
    """Pair by pair over the trajectory, and with the closed solution where there is one."""
    scene = registered(name)
    times = np.linspace(*scene.t_span, INSTANTS + 1)[1:]
    solvers = [*HOST, *((diffrax_ode.solver(method="Tsit5"),) if name == "knife_edge" else ())]
    found, used = trajectories(scene, solvers, times)
    assert len(used) >= 2
    if scene.exact is not None:
        motions = [scene.exact(t) for t in times]
        found["exact"] = np.array([np.append(at.q / scene.scales.q, at.v / scene.scales.v) for at in motions])
    for (one, rows), (other, others) in combinations(found.items(), 2):
        apart = np.abs(rows - others).max(axis=1)
        assert apart.max() < APART[name], f"{one} and {other} at t = {times[apart.argmax()]:g}"


def test_ida_holds_andrews_loops_over_all_its_internal_steps():
    """At the end alone |g| is 1e-16 and flatters it.  Drift and evaluations are those of one and the same run."""
    andrews = registered("andrews")
    steps = ida.solver(form="ggl").solve(andrews, Request(rtol=1e-6))
    levels = ConstraintLevels(derive(andrews.system, 0.0, andrews.q0, andrews.v0))
    drift = [np.abs(levels.at(t, q, v).position).max() for t, q, v in zip(steps.t, steps.q, steps.v, strict=True)]
    assert steps.counters.steps_accepted == steps.t.size - 1 > 500
    assert max(drift) < 1e-8
    assert drift[-1] < 1e-12
    assert steps.counters.residual_evaluations < 2000
    assert steps.counters.output_evaluations == steps.t.size, "one for the multipliers of each row, apart from those"
