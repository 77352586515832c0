"""Generalised-alpha, HHT-I3 and RATTLE keep the orders they were published with, in the loop of HHT."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event
from hhtbench.solution.request import Request
from solvers.hht.equations.generalised_alpha import GeneralisedAlpha
from solvers.hht.rivals import GeneralisedAlphaIntegrator, HHTI3Integrator, RattleIntegrator
from solvers.hht.verify import rivals
from solvers.hht.verify.rivals import METHODS, SWING
from tests.sample import slow

SMALL = replace(SWING, counts=(400, 800))
TOP = replace(rivals.CASES[1], counts=(200, 400))
OURS = ("ggl", "index3", "extended", "hht_i3", "rattle")


def test_orders_and_drift_of_the_verification_hold():
    """Where the mass varies HHT-I3 alone is of order one: with M' its a1 is off by alpha h M^-1 M' v', (H42).

    Multipliers of the first steps: Arnold and Bruels (2007) for the stabilised form, with Cardona (2015) for index 3.
    """
    rows = [*rivals.constant_steps(SMALL, rivals.ALL), *rivals.constant_steps(TOP, rivals.ALL, ("q", "v"))]
    rows += rivals.constant_steps(rivals.KNIFE, ("extended",), ("q", "v"))
    rows += [*rivals.drift(SMALL), *rivals.first_steps(SWING), *rivals.changing_steps(SMALL)]
    assert [row.claim for row in rows if row.passed is False] == []


@pytest.mark.parametrize("method", [x if x in ("ggl", "hht_i3") else slow(x) for x in OURS])
def test_a_chain_that_is_too_large_for_straight_lines_is_stepped_with_a_sparse_matrix(method):
    problem, (kind, options) = hb.load_problem("planar_chain(n_links=60)"), METHODS[method]
    integrator = kind(problem.system, **options)
    solution = integrator.solve((0.0, 0.02), problem.q0, problem.v0, steps=20)
    assert solution.success
    assert "machine code, band matrix" in integrator.engine_used
    assert np.abs(problem.system.constraint(0.0, jnp.asarray(solution.q[-1]))).max() < 1e-12


def test_events_checkpoints_and_single_steps_serve_them_too():
    problem = hb.load_problem("simple_pendulum")
    through = Event(lambda t, q, v: q[0], terminal=True)
    ended = GeneralisedAlphaIntegrator(problem.system, events=through).solve((0.0, 10.0), problem.q0, problem.v0, step=0.01)
    assert ended.status is hb.Status.event
    assert abs(ended.q[-1][0]) < 1e-9
    one, other = GeneralisedAlphaIntegrator(problem.system), GeneralisedAlphaIntegrator(problem.system)
    one.init_step(0.0, problem.q0, problem.v0, step=0.01)
    one.step()
    other.resume(one.checkpoint())
    for integrator in (one, other):
        integrator.step()
    np.testing.assert_array_equal(one.state.q, other.state.q)
    with pytest.raises(ProblemError, match="made by a solver with method"):
        RattleIntegrator(problem.system).resume(one.checkpoint())


@pytest.mark.parametrize("name", ["generalised_alpha", "hht_i3", "rattle"])
def test_tolerances_and_velocity_constraints_are_declined_in_words(name):
    solver, swing = hb.load_solver(name), hb.load_problem("simple_pendulum")
    assert "prescribed steps only" in solver.accepts(swing, Request(rtol=1e-4))
    assert "position constraints only" in solver.accepts(hb.load_problem("knife_edge"), Request(step=0.01))
    assert solver.accepts(swing, Request(step=0.01)) is None
    assert solver.accepts(hb.load_problem("four_bars"), Request(step=0.01)) is None  # its mechanism declares None
    integrator = solver.integrator(swing.system)
    with pytest.raises(ProblemError, match=f"{name} takes prescribed steps only"):
        integrator.solve((0.0, 1.0), swing.q0, swing.v0, rtol=1e-4)
    with pytest.raises(ProblemError, match="position constraints only"):
        p = hb.load_problem("knife_edge")
        solver.integrator(p.system).solve((0.0, 1.0), p.q0, p.v0, steps=10)


@pytest.mark.parametrize("rho", [0.0, 0.3, 1.0])
def test_weights_of_rho_inf_are_those_that_were_published(rho):
    """(H39), Arnold and Bruels (2007); that steps use them shows in tests/hht/test_steps_solve_equations.py."""
    weights = GeneralisedAlpha(rho_inf=rho, form="ggl")
    assert (weights.alpha_m, weights.alpha_f) == pytest.approx(((2 * rho - 1) / (rho + 1), rho / (rho + 1)))
    assert weights.gamma == pytest.approx(0.5 + weights.alpha_f - weights.alpha_m)
    assert weights.beta == pytest.approx((0.5 + weights.gamma) ** 2 / 4)


def test_options_out_of_range_are_refused():
    system = hb.load_problem("simple_pendulum").system
    for options in ({"rho_inf": 1.1}, {"form": "index2"}, {"start": "trapezoidal"}):
        with pytest.raises(ProblemError, match=next(iter(options))):
            GeneralisedAlphaIntegrator(system, **options)
    with pytest.raises(ProblemError, match="alpha must lie"):
        HHTI3Integrator(system, alpha=0.1)
    with pytest.raises(TypeError, match="rattle does not know rho_inf"):
        hb.load_solver("rattle(rho_inf=0.5)")
