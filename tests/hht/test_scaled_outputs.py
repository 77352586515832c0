"""Constraints are measured by what they are made of: long links, displacements from rest, fast motion."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hhtbench as hb
from hhtbench.protocol import Problem, System
from hhtbench.result import Status
from solvers.hht import HHT, Event

AMPLITUDES = (1e-2, 1e-3, 1e-4)


class Links(System):
    """Two links [mm]."""

    length: float

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81, 0.0, -9.81])

    def constraint(self, t, q):
        first, second = q[:2], q[2:] - q[:2]
        return jnp.stack([first @ first - self.length**2, second @ second - self.length**2])


class Displaced(System):
    """A rod of length one; q is the displacement of its end from hanging: g holds constants far larger than the motion."""

    def force(self, t, q, v):
        return jnp.array([0.0, -9.81])

    def constraint(self, t, q):
        return jnp.stack([q[0] ** 2 + (q[1] - 1.0) ** 2 - 1.0])


@pytest.mark.parametrize("engine", ["compiled", "python"])
def test_projected_methods_take_states_far_larger_than_the_scales(engine):
    """Roundoff of g_q v was taken for a projection that fails: scales are 1, the speeds 9e4."""
    links = Problem(name="links", system=Links(1e3), t_span=(0.0, 1.0), q0=[1e3, 0.0, 2e3, 0.0], v0=[0.0, 3e4, 0.0, 9e4])
    found = hb.solve(links, f"projected(method=DOP853, engine={engine})", rtol=1e-6)
    assert found.success
    assert np.abs(jax.vmap(links.system.constraint)(found.t, found.q)).max() < 1e-12 * 4e6


@pytest.mark.parametrize("amplitude", AMPLITUDES)
def test_rows_and_events_of_displacements_from_rest_are_on_the_constraints(amplitude):
    """They were called off the constraints, which only roundoff of g was."""
    a = amplitude
    start = [a, a * a / (1.0 + np.sqrt(1.0 - a * a))]
    hht = HHT(Displaced(), events=[Event(lambda t, q, v: q[0] - 0.3 * a)])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = hht.solve((0.0, 3.0), start, [0.0, 0.0], rtol=1e-3, t_eval=np.linspace(0.0, 3.0, 50))
        dense = found(np.linspace(0.0, 3.0, 77), project=True)
    assert found.status is Status.success
    assert "constraints" not in found.message
    for q in (found.q, found.q_events[0], dense.q):
        assert np.abs(q[:, 0] ** 2 + (q[:, 1] - 1.0) ** 2 - 1.0).max() < 2e-15


@pytest.mark.parametrize("shape", [(), (0,), (3,), (2, 2)])
@pytest.mark.parametrize("solver", ["hht", "scipy(method=DOP853)"])
def test_dense_output_takes_times_of_any_shape(solver, shape):
    problem = hb.load_problem("simple_pendulum")
    found = hb.solve(problem, solver, rtol=1e-4, dense_output=True)
    for project in (False, True):
        assert found(np.full(shape, 0.5), project=project).q.shape == (*shape, 2)
