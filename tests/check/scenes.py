"""Clean problems for the check, and the faults that are put into them."""

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import NumpySystem, System, parameter

# A bead on a moving parabola y = x^2 / 2 + sin(t) / 10, with a force that is not symmetric in q and v.
Q0, V0 = np.array([1.0, 0.5]), np.array([2.0, 2.1])


def bead():
    """Every function and derivative of the bead, on NumPy arrays; n = 2, m = 1."""
    return {
        "mass_matrix": lambda t, q: np.array([[2.0 + q[1] ** 2, 0.1], [0.1, 3.0]]),
        "force": lambda t, q, v: np.array([-q[0] + 3 * q[1] ** 2 - 0.5 * v[1], -9.81 - 0.2 * q[0] * v[0] + 0.3 * v[1]]),
        "constraint": lambda t, q: np.array([q[0] ** 2 / 2 - q[1] + np.sin(t) / 10]),
        "reaction": lambda t, q, lam: np.array([-q[0] * lam[0] - 0.1 * lam[0] ** 2, lam[0] * (1 + 0.2 * q[1])]),
        "energy": lambda t, q, v: 7.0,
        "invariants": lambda t, q, v: {"none": 1.0},
        "force_jacobians": lambda t, q, v: (
            np.array([[-1.0, 6 * q[1]], [-0.2 * v[0], 0.0]]),
            np.array([[0.0, -0.5], [-0.2 * q[0], 0.3]]),
        ),
        "constraint_jacobian": lambda t, q: np.array([[q[0], -1.0]]),
        "constraint_time_derivative": lambda t, q: np.array([np.cos(t) / 10]),
        "constraint_acceleration": lambda t, q, v: np.array([v[0] ** 2 - np.sin(t) / 10]),
        "reaction_jacobians": lambda t, q, lam: (
            np.array([[-lam[0], 0.0], [0.0, 0.2 * lam[0]]]),
            np.array([[-q[0] - 0.2 * lam[0]], [1 + 0.2 * q[1]]]),
        ),
    }


def skate():
    """A skate with a velocity constraint nonlinear in v and its declared Jacobian; n = 3, p = 1."""
    return {
        "force": lambda t, q, v: np.array([1.0, -v[1], -0.1 * v[2]]),
        "velocity_constraint": lambda t, q, v: np.array([v[0] * np.sin(q[2]) - v[1] * np.cos(q[2]) + 0.1 * v[2] ** 2]),
        "velocity_constraint_jacobian": lambda t, q, v: np.array([[np.sin(q[2]), -np.cos(q[2]), 0.2 * v[2]]]),
    }


def problem(functions, q0=Q0, v0=V0, **more):
    return Problem(name="made", system=NumpySystem(**functions), t_span=(0.0, 1.0), q0=q0, v0=v0, **more)


def bead_problem(**changes):
    return problem(bead() | changes, lam_guess=[-3.0])


def skate_problem(**changes):
    return problem(skate() | changes, q0=np.zeros(3), v0=np.array([1.0, 0.4, 2.0]))


class Bead(System):
    """The bead in jax.numpy, with the Jacobian of its constraint declared and, perhaps, wrong."""

    size: Array = parameter(1.0, doc="half width of the parabola [m]")
    fault: Array = parameter(0.0, doc="added to one entry of the declared Jacobian")

    def force(self, t, q, v):
        return jnp.stack([-q[0] + 3 * q[1] ** 2 - 0.5 * v[1], -9.81 - 0.2 * q[0] * v[0]])

    def constraint(self, t, q):
        return jnp.stack([q[0] ** 2 / (2 * self.size) - q[1] + jnp.sin(t) / 10])

    def constraint_jacobian(self, t, q):
        return jnp.stack([jnp.stack([q[0] / self.size + self.fault, -jnp.ones_like(q[1])])])


def jax_bead(system=None, **more):
    return Problem(name="bead", system=system or Bead(), t_span=(0.0, 1.0), q0=Q0, v0=V0, **more)


class Fall(System):
    """A free fall: n = 2, nothing else."""

    def force(self, t, q, v):
        return jnp.stack([0.0 * v[0], -9.81 + 0.0 * v[1]])


def fall(**more):
    """With everything a problem may say."""
    q0, v0 = np.array([0.0, 2.0]), np.array([1.0, 0.0])

    def exact(t):
        return Motion(np.array([t, 2 - 9.81 * t**2 / 2]), np.array([1.0, -9.81 * t]), np.zeros(0), np.zeros(0))

    said = {
        "system": Fall(),
        "exact": exact,
        "reference": {"t": np.array([0.0, 1.0]), "q": np.array([q0, q0]), "v": np.array([v0, v0]), "digits": 12},
        "observables": {"height": lambda t, q, v, lam: q[1]},
        "scales": Scales(q=np.array([1.0, 2.0]), v=10.0),
    }
    return Problem(name="fall", t_span=(0.0, 1.0), q0=q0, v0=v0, **(said | more))


def row(evidence, row_id):
    found = {r.id: r for r in evidence.rows}
    assert row_id in found, sorted(found)
    return found[row_id]


def failed(evidence):
    return [r.id for r in evidence.rows if r.passed is False]
