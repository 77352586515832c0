"""Steps in which roundoff is as large as the motion: they are not taken, or are told."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.result import Status
from hhtbench.testing.extremes.linkages import DoublePendulum

STEPS, UNRESOLVED = 10, "steps do not resolve such forces"
FAILURES = Status.newton_failed, Status.unreliable  # the ring has no singular position


class Pushed(hb.System):
    """A bead on a ring of radius 1 that is pushed outwards, to which the ring answers: it goes round at its speed."""

    k: object = hb.parameter(1.0)

    def force(self, t, q, v):
        return self.k * q

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2.0])


class Driven(Pushed):
    """The same at a speed that is given."""

    speed: object = hb.parameter(1.0)

    def velocity_constraint(self, t, q, v):
        return jnp.stack([q[0] * v[1] - q[1] * v[0] - self.speed])


def off_velocity_level(solution):
    return float(np.abs(np.sum(solution.q * solution.v, axis=1)).max())


@pytest.mark.parametrize("system", [Pushed, Driven])
@pytest.mark.parametrize("h", [0.1, 1e-3])
@pytest.mark.parametrize("exponent", range(2, 20))
def test_forces_that_cancel_one_another_never_put_a_motion_aside_in_silence(system, h, exponent):
    """At 1e12 steps of 0.1 s left v off the ring's velocity level by 5e4, which was said to be a success."""
    end = STEPS * h
    solution = hb.HHT(system(k=10.0**exponent)).solve((0.0, end), [1.0, 0.0], [0.0, 1.0], steps=STEPS)
    if solution.success:
        assert off_velocity_level(solution) < 0.1
        error = np.abs(solution.q[-1] - [np.cos(end), np.sin(end)]).max() / end
        assert error < 0.1 or UNRESOLVED in solution.message
    else:
        assert solution.status in FAILURES, solution.message


@pytest.mark.parametrize("system", [Pushed(k=1e8), Driven(k=1e12, speed=0.0)], ids=["pushed", "driven"])
def test_what_rests_between_such_forces_rests(system):
    """Velocities of roundoff have no size to be measured by: they are none as long as nothing moves."""
    at = np.array([np.cos(0.3), np.sin(0.3)])
    solution = hb.HHT(system, alpha=-0.1).solve((0.0, 1e-2), at, [0.0, 0.0], steps=STEPS)
    assert solution.success, solution.message
    assert np.abs(solution.q - at).max() < 1e-8


@pytest.fixture(scope="module")
def strained():
    """Runs of a bead whose ring is strained; which of them end in which way differs from machine to machine."""
    pushes = np.geomspace(1e9, 1e17, 33)
    return [hb.HHT(Driven(k=k)).solve((0.0, 1.0), [1.0, 0.0], [0.0, 1.0], steps=STEPS) for k in pushes]


def test_forces_that_constraints_hold_against_are_followed_as_advised():
    """Steps of 2e-3 s in which such forces turn: the error was the motion's size, and 2e-6 with what the message names."""
    end, start = 0.5, ((1.0, 0.0), (0.0, 1.0))
    plain, extrapolated = (
        hb.HHT(Pushed(k=1e8), alpha=-0.3, extrapolate_reaction=given).solve((0.0, end), *start, steps=250)
        for given in (False, True)
    )
    errors = [np.abs(x.q[-1] - [np.cos(end), np.sin(end)]).max() for x in (plain, extrapolated)]
    assert plain.success and errors[0] > 0.1
    assert UNRESOLVED in plain.message and "extrapolate_reaction=True, which follows" in plain.message
    assert extrapolated.success and errors[1] < 1e-5 and UNRESOLVED not in extrapolated.message


def test_a_step_that_roundoff_makes_ends_the_run(strained):
    """Its increments no longer shrink since they are roundoff, as large as the ring: that was taken for convergence."""
    told = [x.message for x in strained if x.status is Status.newton_failed]
    told = [text for text in told if "roundoff moves q or v by" in text and "take a smaller step" in text]
    assert told


def test_rows_that_roundoff_has_moved_end_it_too(strained):
    """Here the iteration converges, to a place and a velocity that round otherwise when they are put together."""
    told = [x.message for x in strained if x.status is Status.unreliable]
    assert told
    assert all(text.startswith("roundoff: ") and "take smaller steps" in text for text in told)
    assert any("off the constraints" in text for text in told) and any("lost rank" in text for text in told)


def test_what_roundoff_leaves_is_told_where_it_is_more_than_a_tolerance():
    found = hb.HHT(DoublePendulum(ratio=1e10), extrapolate_reaction=True, alpha=-0.2)
    solution = found.solve((0.0, 1.0), *DoublePendulum.straight(0.5), step=0.01)
    assert solution.success, solution.message
    told = float(solution.message.split("Roundoff leaves up to ")[1].split(" of q or v")[0])
    inner, outer = np.split(solution.q, 2, axis=1), np.split(solution.v, 2, axis=1)
    off = max(
        np.abs((inner[0] * outer[0]).sum(axis=1)).max(), np.abs(((inner[1] - inner[0]) * (outer[1] - outer[0])).sum(1)).max()
    )
    assert 1e-6 < told < 1e-3 and off < 10.0 * told
    plain = hb.HHT(DoublePendulum(ratio=1e4), extrapolate_reaction=True, alpha=-0.2)
    assert "Roundoff" not in plain.solve((0.0, 1.0), *DoublePendulum.straight(0.5), step=0.01).message


class Beside(DoublePendulum):
    """The same beside a coordinate that a constraint holds far away."""

    place: float = 0.0

    def mass_matrix(self, t, q):
        links = super().mass_matrix(t, q[:4])
        return jnp.block([[links, jnp.zeros((4, 1))], [jnp.zeros((1, 4)), jnp.ones((1, 1))]])

    def force(self, t, q, v):
        return jnp.append(super().force(t, q[:4], v[:4]), 0.0)

    def constraint(self, t, q):
        return jnp.append(super().constraint(t, q[:4]), q[4] - self.place)


@pytest.mark.parametrize("place", [1.0, 1e9])
def test_so_it_is_beside_what_rests_far_away(place):
    """A coordinate that rests, however far away, hides nothing of the pendulum beside it."""
    q, v = DoublePendulum.straight(0.5)
    system = Beside(ratio=1e10, place=place)
    solution = hb.HHT(system, extrapolate_reaction=True, alpha=-0.2).solve(
        (0.0, 0.2), np.append(q, place), np.append(v, 0.0), step=0.01
    )
    assert solution.success and np.ptp(solution.q[:, :4], axis=0).max() > 0.05
    assert "Roundoff leaves up to" in solution.message


class Line(hb.System):
    """A light bead and a heavy one on rods in line; friction on the light one by the sizes of both tensions."""

    @property
    def mass_matrix(self):
        return jnp.array([1e-4, 1e-4, 1e8, 1e8])

    def force(self, t, q, v):
        return jnp.zeros(4)

    def constraint(self, t, q):
        rod = q[2:] - q[:2]
        return jnp.stack([(q[:2] @ q[:2] - 1.0) / 2.0, (rod @ rod - 1.0) / 2.0])

    def reaction(self, t, q, v, lam):
        rod = q[2:] - q[:2]
        friction = 0.3 * jnp.abs(lam).sum() * jnp.tanh(v[:2])
        return jnp.concatenate([-lam[0] * q[:2] + lam[1] * rod - friction, -lam[1] * rod])


def test_steps_so_short_that_multipliers_are_roundoff_are_not_taken_where_friction_feels_it():
    solution = hb.HHT(Line()).solve((0.0, 5e-9), [1.0, 0.0, 2.0, 0.0], [0.0, 1.9, 0.0, 0.9], steps=5)
    assert solution.status is Status.time_resolution
    assert (
        "roundoff moves q or v by" in solution.message and 'take a larger step, or reaction="midpoint"' in solution.message
    )


@pytest.mark.parametrize("options", [{}, {"b": 1.0}], ids=str)
@pytest.mark.parametrize("rtol", [1e-3, 1e-5])
@pytest.mark.parametrize("exponent", [6, 10, 14, 15, 16])
def test_nor_do_they_under_error_control(exponent, rtol, options):
    """At 1e14 the bead stayed in its place, or went round at 6430 m/s: both were said to be a success."""
    solver = hb.HHT(Pushed(k=10.0**exponent), **options)
    solution = solver.solve((0.0, 1.0), [1.0, 0.0], [0.0, 1.0], rtol=rtol, max_num_steps=20_000)
    if solution.success:
        error = np.abs(solution.q[-1] - [np.cos(1.0), np.sin(1.0)]).max()
        assert error < 200 * rtol or UNRESOLVED in solution.message


class Truss(hb.System):
    """Two rods that hold a load, at rest."""

    load: object = hb.parameter(1.0)
    frequency: object = hb.parameter(0.0)

    def force(self, t, q, v):
        load = self.load * jnp.cos(self.frequency * (t - 0.5))
        return jnp.stack([load, -load])

    def constraint(self, t, q):
        rod = q - jnp.array([2.0, 0.0])
        return jnp.stack([(q @ q - 1.01) / 2.0, (rod @ rod - 1.01) / 2.0])


@pytest.mark.parametrize("load", [1e3, 1e5, 1e7])
@pytest.mark.parametrize("steps", [10, 20, 100])
def test_a_structure_that_rests_under_a_load_is_no_motion_that_roundoff_moves(load, steps):
    solution = hb.HHT(Truss(load=load)).solve((0.0, 1.0), [1.0, 0.1], [0.0, 0.0], steps=steps)
    assert solution.success, solution.message
    assert np.abs(solution.q - [1.0, 0.1]).max() < 1e-9


@pytest.mark.parametrize("options", [{}, {"extrapolate_reaction": True}], ids=str)
@pytest.mark.parametrize("steps", [100, 1000])
@pytest.mark.parametrize("load", [1e-6, 1.0, 1e4])
def test_nor_is_one_under_a_load_that_changes(load, steps, options):
    """Extrapolated multipliers leave nothing of the load in f: there was no size that increments are small beside."""
    plain = hb.NumpySystem(
        force=lambda t, q, v: load * np.cos(np.pi * (t - 0.5)) * np.array([1.0, -1.0]),
        constraint=lambda t, q: np.array([q @ q - 1.01, (q - [2.0, 0.0]) @ (q - [2.0, 0.0]) - 1.01]) / 2.0,
    )
    for made in (Truss(load=load, frequency=np.pi), plain):
        solution = hb.HHT(made, alpha=-0.3, **options).solve((0.0, 1.0), [1.0, 0.1], [0.0, 0.0], steps=steps)
        assert solution.success, solution.message
        assert np.abs(solution.q - [1.0, 0.1]).max() < 1e-12 and "Roundoff" not in solution.message


@pytest.mark.parametrize("request_", [{"rtol": 1e-4}, {"steps": 10}], ids=str)
def test_what_is_held_in_the_origin_has_no_size_to_be_off_by(request_):
    held = hb.NumpySystem(
        force=lambda t, q, v: np.array([3.0, -9.81]), constraint=lambda t, q: np.array([q[0], q[1], q[0] + q[1]])
    )
    solution = hb.HHT(held).solve((0.0, 1.0), [0.0, 0.0], [0.0, 0.0], **request_)
    assert solution.success, solution.message


@pytest.mark.parametrize(("g", "end"), [(1e160, 1.0), (1e200, 1.0), (1e300, 1.0), (1.0, 1e105)])
def test_numbers_that_overflow_when_they_are_squared_end_in_no_exception(g, end):
    weight = hb.NumpySystem(force=lambda t, q, v: np.array([0.0, -g]), constraint=lambda t, q: np.array([q @ q - 1.0]))
    assert hb.HHT(weight).solve((0.0, end), [0.0, -1.0], [0.0, 0.0], steps=10).success


class Rough(Pushed):
    """With a friction that is next to nothing: the reaction is not linear in the multiplier."""

    def reaction(self, t, q, v, lam):
        return -q * lam[0] - 1e-31 * jnp.abs(lam[0]) * v


def test_steps_that_are_long_are_not_said_to_be_too_short():
    solution = hb.HHT(Rough(k=1e17)).solve((0.0, 1.0), [1.0, 0.0], [0.0, 1.0], steps=STEPS)
    assert not solution.success
    assert "larger step" not in solution.message and "so short" not in solution.message
