"""The benchmark bicycle: four bodies, three hinges and two wheels that roll on their edges, linearised while it rolls.

Source: J. P. Meijaard, J. M. Papadopoulos, A. Ruina, A. L. Schwab, Linearized dynamics equations for the balance and steer
of a bicycle: a benchmark and review, Proc. R. Soc. A 463 (2007) 1955-1982, table 1.  Axes as there: x ahead, y to the right,
z down, the ground at z = 0.
"""

import numpy as np

import hhtbench as hb
from hhtbench.mechanics import Mechanism, space

WHEELBASE, TRAIL, TILT = 1.02, 0.08, np.pi / 10  # [m], [m], of the steering axis [rad]
REAR, FRONT = 0.3, 0.35  # radii of the wheels [m]
HUBS = [0, 0, -REAR], [WHEELBASE, 0, -FRONT]
AXLE, UP = (0, 1, 0), (0, 0, -1)


def mechanism(speed):
    """The bicycle, upright and straight ahead at ``speed`` [m/s]."""
    m = Mechanism(gravity=(0, 0, 9.81))
    ahead = (speed, 0, 0)
    m.body("rear wheel", 2, (0.0603, 0.12, 0.0603), at=HUBS[0], velocity=ahead, rate=(0, -speed / REAR, 0))
    m.body("frame", 85, [[9.2, 0, 2.4], [0, 11, 0], [2.4, 0, 2.8]], at=(0.3, 0, -0.9), velocity=ahead)
    fork = [[0.05892, 0, -0.00756], [0, 0.06, 0], [-0.00756, 0, 0.00708]]
    m.body("fork", 4, fork, at=(0.9, 0, -0.7), velocity=ahead)
    m.body("front wheel", 3, (0.1405, 0.28, 0.1405), at=HUBS[1], velocity=ahead, rate=(0, -speed / FRONT, 0))
    m.revolute("rear hub", "frame", "rear wheel", at=HUBS[0], axis=AXLE)
    m.revolute("head", "frame", "fork", at=(WHEELBASE + TRAIL, 0, 0), axis=(np.sin(TILT), 0, np.cos(TILT)))
    m.revolute("front hub", "fork", "front wheel", at=HUBS[1], axis=AXLE)
    m.rolling("rear contact", "rear wheel", REAR, HUBS[0], axis=AXLE, point=(0, 0, 0), normal=UP)
    m.rolling("front contact", "front wheel", FRONT, HUBS[1], axis=AXLE, point=(0, 0, 0), normal=UP)
    return m


def problem(speed=5.0):
    """The bicycle over two seconds."""
    return mechanism(speed).problem((0.0, 2.0), name="bicycle")


def along(speed):
    """The velocities (28,) of rolling ahead as a function of q, wheels spinning about their axles."""
    spins = np.outer([-speed / REAR, 0, 0, -speed / FRONT], AXLE)
    return lambda q: space.carried(q, [speed, 0, 0], [0, 0, 0], spins)


def modes(speed):
    """Weave, capsize, castering, and six eigenvalues of zero."""
    bicycle = problem(speed)
    return hb.modes(bicycle, (bicycle.q0, bicycle.v0), along=along(speed))
