"""Generalised-alpha, HHT-I3 and RATTLE keep the orders they were published with, in the loop of HHT."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol.errors import ProblemError
from hhtbench.solution.request import Request
from solvers.hht import HHT, Event
from solvers.hht.equations.generalised_alpha import GeneralisedAlpha
from solvers.hht.rivals import GeneralisedAlphaIntegrator, HHTI3Integrator, RattleIntegrator
from solvers.hht.verify import rivals
from solvers.hht.verify.damping import make_scene, measured_matrix, radius, spectrum, swing_of
from solvers.hht.verify.rivals import METHODS, QUANTITIES, SWING

SMALL = replace(SWING, counts=(400, 800))
TOP = replace(rivals.CASES[1], counts=(200, 400))
OURS = ("ggl", "index3", "extended", "hht_i3", "rattle")


@pytest.mark.parametrize("method", OURS)
def test_q_v_and_multipliers_are_of_order_two_with_constant_steps(method):
    assert rivals.orders(SMALL, method) == pytest.approx(dict.fromkeys(QUANTITIES, 2.0), abs=0.05)


@pytest.mark.parametrize(
    ("method", "order"), [("ggl", 2.0), ("index3", 2.0), ("extended", 2.0), ("hht_i3", 1.0), ("rattle", 2.0)]
)
def test_only_hht_i3_falls_to_order_one_where_the_mass_varies(method, order):
    """Expanding (H42): with M' its a1 is off by alpha h M^-1 M' v'."""
    found = rivals.orders(TOP, method)
    assert found["q"] == pytest.approx(order, abs=0.1)
    assert found["v"] == pytest.approx(order, abs=0.1)


def test_rows_of_the_verification_hold_on_a_small_swing():
    rows = [*rivals.constant_steps(SMALL, rivals.ALL), *rivals.drift(SMALL)]
    assert [row.claim for row in rows if row.passed is False] == []


def test_multipliers_of_the_first_steps_are_of_order_two_only_with_the_start_that_is_made_for_them():
    """Arnold and Bruels (2007) for the stabilised form, Arnold, Bruels and Cardona (2015) for index 3."""
    assert [row.claim for row in rivals.first_steps(SWING) if row.passed is False] == []


def test_on_steps_of_one_to_two_the_stabilised_form_keeps_order_two_and_index_3_loses_the_multipliers():
    held = rivals.orders(SMALL, "ggl", alternating=True)
    assert held == pytest.approx(dict.fromkeys(QUANTITIES, 2.0), abs=0.1)
    assert rivals.orders(SMALL, "ggl not rescaled", alternating=True)["lam"] < 1.5
    for method in ("index3", "index3 not rescaled"):
        assert rivals.orders(SMALL, method, alternating=True)["lam"] < 1.0


def closed_form(rho, frequency):
    """The (3, 3) map of (y, h y', h^2 a) of one step for y'' = -w^2 y, (H36) and (H39), with v' = -w^2 y at both ends."""
    c, square = GeneralisedAlpha(rho_inf=rho, form="ggl"), frequency**2
    end = np.array([[1.0, 0.0, -c.beta], [0.0, 1.0, -c.gamma], [(1.0 - c.alpha_f) * square, 0.0, 1.0 - c.alpha_m]])
    begin = np.array([[1.0, 1.0, 0.5 - c.beta], [0.0, 1.0, 1.0 - c.gamma], [-c.alpha_f * square, 0.0, -c.alpha_m]])
    return np.linalg.solve(end, begin)


@pytest.mark.parametrize("form", ["ggl", "extended"])
@pytest.mark.parametrize("rho", [0.0, 0.3, 0.5, 0.8, 1.0])
def test_spectral_radius_is_that_of_the_closed_form_and_rho_inf_at_infinity(rho, form):
    scene, options = make_scene("oscillator"), {"rho_inf": rho, "form": form}
    frequencies = np.logspace(-2, 4, 25)
    *found, last = (
        radius(spectrum(measured_matrix(scene, options, x, kind=GeneralisedAlphaIntegrator))) for x in (*frequencies, 1e8)
    )
    np.testing.assert_allclose(found, [radius(spectrum(closed_form(rho, x))) for x in frequencies], rtol=0, atol=1e-10)
    assert last == pytest.approx(rho, abs=1e-5)


def test_the_extended_form_is_of_order_two_where_constraints_hold_velocities():
    found = rivals.orders(rivals.KNIFE, "extended", ("q", "v"))
    assert found == pytest.approx({"q": 2.0, "v": 2.0}, abs=0.1)


@pytest.mark.parametrize("name", ["heavy_top", "sundials_slider_crank"])
def test_the_extended_form_with_rho_inf_of_a_half_is_hht_with_its_strongest_damping(name):
    """alpha_m = 0 and alpha_f = 1/3 there; 0.4 is none of its methods."""
    p = hb.load_problem(name)
    guesses = {"lam_guess": p.lam_guess, "mu_guess": p.mu_guess}
    steps = np.tile([5e-3, 1e-2], 20)
    ends = []
    for kind, options in (
        (HHT, {"alpha": -1 / 3, "start": "shifted"}),
        (GeneralisedAlphaIntegrator, {"form": "extended", "rho_inf": 0.5}),
        (GeneralisedAlphaIntegrator, {"form": "extended", "rho_inf": 0.4}),
    ):
        t0 = p.t_span[0]
        ends.append(kind(p.system, **options).solve((t0, t0 + steps.sum()), p.q0, p.v0, steps=steps, **guesses))
    for what in ("q", "v", "lam", "mu"):
        np.testing.assert_allclose(getattr(ends[0], what), getattr(ends[1], what), rtol=1e-10, atol=1e-10)
    assert np.abs(ends[0].v - ends[2].v).max() > 1e-9


@pytest.mark.parametrize(
    ("kind", "options", "parts"), [(RattleIntegrator, {}, -1.0), (HHT, {"alpha": 0.0}, 2.0)], ids=["rattle", "hht"]
)
def test_rattle_has_the_period_of_the_leapfrog_and_hht_that_of_the_trapezoidal_rule(kind, options, parts):
    """Where the force depends on the position: too long by -1 and by 2 parts of (w h)^2/24."""
    longer = swing_of(spectrum(measured_matrix(make_scene("oscillator"), options, 0.1, kind=kind)), 0.1).elongation
    assert longer / 0.1**2 * 24 == pytest.approx(parts, rel=0.01)


def test_under_a_constant_force_rattle_moves_as_hht_without_damping():
    steps = rivals.lengths(SMALL, SMALL.counts[0])
    first, second = (rivals.integrated(SMALL, method, steps) for method in ("undamped hht", "rattle"))
    np.testing.assert_allclose(first.q, second.q, rtol=0, atol=1e-12)
    np.testing.assert_allclose(first.v, second.v, rtol=0, atol=1e-12)


@pytest.mark.parametrize("method", OURS)
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
    integrator = solver.integrator(swing.system)
    with pytest.raises(ProblemError, match=f"{name} takes prescribed steps only"):
        integrator.solve((0.0, 1.0), swing.q0, swing.v0, rtol=1e-4)
    with pytest.raises(ProblemError, match="position constraints only"):
        p = hb.load_problem("knife_edge")
        solver.integrator(p.system).solve((0.0, 1.0), p.q0, p.v0, steps=10)


def test_options_out_of_range_are_refused():
    system = hb.load_problem("simple_pendulum").system
    for options in ({"rho_inf": 1.1}, {"form": "index2"}, {"start": "trapezoidal"}):
        with pytest.raises(ProblemError, match=next(iter(options))):
            GeneralisedAlphaIntegrator(system, **options)
    with pytest.raises(ProblemError, match="alpha must lie"):
        HHTI3Integrator(system, alpha=0.1)
    with pytest.raises(TypeError, match="rattle does not know rho_inf"):
        hb.load_solver("rattle(rho_inf=0.5)")
