"""A body that turns freely, in quaternions of any length, whose constraint is multiplied by any number."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

from hhtbench.conformance.cell import Cell, Expected, cells, family, rtol, step
from hhtbench.conformance.families.errors import held, reacting
from hhtbench.conformance.scenes.scene import on_motion
from hhtbench.conformance.subject import ACCURACY
from hhtbench.mechanics.space import quaternion_rate, rotation, rotational_force, rotational_mass
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter

SPAN = 5.0  # [s], two turns of the axis
MOMENTS = np.array([1.0, 1.0, 2.0])  # about the body's axes [kg m^2]
ALONG = 1.0  # inertia along the quaternion [kg m^2]: its multiplier alone depends on it
START = np.array([1.0, -1.0, 1.0, 1.0]) / 2  # attitude
RATE = np.array([0.6, 0.0, 1.2])  # at the start, in the body's frame [rad/s]
CURVATURE = 10.0  # error over h^2 of a method of second order [1/s^2]
LEVELS = 1e-12  # violation of both levels with prescribed steps


class Turning(System):
    """A freely rotating body, ``q`` (4,) a quaternion of length ``length`` whose norm constraint is multiplied by
    ``scale``.
    """

    length: Any = parameter(1.0, doc="of the quaternion")
    scale: Any = parameter(1.0, doc="of the row of the constraint")

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Mass matrix: (4, 4): moments over length^4, since rates are 2 G q' / length^2."""
        return rotational_mass(q, MOMENTS / self.length**4, ALONG / self.length**4)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: no moment but the terms quadratic in q'."""
        return rotational_force(q, v, MOMENTS / self.length**4)

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: the length."""
        return self.scale * (q @ q - self.length**2)[None]


def turning(length: float, scale: float) -> Problem:
    """Problem of a free symmetric body that precesses about its momentum with |L| / A and spins with (1 - C / A) w3.

    Along q the equations are 2 scale length^2 lam = 2 w.J w + ALONG |w|^2, w the rates in the body's frame.
    """
    momentum = np.asarray(rotation(START)) @ (MOMENTS * RATE)
    about, own = momentum / MOMENTS[0], RATE[2] * (1.0 - MOMENTS[2] / MOMENTS[0])
    lam = (2.0 * RATE @ (MOMENTS * RATE) + ALONG * RATE @ RATE) / (2.0 * scale * length**2)

    def exact(t: float) -> Motion:
        q = _product(_product(_turn(about, t), START), _turn(np.array([0.0, 0.0, own]), t))
        rate = about + np.asarray(rotation(q))[:, 2] * own
        return Motion(length * q, length * np.asarray(quaternion_rate(q, rate)), np.array([lam]), np.zeros(0))

    scales = Scales(q=length, v=length * float(np.linalg.norm(RATE)) / 2, lam=lam)
    return on_motion("turning", Turning(length=length, scale=scale), exact, SPAN, scales)


def _turn(rate: Vector, t: float) -> Vector:
    """Quaternion (4,) of the rotation by ``rate`` (3,) [rad/s] in ``t`` [s]."""
    speed = float(np.linalg.norm(rate))
    return np.concatenate([[np.cos(speed * t / 2)], np.sin(speed * t / 2) * rate / speed])


def _product(a: Vector, b: Vector) -> Vector:
    """Product of two quaternions (4,), scalar first: rotation ``b`` followed by ``a``."""
    return np.concatenate([[a[0] * b[0] - a[1:] @ b[1:]], a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:])])


def _levels(length: float, t: float, q: Vector, v: Vector) -> Vector:
    """Violations of both constraint levels, divided by their sizes."""
    return np.array([q @ q / length**2 - 1.0, 2.0 * (q @ v) / length**2])


@family("quaternions", "factor of the constraint's row, or length of the quaternion")
def quaternions(seed: int) -> Iterator[Cell]:
    """A turning body whose constraint or quaternion is scaled: the same motion, both levels and the reaction, closed."""
    for power in range(-6, 7, 2):
        for name, length, scale in (("row", 1.0, 10.0**power), ("length", 10.0**power, 1.0)):
            for way, level in ((rtol(1e-5), ACCURACY * 1e-5), (step(1e-2, CURVATURE * 1e-4), LEVELS)):
                levels = {"both levels": Expected(error=held(partial(_levels, length)), most=level)}
                make, expected = partial(turning, length, scale), reacting(way.most) | levels
                yield from cells(10.0**power, make, [way], expected, named=f"{name}, {{}}", small=power == -6)
