"""Which vibration has made steps under error control many is told where the last steps show it, and only there."""

import re
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol import NumpySystem, parameter
from hhtbench.result import Status
from hhtbench.testing.extremes.linkages import DoublePendulum
from solvers.hht import HHT
from solvers.hht.control.controller import ControlOptions
from solvers.hht.control.tolerances import make_tolerances
from solvers.hht.run.followed import followed
from solvers.hht.run.pace import CROWDED
from solvers.hht.run.tension import fastest

STRETCHED = "Forces carry a vibration of"


def told(system, span, *start, options=None, **request):
    """The frequency that a message names, and who carries the vibration; 0 and "" where it names none."""
    solution = HHT(system, **(options or {})).solve(span, *start, **{"rtol": 1e-4, "max_num_steps": 4_000, **request})
    found = re.search(r"(Forces|Constraint forces) carry a vibration of (\S+) rad/s", solution.message)
    return (float(found[2]), found[1]) if found else (0.0, "")


@pytest.mark.parametrize("constrained", [False, True])
def test_a_vibration_of_a_spring_that_makes_steps_many_is_named(constrained):
    """Of two masses that fly along, or swing, with a stretched spring."""
    k, light = 1e8, 1e-2
    weight = -9.81 if constrained else 0.0

    def force(t, q, v):
        pull = k * (q[2] - q[0] - 1e-8) * np.array([1.0, 0.0, -1.0])
        return pull + np.array([0.0, weight, 0.0])

    options = {"constraint": lambda t, q: np.array([(q[:2] @ q[:2] - 1.0) / 2.0])} if constrained else {}
    system = NumpySystem(mass_matrix=[1.0, 1.0, light], force=force, **options)
    omega, carrier = told(system, (0.0, 2.0), [0.0, -1.0, 0.0], [1.0, 0.0, 1.0], rtol=1e-6, max_num_steps=2_000)
    assert omega == pytest.approx(np.sqrt(k * (1.0 / light + 1.0)), rel=0.02)  # 1.005 of the light one's own
    assert carrier == "Forces"


def between(k, u=1.0):
    """A spring between neighbours in a row, in units of ``u``."""

    def force(t, q, v):
        pull = k * np.diff(q)
        return np.append(pull, 0.0) - np.append(0.0, pull)

    return NumpySystem(force=force)


@pytest.mark.parametrize("u", [1e-200, 1e-150, 1e-6, 1e100])
def test_units_do_not_matter(u):
    start = [0.0, 1e-3 * u], [u, u]
    assert told(between(1e6), (0.0, 3.0), *start) == (1410.0, "Forces")


class Moved(DoublePendulum):
    """The pivot at x = ``place``."""

    place: float = parameter(0.0)

    def constraint(self, t, q):
        return super().constraint(t, q - self.place * jnp.array([1.0, 0.0, 1.0, 0.0]))


@pytest.mark.parametrize("place", [0.0, 1e2, 1e4])
def test_nor_does_the_place(place):
    q, v = DoublePendulum.straight(0.5)
    moved = Moved(ratio=1e6, place=place)
    omega, carrier = told(moved, (0.0, 5.0), q + place * np.array([1.0, 0.0, 1.0, 0.0]), v)
    assert omega == pytest.approx(4.4e3, rel=0.1) and carrier == "Constraint forces"


@pytest.mark.parametrize("n", [4, 20])
def test_several_together_are_named_by_about_the_fastest(n):
    q = np.zeros(n)
    q[-1] = 1e-3
    omega, carrier = told(between(1e6), (0.0, 3.0), q, np.ones(n))
    assert 1.3e3 < omega < 2e3 and carrier == "Forces"


@pytest.mark.parametrize("rubbing", [0.0, 1e-9])
def test_forces_are_not_blamed_for_what_a_declared_reaction_carries(rubbing):
    def rows(t, q):
        x, y = q[2:] - q[:2]
        return np.array([[q[0], q[1], 0.0, 0.0], [-x, -y, x, y]])

    rods = {
        "mass_matrix": np.repeat([1.0, 1e6], 2),
        "force": lambda t, q, v: -9.81 * np.array([0.0, 1.0, 0.0, 1e6]),
        "constraint": lambda t, q: np.array([q[:2] @ q[:2] - 1.0, (q[2:] - q[:2]) @ (q[2:] - q[:2]) - 1.0]) / 2.0,
        "constraint_jacobian": rows,
        "reaction": lambda t, q, v, lam: -rows(t, q).T @ lam - rubbing * v,
    }
    assert (
        told(NumpySystem(**rods), (0.0, 5.0), *DoublePendulum.straight(0.5), max_num_steps=1_000)[1] == "Constraint forces"
    )


def test_nor_constraint_forces_for_a_spring_beside_what_could_vibrate_faster():
    """A pendulum of 2000 rad/s hangs at rest there."""
    system = NumpySystem(
        force=lambda t, q, v: np.array([0.0, -4e6, 1e6 * (q[3] - q[2]), -1e6 * (q[3] - q[2])]),
        constraint=lambda t, q: np.array([(q[:2] @ q[:2] - 1.0) / 2.0]),
    )
    assert told(system, (0.0, 3.0), [0.0, -1.0, 0.0, 1e-3], [0.0, 0.0, 1.0, 1.0], max_num_steps=1_000) == (1410.0, "Forces")


def test_what_is_below_the_tolerance_is_not_blamed_for_a_longest_step():
    run = told(
        between(1e4), (0.0, 30.0), [0.0, 1e-5], [1.0, 1.0], options={"max_step": 5e-3}, rtol=1e-2, max_num_steps=10_000
    )
    assert run == (0.0, "")


@pytest.mark.parametrize("share", [0.7, 0.95, 1.2, 1.5])
def test_a_drive_near_the_frequency_of_a_damped_spring_is_no_vibration_of_the_spring(share):
    def force(t, q, v):
        pull = 1e6 * (q[1] - q[0]) + 4e4 * (v[1] - v[0])
        return np.array([0.0, -pull + 1e5 * np.sin(share * 1e3 * t)])

    assert told(NumpySystem(force=force), (0.0, 3.0), [0.0, 0.0], [1.0, 1.0], rtol=1e-5) == (0.0, "")


def test_a_swing_of_a_whole_scene_is_not_told():
    crane = {
        "mass_matrix": np.repeat([20.0, 5.0], 2),
        "force": lambda t, q, v: -9.81 * np.array([0.0, 20.0, 0.0, 5.0]),
        "constraint": lambda t, q: np.array([q[1], ((q[2] - q[0]) ** 2 + (q[3] - q[1]) ** 2 - 1.0) / 2.0]),
    }
    start = [0.0, 0.0, 0.05, -np.sqrt(1.0 - 0.05**2)], np.zeros(4)
    assert told(NumpySystem(**crane), (0.0, 100.0), *start, rtol=1e-5, atol=1e-5, max_num_steps=2_000) == (0.0, "")


@pytest.mark.parametrize("damping", [0.0, 1e6])
@pytest.mark.parametrize("tied", [0.0, 1.0])
@pytest.mark.parametrize("w", [500.0, 2e3])
def test_a_drive_is_not_taken_for_a_vibration_of_what_rests_beside_it(w, tied, damping):
    """Springs of 1e4 rad/s, overdamped or not, which hang on what is driven, or on nothing."""

    def force(t, q, v):
        pull = 1e8 * (q[1] - tied * q[0]) + damping * (v[1] - tied * v[0])
        return np.array([300.0 * np.sin(w * t), -pull])

    solution = HHT(NumpySystem(force=force)).solve((0.0, 250.0 / w), [0.0, 0.0], [1.0, tied], rtol=1e-5)
    assert solution.success and solution.counters.steps_accepted > CROWDED
    assert "vibration" not in solution.message


def test_a_slower_spring_is_named_where_a_faster_one_rests():
    system = NumpySystem(force=lambda t, q, v: np.array([0.0, -1e6 * (q[1] - q[0]), -1e10 * (q[2] - q[0])]))
    start = [0.0, 1e-3, 0.0], [1.0, 1.0, 1.0]
    solution = HHT(system).solve((0.0, 3.0), *start, rtol=1e-4, max_num_steps=4_000)
    assert f"{STRETCHED} 1e+03 rad/s" in solution.message


def test_with_b_beyond_a_half_constraint_forces_are_named_with_the_option_that_is_left():
    system, start = DoublePendulum(ratio=1e6), DoublePendulum.straight(0.5)
    solution = HHT(system, b=1.0).solve((0.0, 5.0), *start, rtol=1e-3, max_num_steps=2_000)
    assert solution.status is Status.max_steps
    assert "Constraint forces carry a vibration of" in solution.message
    assert "follow it; extrapolate_reaction=True, which damps it, takes longer ones" in solution.message
    assert HHT(system, extrapolate_reaction=True).solve((0.0, 5.0), *start, rtol=1e-3, max_num_steps=2_000).success


class Rows:
    """Steps of ``h`` [s] in which v vibrates along a direction."""

    def __init__(self, h, omega, along):
        self.h, self.omega, self.along = h, omega, along

    def last(self, count, which):
        t = self.h * np.arange(count)
        return t[:, None], 1e-3 * np.outer(np.sin(self.omega * t), self.along)


@pytest.mark.parametrize(("times", "follow"), [(1e-3, False), (0.5, True), (1.9, True), (2.1, False), (1e3, False)])
def test_extrapolated_steps_that_do_not_resolve_a_vibration_do_not_follow_it(times, follow):
    """h omega: thousands of steps in a period are those of the motion, and beyond 2 it is damped."""
    hht = hb.HHT(DoublePendulum(ratio=1e8), extrapolate_reaction=True)
    hht.init_step(0.0, *DoublePendulum.straight(0.5), rtol=1e-3)
    engine, state = hht._engine, hht.state
    omega = fastest(engine, state)
    q = state.q
    along = np.array([q[1], -q[0], 0.0, 0.0]) / np.hypot(q[0], q[1])  # the light body, across both rods
    tolerances = make_tolerances(1e-3, None, state, engine.applied(state))
    by_error = SimpleNamespace(tolerances=tolerances, options=ControlOptions())
    told = followed(engine, Rows(times / omega, omega, along), state, 1.0, by_error)
    assert ("follow it: it is part of the motion" in told) is follow
