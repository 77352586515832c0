"""The benchmark bicycle: four bodies, three hinges, two wheels that roll on their edges, nothing linearised by hand.

Source: J. P. Meijaard, J. M. Papadopoulos, A. Ruina, A. L. Schwab, Linearized dynamics equations for the balance and steer
of a bicycle: a benchmark and review, Proc. R. Soc. A 463 (2007) 1955-1982, table 1.  Axes as there: x ahead, y to the right,
z down, the ground at z = 0.
"""

import jax.numpy as jnp
import numpy as np

import hhtbench as hb
from hhtbench.mechanics import space

REAR, FRAME, FORK, FRONT = range(4)
WHEELS = [REAR, FRONT]
RADII = np.array([0.3, 0.35])  # [m]
WHEELBASE, TRAIL, TILT = 1.02, 0.08, np.pi / 10  # [m], [m], [rad]
MASSES = np.array([2.0, 85.0, 4.0, 3.0])  # [kg]
CENTRES = np.array([[0, 0, -0.3], [0.3, 0, -0.9], [0.9, 0, -0.7], [WHEELBASE, 0, -0.35]])  # upright [m]
TENSORS = np.array(  # [kg m^2]
    [
        np.diag([0.0603, 0.12, 0.0603]),
        [[9.2, 0, 2.4], [0, 11, 0], [2.4, 0, 2.8]],
        [[0.05892, 0, -0.00756], [0, 0.06, 0], [-0.00756, 0, 0.00708]],
        np.diag([0.1405, 0.28, 0.1405]),
    ]
)
GRAVITY = np.array([0, 0, 9.81])  # [m/s^2]
FIRST, SECOND = np.array([REAR, FRAME, FRONT]), np.array([FRAME, FORK, FORK])  # rear hub, steering head, front hub
POINTS = np.array([CENTRES[REAR], [WHEELBASE + TRAIL, 0, 0], CENTRES[FRONT]])
AXES = np.array([[0, 1, 0], [np.sin(TILT), 0, np.cos(TILT)], [0, 1, 0]])
ACROSS = np.array([[[1, 0, 0], [0, 0, 1]], [[np.cos(TILT), 0, -np.sin(TILT)], [0, 1, 0]], [[1, 0, 0], [0, 0, 1]]])


class Bicycle(hb.System):
    """``q`` (28,): centre and unit quaternion of rear wheel, frame with rider, fork, front wheel; no rotation is upright."""

    def mass_matrix(self, t, q):
        return space.mass_of_bodies(q, MASSES, TENSORS, np.trace(TENSORS, axis1=1, axis2=2) / 3)

    def force(self, t, q, v):
        return space.force_on_bodies(q, v, MASSES, TENSORS, GRAVITY)

    def contacts(self, q):  # (2, 3): from a wheel's centre to the lowest point of its edge
        axle = space.rotation(space.split(q)[1][jnp.array(WHEELS)])[:, :, 1]
        down = jnp.array([0.0, 0.0, 1.0]) - axle[:, 2:] * axle
        return RADII[:, None] * down / jnp.sqrt(1 - axle[:, 2:] ** 2)

    def constraint(self, t, q):
        x, p = space.split(q)
        at = space.placed_with_ground(q)
        ends = POINTS - CENTRES[FIRST], POINTS - CENTRES[SECOND]
        hinges = space.revolute_rows(at, FIRST, SECOND, *ends, ACROSS, AXES)
        return jnp.concatenate([space.norm_rows(p), hinges, x[jnp.array(WHEELS), 2] + self.contacts(q)[:, 2]])

    def velocity_constraint(self, t, q, v):
        return space.velocity_at(q, v, WHEELS, self.contacts(q))[:, :2].ravel()

    def energy(self, t, q, v):
        return space.energy_of_bodies(q, v, MASSES, TENSORS, GRAVITY)


def rolling(speed):
    """Velocities (28,) as a function of q: straight ahead at ``speed`` [m/s]."""
    spins = np.zeros((4, 3))
    spins[WHEELS, 1] = -speed / RADII
    return lambda q: space.carried(q, jnp.array([speed, 0.0, 0.0]), jnp.zeros(3), spins)


def problem(speed=5.0):
    """Rolling upright and straight ahead."""
    q0 = np.concatenate([CENTRES, np.tile([1.0, 0, 0, 0], (4, 1))], axis=1).ravel()
    return hb.Problem(name="bicycle", system=Bicycle(), t_span=(0.0, 2.0), q0=q0, v0=rolling(speed)(q0))


def modes(speed):
    """The modes at ``speed`` [m/s]: weave, capsize, castering, and six eigenvalues of zero."""
    scene = problem(speed)
    return hb.modes(scene, (scene.q0, scene.v0), along=rolling(speed))
