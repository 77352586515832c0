"""States and sampled inputs of mechanisms by name, against a few lines of SciPy."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.mechanics import Mechanism


def arm(plane):
    """An arm on a motor: sampled at 20 Hz, after 20 ms, with a lag of 0.2 s; angle, rate and torque at 1 s."""
    m = Mechanism(plane=plane)
    place, pin = ((0, -0.5), (0, 0)) if plane else ((0, 0, -0.5), (0, 0, 0))
    axis = {} if plane else {"axis": (0, -1, 0)}
    m.body("arm", 2.0, 0.1 if plane else (0.1, 0.1, 0.1), at=place)
    m.revolute("A", "ground", "arm", at=pin, **axis)
    m.assemble({"A": 0.3})
    angle, rate = m.measure("A"), m.measure("A", rate=True)
    m.state("torque", lambda t, wanted, torque: 5 * (wanted - torque), scale=10.0)
    m.input("wanted", lambda t, q, v: 10 * (1 - angle(t, q, v)) - 3 * rate(t, q, v), every=0.05, delay=0.02)
    m.actuator("motor", "A", lambda torque, t: torque)
    return m, m.problem((0, 1))


def exact():
    samples = [(i / 20, "sample", i) for i in range(20)] + [(i / 20 + 0.02, "works", i) for i in range(20)]
    y, u, t, taken = np.array([0.3, 0.0, 0.0]), 0.0, 0.0, {}
    for time, what, i in [*sorted((round(one[0], 9), *one[1:]) for one in samples), (1.0, "end", 0)]:
        if time > t:

            def rates(_, y, u=u):
                return [y[1], (-9.81 * np.sin(y[0]) + y[2]) / 0.6, 5 * (u - y[2])]

            y, t = solve_ivp(rates, (t, time), y, rtol=1e-10, atol=1e-12).y[:, -1], time
        if what == "sample":
            taken[i] = 10 * (1 - y[0]) - 3 * y[1]
        elif what == "works":
            u = taken[i]
    return y, u


@pytest.mark.parametrize("plane", [True, False])
def test_a_motor_with_a_lag_is_controlled_by_samples(plane):
    m, problem = arm(plane)
    y, u = exact()
    for solver, most in (("hht", 1e-5), ("projected", 1e-9)):
        run = hb.solve(problem, solver, rtol=1e-6)
        found = [m.of(run, "A").angle(), m.of(run, "A").rate(), m.of(run, "torque").value(), m.of(run, "wanted").value()]
        assert run.success
        assert np.allclose([values[-1] for values in found], [*y, u], rtol=0, atol=10 * most)
    turning = (-9.81 * np.sin(y[0]) + y[2]) / 0.6
    assert np.isclose(np.abs(m.of(run, "arm").angular_acceleration()[-1]).max(), abs(turning), atol=1e-7)
    assert m.table(run)["torque"][-1] == run.x[-1, 0]
    assert np.shape(problem.sketch(run.q[-1])["lines"]) == ((1, 2, 2) if plane else (1, 2, 3))


def test_states_and_inputs_may_be_vectors_and_loads_may_take_them():
    m = Mechanism(gravity=(0, 0), plane=True)
    m.body("disk", 1.0, 0.5)
    m.state("wind", lambda t, wind: jnp.stack([wind[1], -wind[0]]), start=[1.0, 0.0])
    m.input(
        "thrust", lambda t, q, v, wind, thrust: np.array([0.0, 1.0]) + 0 * thrust + 0 * wind, every=1.0, start=[0.0, 0.0]
    )
    m.load("push", "disk", force=lambda wind, thrust: wind + thrust, torque=lambda t, v: -v[2] + 0 * t)
    run = hb.solve(m.problem((0, 2)), "projected", rtol=1e-9)
    wind = np.stack([np.cos(run.t), -np.sin(run.t)], axis=1)
    assert np.allclose(m.of(run, "wind").value(), wind, atol=1e-8)
    assert np.allclose(run.v[:, 0], np.sin(run.t), atol=1e-8)
    assert np.allclose(run.v[:, 1], np.cos(run.t) - 1 + run.t, atol=1e-8)
    assert np.allclose(m.table(run)["wind.1"], wind[:, 1], atol=1e-8)


def test_wrong_signals_are_refused_by_name():
    m, problem = arm(plane=True)
    for name in ("t", "two words", "arm"):
        with pytest.raises(hb.ProblemError, match=name):
            m.state(name, lambda t: 0.0)
    m.load("odd", "arm", force=lambda t, wind: jnp.zeros(2))
    with pytest.raises(hb.ProblemError, match="arguments t, wind"):
        m.problem((0, 1))
    with pytest.raises(hb.ProblemError, match="states or sampled inputs"):
        hb.equilibrium(problem)
    with pytest.raises(hb.ProblemError, match="states or sampled inputs"):
        hb.modes(problem)


def sliding():
    m = Mechanism(gravity=(0, 0), plane=True)
    m.body("block", 1.0, 0.1)
    m.prismatic("P", "ground", "block", at=(0, 0), axis=(1, 0))
    m.state("torque", lambda torque: -torque, start=1.0)
    return m


def test_misspelt_names_are_not_time():
    for wrong in (
        lambda m: m.actuator("a", "P", lambda torqe: torqe),
        lambda m: m.load("a", "block", force=lambda torqe: jnp.stack([torqe, 0])),
        lambda m: m.load("a", "block", torque=lambda torqe: torqe),
        lambda m: m.state("other", lambda torqe: torqe),
        lambda m: m.input("other", lambda torqe: torqe, every=1),
    ):
        m = sliding()
        wrong(m)
        with pytest.raises(hb.ProblemError, match="arguments torqe"):
            m.problem((0, 1))
    m = sliding()
    m.motor("M", "P", lambda torque: torque)
    with pytest.raises(hb.ProblemError, match="takes time alone; got torque"):
        m.problem((0, 1))


def test_sizes_of_states_and_inputs_do_not_scale_a_problem_that_has_none():
    assert sliding().problem((0, 1)).note_on_scales
    m = sliding()
    m.input("push", lambda t: 1e4, every=0.1, scale=1e4)
    m.actuator("a", "P", lambda push: push)
    problem = m.problem((0, 1), scales=hb.Scales(v=2.0))
    assert problem.scales.v.tolist() == [2.0, 2.0, 2.0, 1.0, 1.0]
    assert problem.scales.q[-1] == 1e4


def test_a_measure_stays_right_where_further_bodies_are_added():
    m, before = arm(plane=True)
    angle = m.measure("A")
    m.body("more", 1.0, 0.1, at=(5, 5), turned=0.5)
    m.revolute("B", "ground", "more", at=(5, 6))
    after = m.problem((0, 1))
    assert float(angle(0.0, after.q0[:6], after.v0[:6])) == pytest.approx(0.3)
    assert float(angle(0.0, before.q0[:3], before.v0[:3])) == pytest.approx(0.3)
