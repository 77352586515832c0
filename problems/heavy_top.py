r"""A heavy top that spins fast about its axis, its tip held by a position constraint, with centre and unit quaternion.

Source: M. Geradin, A. Cardona, Flexible Multibody Dynamics: A Finite Element Approach, Wiley 2001 (data of the top)::

        z |      ___ X, centre of mass        q = (x, y, z, p0, p1, p2, p3): centre [m], quaternion, scalar first
          |    ,'/  \                         J = diag(A, C, A) about the centre, axis of symmetry: second of the body
          |  ,' /    \  spin
          |,'   \    /                        0 = p.p - 1          lam[0]
        O *------\__/--> y                    0 = x - R(p) X       lam[1:4] = force of the tip on the ground [N],
         /|                                                        X = (0, l, 0)
        x | g

The weight turns the axis about z, and the axis nods on its way.  Moments about the axis of symmetry are zero: the spin,
the second body rate, is constant, and so are energy and moment of momentum about z.  ``lam[0]`` depends on j0 (see
``hhtbench/mechanics/space.py``), motion and ``lam[1:4]`` do not.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import chain
from hhtbench.mechanics.space import body_rate, norm_rows, quaternion_rate, rotation, rotational_force, rotational_mass
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.system import Problem, Scales, System, parameter
from problems._common import checked, load_reference

SOURCE = "Geradin and Cardona, Flexible Multibody Dynamics, Wiley 2001 (heavy top)"
PUBLISHED = {"m": 15.0, "l": 1.0, "A": 0.234375, "C": 0.46875, "g": 9.81, "spin": 150.0, "turn": -4.61538}


class HeavyTop(System):
    """``q`` (7,): centre and unit quaternion; norm and three rows of the tip."""

    m: Array = parameter(15.0, doc="mass [kg]")
    l: Array = parameter(1.0, doc="tip to centre of mass [m]")  # noqa: E741
    A: Array = parameter(0.234375, doc="moment of inertia across the axis, about the centre [kg m^2]")
    C: Array = parameter(0.46875, doc="moment of inertia about the axis [kg m^2]")
    g: Array = parameter(9.81, doc="gravity, along -z [m/s^2]")
    j0: Array = parameter(0.3125, doc="inertia along p that makes M regular; the motion does not depend on it [kg m^2]")

    @property
    def inertia(self) -> Array:
        """Principal moments (3,) [kg m^2]."""
        return jnp.stack([self.A, self.C, self.A])

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix: (7, 7): ``m`` three times and the block of the quaternion."""
        block = rotational_mass(q[3:], self.inertia, self.j0)
        return jnp.zeros((7, 7)).at[:3, :3].set(self.m * jnp.eye(3)).at[3:, 3:].set(block)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight and the terms quadratic in p', (7,)."""
        weight = jnp.zeros(3).at[2].set(-self.m * self.g)
        return jnp.concatenate([weight, rotational_force(q[3:], v[3:], self.inertia)])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: norm of the quaternion and the tip, (4,) [1, m, m, m]."""
        return jnp.concatenate([norm_rows(q[3:])[None], q[:3] - self.l * rotation(q[3:])[:, 1]])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]."""
        w = body_rate(q[3:], v[3:])
        return (self.m * v[:3] @ v[:3] + w @ (self.inertia * w)) / 2 + self.m * self.g * q[2]

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: spin [rad/s] and angular momentum about the vertical through the tip [kg m^2/s]."""
        w = body_rate(q[3:], v[3:])
        vertical = rotation(q[3:])[2] @ (self.inertia * w) + self.m * (q[0] * v[1] - q[1] * v[0])
        return {"spin": w[1], "vertical_momentum": vertical}


def centre(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Centre of mass (3,) [m]."""
    return np.asarray(q[:3])


def tip_force(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Force of the tip on the ground (3,) [N]."""
    return np.asarray(lam[1:4])


def sketch(l: float, q: Vector) -> dict[str, Vector]:  # noqa: E741
    """Drawing at ``q``: tip and centre as ``points`` (2, 3); axis, rim, three sides of a cone, a post below as ``lines``
    (29, 2, 3) [m].
    """
    first, axis, third = np.asarray(rotation(q[3:])).T
    angles = np.linspace(0.0, 2 * math.pi, 25)
    rim = q[:3] + l * 0.4 * (np.outer(np.cos(angles), first) + np.outer(np.sin(angles), third))
    tip = np.asarray(q[:3]) - l * axis
    sides = np.stack([np.tile(tip, (3, 1)), rim[:24:8]], axis=1)
    post = [[[0.0, 0.0, 0.0], [0.0, 0.0, -1.3 * l]]]
    lines = np.concatenate([[[tip, q[:3] + 0.3 * l * axis]], sides, chain(rim), post])
    return {"points": np.array([tip, q[:3]]), "lines": lines}


def problem(
    *,
    m: float = 15.0,
    l: float = 1.0,  # noqa: E741
    A: float = 0.234375,
    C: float = 0.46875,
    g: float = 9.81,
    spin: float = 150.0,
    turn: float = -4.61538,
    j0: float | None = None,
    t_end: float = 2.0,
) -> Problem:
    """Make the problem: the top over [0, ``t_end``] [s], its axis level and along y at the start.

    Parameters
    ----------
    m, l
        Mass [kg] and distance from tip to centre [m], above 0.
    A, C
        Moments of inertia about the centre, across and about the axis [kg m^2], above 0.
    g
        Gravity [m/s^2].
    spin, turn
        Rates at the start about the axis and about the vertical [rad/s].
    j0
        Inertia along the quaternion [kg m^2], at least 0; None takes the mean ``(2 A + C) / 3``.
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "l": checked("l", l, above=0.0, unit="m"),
        "A": checked("A", A, above=0.0, unit="kg m^2"),
        "C": checked("C", C, above=0.0, unit="kg m^2"),
        "g": checked("g", g, unit="m/s^2"),
    }
    spin, turn = checked("spin", spin, unit="rad/s"), checked("turn", turn, unit="rad/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = {**values, "spin": spin, "turn": turn} == PUBLISHED and j0 is None
    values["j0"] = (2 * values["A"] + values["C"]) / 3 if j0 is None else checked("j0", j0, at_least=0.0, unit="kg m^2")
    length, identity = values["l"], np.array([1.0, 0.0, 0.0, 0.0])
    fall = math.sqrt(abs(values["g"]) / length)
    rate, swing = max(abs(spin), abs(turn), fall, 1.0), max(abs(turn), fall, 1.0)
    force = values["m"] * length * swing**2
    return Problem(
        name="heavy_top",
        system=HeavyTop(**values),
        t_span=(0.0, t_end),
        q0=np.concatenate([[0.0, length, 0.0], identity]),
        v0=np.concatenate([[-turn * length, 0.0, 0.0], quaternion_rate(identity, [0.0, spin, turn])]),
        scales=Scales(
            q=np.array([length] * 3 + [1.0] * 4),
            v=np.array([length * swing] * 3 + [rate / 2] * 4),
            lam=np.array([max(values["A"], values["C"]) * rate**2] + [force] * 3),
        ),
        observables={"centre": centre, "tip_force": tip_force},
        reference=load_reference("heavy_top", t_end) if published else None,
        sketch=functools.partial(sketch, length),
        tags=("holonomic", "variable mass", "singular") if values["j0"] == 0 else ("holonomic", "variable mass"),
        good_for="Fast rotation in space by a unit quaternion with a slow precession to be kept: spin, energy and moment "
        "of momentum are known, and so is the reaction at the tip.",
        source=SOURCE,
    )
