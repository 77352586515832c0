"""Verdicts of the wing on costs that are known, and Exudyn's scenes beside ours."""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from problems import bushing_chain, cable_pendulum, spinup_beam
from tests.analysis.laws import failed, ladder, law
from tests.performance.wing.beside_exudyn import UNIT, least
from tests.performance.wing.exudyn_scenes import Settings, Theirs, exudyn, unstrained
from tests.performance.wing.verdicts import SCENES, by_scene, summary, verdicts


def rows_of(problem, hht=10.0, rival=40.0, drift=0.0):
    """HHT, generalised-alpha at three times HHT's costs, IDA at ``rival`` evaluations for an error of 1, all of order 2."""
    rows = law("hht", hht, 2, drift=drift, problem=problem) + law("generalised_alpha", 3 * hht, 2, problem=problem)
    return rows + law("ida", rival, 2, problem=problem)


def test_factor_is_over_the_best_method_that_is_no_alpha_method():
    found = verdicts(rows_of("belt_drive") + rows_of("ball_mill", rival=5.0), [1e-2])
    wins, loses = found["belt_drive", 1e-2], found["ball_mill", 1e-2]
    assert (wins.outcome, wins.rival, loses.outcome, loses.winner) == ("wins", "ida", "loses", "ida")
    assert [wins.factor, loses.factor] == pytest.approx([4.0, 0.5])


def test_hht_that_drifts_reaches_nothing():
    found = verdicts(rows_of("belt_drive", drift=1e-9), [1e-2])["belt_drive", 1e-2]
    assert (found.outcome, found.factor, found.ours) == ("absent", 0.0, None)


def test_without_a_rival_the_factor_is_what_the_longest_tried_took():
    late = failed("ida", 1e-1, status="deadline", problem="belt_drive")
    rows = [*law("hht", 10.0, 2, problem="belt_drive"), *ladder([replace(late, timing={"solve_cpu_s": 2.0})])]
    found = verdicts(rows, [1e-2])["belt_drive", 1e-2]
    assert found.won
    assert found.bound
    assert found.factor == pytest.approx(2.0 / (10.0 * 10 * 1e-5))


def test_scene_of_two_problems_has_its_worse_verdict():
    rows = [*rows_of(SCENES["bushing_chain"][0]), *rows_of(SCENES["bushing_chain"][1], rival=20.0), *rows_of("belt_drive")]
    scenes = by_scene(verdicts(rows, [1e-3]), 1e-3)
    assert {name: one.factor for name, one in scenes.items()} == pytest.approx({"bushing_chain": 2.0, "belt_drive": 4.0})
    assert summary(scenes).startswith("cheapest of all solvers on 2 of 2 scenes, level on 0 more, cheaper than all")
    assert "no alpha methods on 2; the best of these takes 3 times as long" in summary(scenes)


def test_search_finds_the_least_number_of_steps():
    for exact in (40, 100, 1000, 12_345):
        found = least(lambda steps, exact=exact: (exact / steps) ** 2, 1.0)
        assert exact <= found <= 1.1 * exact + UNIT
    assert least(lambda steps: 1.0, 1e-3) is None


@pytest.mark.parametrize(
    "problem",
    [spinup_beam.problem(n_elements=3), bushing_chain.problem(c=3.5e6, n_bars=3), cable_pendulum.problem(n_elements=3)],
    ids=lambda problem: problem.name,
)
def test_exudyn_has_our_masses_and_forces(problem):
    """At a random state near the start; the dampers of bushings differ in terms of rate times offset, hence no velocity."""
    pytest.importorskip("exudyn")
    draw = np.random.default_rng(5)
    theirs, n = Theirs(problem), problem.q0.size
    q = problem.q0 + 1e-3 * draw.standard_normal(n)
    v = 0.0 * q if problem.name == "bushing_chain" else 0.1 * draw.standard_normal(n)
    solver = exudyn.MainSolverImplicitSecondOrder()
    solver.InitializeSolver(theirs.mbs, theirs.settings(Settings(steps=1)))
    theirs.mbs.systemData.SetODE2Coordinates(list(q - unstrained(problem)))
    theirs.mbs.systemData.SetODE2Coordinates_t(list(v))
    solver.ComputeMassMatrix(theirs.mbs)
    mass = jnp.asarray(problem.system.mass_matrix)
    np.testing.assert_allclose(solver.GetSystemMassMatrix(), jnp.diag(mass) if mass.ndim == 1 else mass, atol=1e-14)
    solver.ComputeODE2RHS(theirs.mbs)
    ours = np.asarray(jax.jit(lambda q, v: problem.system.force(0.0, q, v))(q, v))
    np.testing.assert_allclose(np.array(solver.GetSystemResidual())[:n], ours, atol=1e-11 * np.abs(ours).max())


def test_exudyn_arrives_where_we_do():
    """Both of second order: 640 steps leave 1e-4 of the chain's scale, the dampers of one bushing less than that."""
    pytest.importorskip("exudyn")
    theirs = Theirs(bushing_chain.problem(c=3.5e3))
    coarse, fine = (theirs.error(Settings(steps=steps)) for steps in (320, 640))
    assert coarse / fine > 3.0
    assert fine < 1.2e-4
