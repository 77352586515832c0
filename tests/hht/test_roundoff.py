"""Steps in which roundoff is as large as the motion: they are not taken, or are told."""

import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb

STEPS = 10


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


@pytest.mark.parametrize("system", [Pushed(k=1e8), Driven(k=1e12, speed=0.0)], ids=["pushed", "driven"])
def test_what_rests_between_such_forces_rests(system):
    """Velocities of roundoff have no size to be measured by: they are none as long as nothing moves."""
    at = np.array([np.cos(0.3), np.sin(0.3)])
    solution = hb.HHT(system, alpha=-0.1).solve((0.0, 1e-2), at, [0.0, 0.0], steps=STEPS)
    assert solution.success, solution.message
    assert np.abs(solution.q - at).max() < 1e-8


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
