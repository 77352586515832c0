"""Forces that steps do not resolve are told, whatever else moves and in any frame; those that constraints hold are not."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from solvers.hht.run import history
from tests.fuzz import second
from tests.fuzz.oracles import number

UNRESOLVED = "steps do not resolve such forces"
ACROSS, ALONG = np.array([1.0, 1.0]) / np.sqrt(2.0), np.array([1.0, -1.0]) / np.sqrt(2.0)


def free(force):
    return hb.NumpySystem(force=force)


class Wall(hb.System):
    """A bead on a rod between a stiff wall and a flywheel, which feels nothing of it."""

    def force(self, t, q, v):
        return jnp.stack([-1e6 * jnp.maximum(q[0] - 1.0, 0.0), 0.0, -1.0])

    def constraint(self, t, q):
        return q[2:]


@pytest.mark.parametrize("options", [{}, {"alpha": -0.3}, {"extrapolate_reaction": True}], ids=str)
@pytest.mark.parametrize("wheel", [0.0, 1e3])
def test_a_contact_that_steps_jump_into_is_told_whatever_else_moves(options, wheel):
    solver, start = hb.HHT(Wall(), **options), ([0.0, 0.0, 0.0], [1.0, wheel, 0.0])
    long, short = solver.solve((0.0, 2.0), *start, step=0.0103), solver.solve((0.0, 2.0), *start, step=1e-4)
    assert number(second.UNRESOLVED, long) > 1.0  # as the fuzzing reads it
    assert long.success and abs(long.q[-1, 0] - np.pi * 1e-3) > 0.1
    assert f" and v[0] is 1 at most near it: {UNRESOLVED}" in long.message
    assert short.success and UNRESOLVED not in short.message


@pytest.mark.parametrize(("h", "told"), [(0.0103, True), (1e-4, False)])
@pytest.mark.parametrize("angle", [0.0, 0.3, 0.785, 2.0])
def test_a_contact_is_told_in_any_frame(angle, h, told):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    across, along = turn
    wall = free(lambda t, q, v: -1e6 * max(q @ across - 1.0, 0.0) * across)
    solution = hb.HHT(wall).solve((0.0, 4.0), [0.0, 0.0], across + 2.0 * along, step=h)
    assert (UNRESOLVED in solution.message) == told == (abs(solution.v[-1] @ across + 1.0) > 0.1)


@pytest.mark.parametrize(("h", "told"), [(0.0101, True), (1e-4, False)])
def test_so_is_a_slow_one_after_a_fast_beginning(h, told):
    force = free(lambda t, q, v: np.array([(-5.0 * (v[0] - 1.0) if t < 2.0 else 0.0) - 1e6 * max(q[0] - 23.0, 0.0)]))
    solution = hb.HHT(force).solve((0.0, 6.0), [0.0], [100.0], step=h)
    assert (UNRESOLVED in solution.message) == told == (abs(solution.v[-1, 0] + 1.0) > 0.1)


@pytest.mark.parametrize("alpha", [0.0, -0.3])
@pytest.mark.parametrize("k", [2e4, 1e6, 1e8])
def test_a_strained_ring_is_told_beside_something_that_falls(k, alpha):
    ring = hb.NumpySystem(
        force=lambda t, q, v: np.array([k * q[0], k * q[1], -9.81]), constraint=lambda t, q: np.array([q[:2] @ q[:2] - 1.0])
    )
    solution = hb.HHT(ring, alpha=alpha).solve((0.0, 1.0), [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], steps=100)
    assert abs(solution.q[-1, 0] - np.cos(1.0)) > 0.1 and UNRESOLVED in solution.message


@pytest.mark.parametrize("options", [{}, {"alpha": -0.3, "extrapolate_reaction": True}], ids=str)
@pytest.mark.parametrize("request_", [{"steps": 100}, {"steps": 1000}, {"rtol": 1e-5}], ids=str)
@pytest.mark.parametrize("load", [1e4, 1e6])
def test_loads_that_constraints_hold_are_not_told(load, request_, options):
    """However they change: nothing of them is free."""
    rail = hb.NumpySystem(
        force=lambda t, q, v: np.array([-q[0], load * np.sin(5.0 * t)]), constraint=lambda t, q: np.array([q[1]])
    )
    guided = hb.NumpySystem(
        force=lambda t, q, v: np.array([load * np.cos(3.0 * t)]), constraint=lambda t, q: np.array([q[0] - np.sin(t)])
    )
    along = hb.HHT(rail, **options).solve((0.0, 10.0), [1.0, 0.0], [0.0, 0.0], **request_)
    assert abs(along.q[-1, 0] - np.cos(10.0)) < 0.01 and UNRESOLVED not in along.message
    led = hb.HHT(guided, **options).solve((0.0, 10.0), [0.0], [1.0], **request_)
    assert abs(led.q[-1, 0] - np.sin(10.0)) < 1e-12 and UNRESOLVED not in led.message


def test_what_rows_that_are_not_kept_have_told_is_not_lost(monkeypatch):
    monkeypatch.setattr(history, "KEPT", 10_000)
    wall = hb.HHT(free(lambda t, q, v: -1e10 * np.maximum(q - 0.05, 0.0)))
    every, some = (wall.solve((0.0, 1.0), [0.0], [1.0], step=1 / 9011, t_eval=times) for times in (None, [0.0, 1.0]))
    assert every.message == some.message and UNRESOLVED in some.message


@pytest.mark.parametrize(("g", "end"), [(1e300, 1e10), (1e308, 1.0)])
def test_forces_at_the_end_of_all_numbers_raise_no_warning(g, end, recwarn):
    weight = hb.NumpySystem(force=lambda t, q, v: np.array([0.0, -g]), constraint=lambda t, q: np.array([q @ q - 1.0]))
    hb.HHT(weight).solve((0.0, end), [0.0, -1.0], [0.0, 0.0], steps=10)
    assert not [x for x in recwarn if issubclass(x.category, RuntimeWarning)]


@pytest.mark.parametrize("amplitude", [0.0, 1e-3, 1.0])
def test_a_load_that_constraints_hold_does_not_hide_a_contact(amplitude):
    """It changes in every step beside a velocity of zero, the contact in one: that one was not looked at."""
    held = lambda t, q, v: np.array([-1e6 * max(q[0] - 1.0, 0.0), 0.0, -1.0 - amplitude * np.sin(5.0 * t)])  # noqa: E731
    wall = hb.NumpySystem(force=held, constraint=lambda t, q: q[2:])
    solution = hb.HHT(wall).solve((0.0, 20.0), [0.0] * 3, [1.0, 0.0, 0.0], step=0.0103)
    assert abs(solution.v[-1, 0] + 1.0) > 1.0 and "what moves v[0]" in solution.message and UNRESOLVED in solution.message


@pytest.mark.parametrize("request_", [{"steps": 1000}, {"rtol": 1e-5}], ids=str)
@pytest.mark.parametrize("load", [10.0, 100.0, 1000.0])
def test_loads_that_velocity_constraints_hold_are_not_told(load, request_):
    held = lambda t, q, v: np.array([-q[0], load * np.sin(5.0 * t)])  # noqa: E731
    guided = hb.NumpySystem(force=held, velocity_constraint=lambda t, q, v: v[1:])
    solution = hb.HHT(guided).solve((0.0, 10.0), [1.0, 0.0], [0.0, 0.0], **request_)
    assert np.abs(solution.q[:, 1]).max() < 1e-4 and UNRESOLVED not in solution.message


def test_extrapolated_multipliers_are_not_advised_for_springs():
    spring = lambda t, q, v: np.array([0.0, -9.81, -1e8 * q[2]])  # noqa: E731
    beside = hb.NumpySystem(force=spring, constraint=lambda t, q: np.array([(q[:2] @ q[:2] - 1.0) / 2.0]))
    solution = hb.HHT(beside, alpha=-0.05).solve((0.0, 2.0), [1.0, 0.0, 1e-3], [0.0] * 3, step=0.01)
    assert "what moves v[2]" in solution.message and "extrapolate_reaction" not in solution.message


@pytest.mark.parametrize("place", [0.0, 1e3, 1e6])
@pytest.mark.parametrize("h", [0.1, 0.01])
def test_a_strained_ring_is_told_beside_a_coordinate_of_any_size(h, place):
    ring = hb.NumpySystem(
        force=lambda t, q, v: np.array([1e8 * q[0], 1e8 * q[1], 0.0]),
        constraint=lambda t, q: np.array([(q[:2] @ q[:2] - 1.0) / 2.0, q[2] - place]),
    )
    solution = hb.HHT(ring).solve((0.0, 0.5), [1.0, 0.0, place], [0.0, 1e-3, 0.0], step=h)
    assert abs(solution.q[-1, 1] - 5e-4) > 4e-4 and UNRESOLVED in solution.message


@pytest.mark.parametrize("wheel", [0.0, 1e3])
def test_error_control_that_does_not_resolve_a_strained_ring_is_told_beside_a_fast_wheel(wheel):
    """By coordinate: nothing changes beside the speed of the wheel."""
    ring = hb.NumpySystem(
        force=lambda t, q, v: 1e4 * np.array([q[0], q[1], 0.0]), constraint=lambda t, q: np.array([q[:2] @ q[:2] - 1.0])
    )
    solution = hb.HHT(ring).solve((0.0, 1.0), [1.0, 0.0, 0.0], [0.0, 1.0, wheel], rtol=1e-2)
    assert abs(solution.q[-1, 0] - np.cos(1.0)) > 0.1 and UNRESOLVED in solution.message
