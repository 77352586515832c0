"""Causes of failed runs, and warnings of prescribed steps, on scenes whose frequency or noise is known."""

from __future__ import annotations

import math

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.conformance.scenes.linkages import DoublePendulum
from hhtbench.solution.counting import Work
from hhtbench.solution.result import Status
from solvers._start import PhasePoint
from solvers.hht.options import make_options
from solvers.hht.run.causes import alternating_vibration, fastest, unresolved_forces
from solvers.hht.run.start import make_engine


def engine_of(system: hb.System | hb.NumpySystem, q: list[float], v: list[float]) -> tuple[object, PhasePoint]:
    place = PhasePoint(0.0, np.array(q), np.array(v))
    return make_engine(system, make_options(), place, Work(), controlled=True), place


def test_a_spring_between_two_bodies_vibrates_at_the_root_of_stiffness_over_reduced_mass():
    spring = hb.NumpySystem(mass_matrix=[2.0, 6.0], force=lambda t, q, v: 3e4 * (q[1] - q[0] - 1.0) * np.array([1.0, -1.0]))
    omega, by_reactions = fastest(*engine_of(spring, [0.0, 1.0], [1.0, 1.0]))  # type: ignore[arg-type]
    assert omega == pytest.approx(math.sqrt(3e4 * (1 / 2 + 1 / 6)), rel=1e-3)
    assert by_reactions == 0.0


def test_a_turning_pendulum_is_carried_by_its_rod_with_the_rate_of_the_turn():
    """The tension m v^2 / l of a rod without gravity gives the tangential stiffness m v^2 / l^2."""
    rod = hb.NumpySystem(
        mass_matrix=[2.0, 2.0],
        force=lambda t, q, v: np.zeros(2),
        constraint=lambda t, q: np.array([q @ q - 4.0]),
    )
    omega, by_reactions = fastest(*engine_of(rod, [2.0, 0.0], [0.0, 6.0]))  # type: ignore[arg-type]
    assert omega == pytest.approx(3.0, rel=1e-3)
    assert by_reactions == pytest.approx(1.0, rel=1e-6)


def test_a_noisy_force_is_named_on_request_where_the_callers_budget_has_ended_the_run():
    draw = np.random.default_rng(3)
    noisy = hb.NumpySystem(force=lambda t, q, v: np.full(1, -9.81 * (1.0 + 1e-5 * draw.standard_normal())))
    found = hb.HHT(noisy).solve((0.0, 1.0), [1.0], [0.0], rtol=1e-8, max_num_steps=1_000)
    assert found.status is Status.max_steps
    assert "Calls of force with the same arguments differ" in found.diagnose()
    assert "Calls of force" not in found.message  # what the caller limits is no failure of the method


def test_a_success_has_no_cause():
    fall = hb.NumpySystem(force=lambda t, q, v: np.full(1, -9.81))
    found = hb.HHT(fall).solve((0.0, 1.0), [1.0], [0.0], step=0.01)
    assert (found.diagnose(), "Warning" in found.message) == ("", False)


def test_prescribed_steps_too_long_for_a_taut_rod_are_diagnosed_on_request():
    start = DoublePendulum.straight(0.5)
    found = hb.HHT(DoublePendulum(ratio=1e6)).solve((0.0, 1.0), *start, step=1e-3)
    assert not found.success
    assert "Constraint forces carry a vibration" in found.diagnose()


def test_contact_that_one_step_jumps_over_is_a_warning():
    floor = hb.NumpySystem(force=lambda t, q, v: -9.81 + 1e8 * np.maximum(-q, 0.0))
    coarse, fine = (hb.HHT(floor).solve((0.0, 1.0), [1.0], [0.0], step=h) for h in (1e-2, 1e-5))
    assert "do not resolve the forces" in coarse.message
    assert "do not resolve the forces" not in fine.message


class Wall(hb.System):
    """A bead on a rod between a stiff wall and a flywheel, which feels nothing of it."""

    def force(self, t, q, v):  # type: ignore[no-untyped-def]
        return jnp.stack([-1e6 * jnp.maximum(q[0] - 1.0, 0.0), 0.0, -1.0])

    def constraint(self, t, q):  # type: ignore[no-untyped-def]
        return q[2:]


@pytest.mark.parametrize("wheel", [0.0, 1e3])
def test_a_contact_is_found_beside_a_fast_coordinate(wheel: float):
    """The contact lasts pi ms: steps of 10 ms leave the bead more than 0.1 m from where it bounces to."""
    coarse = hb.HHT(Wall()).solve((0.0, 2.0), [0.0, 0.0, 0.0], [1.0, wheel, 0.0], step=0.0103)
    assert coarse.success
    assert abs(coarse.q[-1, 0] - np.pi * 1e-3) > 0.1
    assert "forces change v[0]" in coarse.message


@pytest.mark.parametrize("load", [1e4, 1e6])
def test_loads_that_constraints_hold_are_no_warning(load: float):
    """A point on a circle, pulled outwards by a load that changes in every step: nothing of it is free."""
    ring = hb.NumpySystem(force=lambda t, q, v: load * np.sin(40.0 * t) * q, constraint=lambda t, q: np.array([q @ q - 1.0]))
    found = hb.HHT(ring).solve((0.0, 1.0), [1.0, 0.0], [0.0, 1.0], steps=1000)
    assert found.success
    assert "do not resolve" not in found.message


@pytest.mark.parametrize("speed", [1.0, 1e-9], ids=["moving", "nearly at rest"])
def test_a_smooth_motion_has_no_warning(speed: float):
    t, h = np.linspace(0.0, 1.0, 101), np.full(101, 0.01)
    q, v, a = np.sin(6.0 * t)[None], speed * np.cos(6.0 * t)[None], -6.0 * speed * np.sin(6.0 * t)[None]
    assert (unresolved_forces(t, h, q, v, a), *alternating_vibration(h, q, v)) == ("", "", False)


@pytest.mark.parametrize("lag", [1, 2])
def test_a_vibration_that_alternates_and_grows_is_found(lag: int):
    k = np.arange(60)
    signs = (-1.0) ** (k // lag)
    v, decaying = (1.0 + 1e-9 * signs * 1.5**k)[None], (1.0 + signs * 1.5 ** (-1.0 * k))[None]
    assert alternating_vibration(np.full(60, 0.01), v, v)[1]
    assert alternating_vibration(np.full(60, 0.01), decaying, decaying) == ("", False)


@pytest.mark.parametrize("kink", [1, 2])
def test_a_kink_behind_roundoff_that_alternates_is_no_vibration_that_has_grown(kink: int):
    """The acceleration of a step across a kink is followed by its opposite."""
    k = np.arange(60)
    v = (1.0 + 1e-13 * (-1.0) ** k)[None]
    v[0, 30:] += 1e-3
    v[0, 30 : 30 + kink] += 1e-3
    assert not alternating_vibration(np.full(60, 0.01), v, v)[1]


@pytest.mark.parametrize("damper", [0.0, 1e5])
def test_a_stiff_spring_that_steps_of_the_trapezoidal_rule_turn_over_is_warned_of(damper: float):
    """At alpha = 0 steps far beyond the period of 6e-4 s keep the amplitude, and turn it over every time."""
    spring = hb.NumpySystem(force=lambda t, q, v: -1e8 * q - damper * v)
    found = hb.HHT(spring, alpha=0.0).solve((0.0, 1.0), [1.0], [0.0], step=0.01)
    assert found.success
    assert "the steps do not resolve" in found.message
