"""Which vibration has made steps under error control many is told where the last steps show it, and only there."""

import re

import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol import NumpySystem
from hhtbench.result import Status
from hhtbench.testing.extremes.linkages import DoublePendulum
from solvers.hht import HHT
from solvers.hht.control.tolerances import make_tolerances
from solvers.hht.run.followed import followed
from solvers.hht.run.pace import CROWDED
from solvers.hht.run.tension import fastest

STRETCHED = "Forces carry a vibration of"


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
    solution = HHT(system).solve((0.0, 2.0), [0.0, -1.0, 0.0], [1.0, 0.0, 1.0], rtol=1e-6, max_num_steps=2_000)
    told = re.search(rf"{STRETCHED} (\S+) rad/s", solution.message)
    assert told, solution.message
    assert float(told[1]) == pytest.approx(np.sqrt(k * (1.0 / light + 1.0)), rel=0.02)  # 1.005 of the light one's own


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
        return t[:, None], np.outer(np.sin(self.omega * t), self.along)


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
    told = followed(engine, Rows(times / omega, omega, along), state, 1.0, tolerances)
    assert ("follow it: it is part of the motion" in told) is follow
