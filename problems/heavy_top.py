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

import numpy as np
from jax import Array

from hhtbench.mechanics.lines import chain
from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.mechanics.multibody.system import Multibody
from hhtbench.mechanics.space import body_rate, rotation
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference
from problems._spatial import vertical_momentum, with_j0

SOURCE = "Geradin and Cardona, Flexible Multibody Dynamics, Wiley 2001 (heavy top)"
PUBLISHED = {"m": 15.0, "l": 1.0, "A": 0.234375, "C": 0.46875, "g": 9.81, "spin": 150.0, "turn": -4.61538}


def axial_rate(system: Multibody, q: Array, v: Array) -> Array:
    """Spin, the second body rate [rad/s]."""
    return body_rate(q[3:], v[3:])[1]


def mechanism(
    *,
    m: float = 15.0,
    l: float = 1.0,  # noqa: E741
    A: float = 0.234375,
    C: float = 0.46875,
    g: float = 9.81,
    spin: float = 150.0,
    turn: float = -4.61538,
) -> Mechanism:
    """Make the top at its start, parameters as in :func:`problem`: body ``top``, joint ``tip``."""
    made = Mechanism((0.0, 0.0, -g))
    made.invariants |= {"spin": axial_rate, "vertical_momentum": vertical_momentum}
    made.body("top", m, (A, min(C, 2 * A), A), (0.0, l, 0.0), velocity=(-turn * l, 0.0, 0.0), rate=(0.0, spin, turn))
    made.bodies["top"].inertia[1, 1] = C  # also above 2 A, which no body has: the equations allow it
    made.spherical("tip", "top", "ground", (0.0, 0.0, 0.0))
    return made


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
    values: dict[str, float] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "l": checked("l", l, above=0.0, unit="m"),
        "A": checked("A", A, above=0.0, unit="kg m^2"),
        "C": checked("C", C, above=0.0, unit="kg m^2"),
        "g": checked("g", g, unit="m/s^2"),
        "spin": checked("spin", spin, unit="rad/s"),
        "turn": checked("turn", turn, unit="rad/s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    j0 = None if j0 is None else checked("j0", j0, at_least=0.0, unit="kg m^2")
    m, length, A, C, g, spin, turn = values.values()
    fall = math.sqrt(abs(g) / length)
    rate, swing = max(abs(spin), abs(turn), fall, 1.0), max(abs(turn), fall, 1.0)
    made = mechanism(**values).problem(
        (0.0, t_end),
        name="heavy_top",
        scales=Scales(
            q=np.array([length] * 3 + [1.0] * 4),
            v=np.array([length * swing] * 3 + [rate / 2] * 4),
            lam=np.array([max(A, C) * rate**2] + [m * length * swing**2] * 3),
        ),
        observables={"centre": centre, "tip_force": tip_force},
        reference=load_reference("heavy_top", t_end) if values == PUBLISHED and j0 is None else None,
        sketch=functools.partial(sketch, length),
        tags=("holonomic", "variable mass", "singular") if j0 == 0 else ("holonomic", "variable mass"),
        good_for="Fast rotation in space by a unit quaternion with a slow precession to be kept: spin, energy and moment "
        "of momentum are known, and so is the reaction at the tip.",
        source=SOURCE,
    )
    return made if j0 is None else with_j0(made, j0)
