"""Readings and messages of mechanisms: measures as functions of the state, turns of springs, axes, tables, bad names."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.mechanics import Mechanism
from hhtbench.protocol.errors import ProblemError
from solvers.hht.events.functions import seen_by
from tests.sample import slow

Z = (0.0, 0.0, 1.0)


def wheel(plane, angle=0.0, rate=0.0):
    """A wheel of 0.2 kg m^2 on a hinge, without weight."""
    none = (0.0, 0.0) if plane else (0.0, 0.0, 0.0)
    m = Mechanism(none, plane=plane)
    m.body("wheel", 1.0, 0.2 if plane else (0.1, 0.15, 0.2), at=none)
    m.revolute("A", "ground", "wheel", none, *(() if plane else (Z,)))
    m.assemble({"A": angle}, rates={"A": rate})
    return m


def slider_crank(**motor):
    m = Mechanism(plane=True)
    m.body("crank", 1.0, 0.02, at=(0.25, 0))
    m.body("rod", 2.0, 0.24, at=(1.1, 0))
    m.body("slider", 3.0, 0.03, at=(1.7, 0))
    m.revolute("A", "ground", "crank", (0, 0))
    m.revolute("B", "crank", "rod", (0.5, 0))
    m.revolute("C", "rod", "slider", (1.7, 0))
    m.prismatic("D", "ground", "slider", (1.7, 0), (1, 0))
    m.spring("S", "slider", "ground", (1.7, 0), (3, 0), 40.0, 2.0)
    if motor:
        m.motor("drive", "A", **motor)
    return m


@functools.cache
def driven():
    m = slider_crank(speed=4.0)
    m.assemble({"A": 0.5})
    return m, hb.solve(m.problem((0, 0.5)), "projected", rtol=1e-8, t_eval=np.linspace(0, 0.5, 6))


@pytest.mark.parametrize("plane", [slow(True), False])
def test_a_clock_spring_wound_by_turns_pushes_as_one_degree_of_freedom_says(plane):
    """From 5 rad, three turns from rest, and back by less than a turn: ``J w' = -k (angle - free) - c w``."""
    m = wheel(plane, angle=5.0)
    m.torsion("S", "A", 0.1, 0.02, free=-6 * np.pi)
    solution = hb.solve(m.problem((0, 1.0)), "projected", rtol=1e-9)
    law = lambda t, y: [y[1], (-0.1 * (y[0] + 6 * np.pi) - 0.02 * y[1]) / 0.2]  # noqa: E731
    expected = solve_ivp(law, (0, 1.0), [5.0, 0.0], rtol=1e-11, atol=1e-12).y[0, -1]
    assert expected < 5.0 - 1.6 * np.pi
    np.testing.assert_allclose(m.of(solution, "A").angle()[-1], expected, atol=1e-7)
    np.testing.assert_allclose(m.of(solution, "S").measure()[-1], expected, atol=1e-7)


def test_a_spring_in_space_ends_the_run_where_its_turns_cannot_be_counted():
    m = wheel(False)
    m.torsion("S", "A", 0.1, 0.02, free=-6 * np.pi)
    solution = hb.solve(m.problem((0, 3.0)), "projected", rtol=1e-6)
    assert solution.status.label == "nonfinite_callback"
    np.testing.assert_allclose(m.of(solution, "A").angle()[-1], -(2 * np.pi - 0.5), atol=1e-3)


@pytest.mark.parametrize("plane", [True, slow(False)])
def test_angle_of_a_joint_by_name_stops_a_run_as_machine_code(plane):
    m = wheel(plane, angle=0.5, rate=2.0)
    angle, rate = m.measure("A"), m.measure("A", rate=True)
    event = hb.Event(lambda t, q, v: angle(t, q, v) - 4.5, terminal=True)
    assert seen_by(event.function) is not None
    solution = hb.solve(m.problem((0, 5)), "hht", steps=1600, events=[event])
    np.testing.assert_allclose(solution.t[-1], 2.0, atol=1e-4)  # half a turn is at 1.32 s
    np.testing.assert_allclose(jax.jit(rate)(0.0, solution.q[-1], solution.v[-1]), 2.0, atol=1e-6)


def test_travel_by_name_is_that_of_the_reading_and_rates_are_derivatives():
    m, solution = driven()
    travel, rate = m.measure("D"), m.measure("D", rate=True)
    both = [jax.jit(jax.vmap(f, (None, 0, 0)))(0.0, solution.q, solution.v) for f in (travel, rate)]
    np.testing.assert_allclose(both[0], m.of(solution, "D").travel(), atol=1e-12)
    np.testing.assert_allclose(both[1], m.of(solution, "slider").velocity()[:, 0], atol=1e-12)
    np.testing.assert_allclose(m.of(solution, "D").rate(), both[1], atol=1e-12)


def test_axes_of_a_planar_bushing_turn_its_stiffness():
    """``f = -R diag(k) R^T x`` on a body moved by x, whose frame is turned otherwise."""
    m = Mechanism((0.0, 0.0), plane=True)
    m.body("base", 1.0, 0.1, turned=0.3)
    m.body("block", 1.0, 0.1, turned=1.1)
    m.bushing("cushion", "base", "block", (0.0, 0.0), (90.0, 20.0, 3.0), axes=0.7)
    x, (q, v) = np.array([0.02, -0.01]), m.start()
    q[3:5] += x
    R = np.array([[np.cos(0.7), -np.sin(0.7)], [np.sin(0.7), np.cos(0.7)]])
    expected = -R @ np.diag([90.0, 20.0]) @ R.T @ x
    np.testing.assert_allclose(jax.jit(lambda *state: m.system().force(*state))(0.0, q, v)[3:5], expected, rtol=1e-12)


def test_table_has_rates_power_and_forces_of_elements():
    m, solution = driven()
    table = m.table(solution)
    drive, spring = m.of(solution, "drive"), m.of(solution, "S")
    for name, values in {
        "crank.rate": 4.0 + 0 * solution.t,
        "A.rate": 4.0 + 0 * solution.t,
        "drive.power": 4.0 * drive.torque(),
        "S.measure": 3.0 - table["slider.x"],
        "S.tension": spring.tension(),
    }.items():
        np.testing.assert_allclose(table[name], values, atol=1e-6, err_msg=name)


def test_slip_of_a_wheel_in_the_plane_is_its_sliding_over_its_speed():
    m = Mechanism((0.0, -9.81), plane=True)
    m.body("wheel", 10.0, 0.5, at=(0, 0.3), velocity=(2.0, 0.0), rate=-5.0)
    m.tyre("T", "wheel", "ground", (0, 0.3), 0.3, 1e4, point=(0, 0), normal=(0, 1), grip=(0.8, 10.0, 10.0, 0.1), onset=1e-4)
    solution = hb.solve(m.problem((0, 1e-3)), "projected", rtol=1e-6)
    lever = 0.3 + m.of(solution, "T").measure()[0]
    np.testing.assert_allclose(m.of(solution, "T").slip()[0], (2.0 - 5.0 * lever) / np.hypot(2.0, 0.1), rtol=1e-10)


def test_integers_of_a_law_may_count():
    m = wheel(True)
    m.motor("drive", "A", functools.partial(lambda count, size, t: size * sum(t**i for i in range(1, count)), 3, 2.0))
    m.assemble()
    np.testing.assert_allclose(m.bodies["wheel"].rate, 2.0, rtol=1e-12)


BAD = {
    r"body 'crank' has no force; it has .*position.*velocity": lambda m, s: m.of(s, "crank").force(),
    r"there is no joint, body or force 'zzz'\. There are A, B, C, D, drive, crank": lambda m, s: m.of(s, "zzz"),
    r"revolute 'A' acts on ground and crank; got on='slider'": lambda m, s: m.of(s, "A").force(on="slider"),
    r"spring 'S' has no slip": lambda m, s: m.of(s, "S").slip(),
    r"joint 'A' is revolute: it has no travel": lambda m, s: m.measure("A", travel=True),
}


@pytest.mark.parametrize("text", BAD)
def test_wrong_readings_say_what_there_is(text):
    with pytest.raises((ProblemError, AttributeError), match=text):
        BAD[text](*driven())


@pytest.mark.parametrize("motor", [{"speed": 5.0}, {"law": lambda t: 5 * t}, {"law": lambda t: 0.3 + 0 * jnp.sin(t)}])
def test_a_forgotten_assemble_is_named_with_the_motor(motor):
    m = slider_crank(**motor)
    with pytest.raises(
        ProblemError, match=r"motor 'drive' prescribes .* call m.assemble\(\), which sets positions and rates"
    ):
        m.problem((0, 1))
    m.assemble()
    m.problem((0, 1))


def test_assemble_says_at_which_angle_a_motor_of_a_rate_starts():
    m = slider_crank(speed=5.0)
    assert "motor 'drive' starts at 0 rad" in str(m.assemble())
    assert "starts at" not in str(m.assemble({"A": 0.4}))
