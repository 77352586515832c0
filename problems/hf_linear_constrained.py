r"""Three unit masses in a row, one stiff spring, two masses held together: one slow and one fast vibration, all linear.

Source: made for this bench (the smallest constrained system with a fast frequency that its multiplier feels); solved by
modal analysis as in L. Meirovitch, Fundamentals of Vibrations, McGraw-Hill 2001::

                     K               lam             1            q = (x1, x2, x3): positions [m]
        [ x1 ]---/\/\/\/---[ x2 ]===========[ x3 ]--/\/\--|       unit masses [kg], spring 1 N/m from x3 to its place 0

    x1'' = -K (x1 - x2),   x2'' = K (x1 - x2) - lam,   x3'' = -x3 + lam,   0 = x2 - x3

Motion.  With ``y = x2 = x3`` the squares ``s = w^2`` of the two frequencies satisfy ``2 s^2 - (3 K + 1) s + K = 0``
(w near sqrt(1/3) and sqrt(1.5 K) for large K), in each mode ``y = (1 - s / K) x1``, and

    x1 = sum a_j cos(w_j t),   K (x1 - y) = sum s_j a_j cos(w_j t),   lam = (K (x1 - y) + y) / 2.

The start at rest, (1 + stretch, 1, 1), gives the fast mode about a third of ``K stretch`` in the multiplier.  SI units.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import box_lines, ground_lines, spring_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "made for this bench; modal analysis as in Meirovitch, Fundamentals of Vibrations, McGraw-Hill 2001"
PUBLISHED = {1e4: "hf_linear_constrained_k1e4", 1e8: "hf_linear_constrained_k1e8"}  #: stiffness -> stored values


class StiffPair(System):
    """``q = (x1, x2, x3)``; unit masses, one linear position constraint."""

    stiffness: Array = parameter(1e4, doc="K, spring between x1 and x2 [N/m]")

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: both springs, (3,) [N]."""
        pull = self.stiffness * (q[0] - q[1])
        return jnp.stack([-pull, pull, -q[2]])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: x2 and x3 move together, (1,) [m]."""
        return q[1:2] - q[2:]

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy and both springs [J]."""
        return (v @ v + self.stiffness * (q[0] - q[1]) ** 2 + q[2] ** 2) / 2


@dataclass(frozen=True)
class Modes:
    """The two vibration modes of one motion, the slow one first."""

    stiffness: float  #: K [N/m]
    squares: Vector  #: (2,) s = w^2 [rad^2/s^2]
    amplitudes: Vector  #: (2,) a of x1 [m]


def modes(stiffness: float, stretch: float) -> Modes:
    """Frequencies and amplitudes of both modes for the start; the small root comes from the product of both, without
    cancellation.
    """
    K = stiffness
    fast = (3 * K + 1 + np.sqrt(9 * K**2 - 2 * K + 1)) / 4
    slow = K / (2 * fast)
    share = (K * stretch - slow * (1 + stretch)) / (fast - slow)
    return Modes(K, np.array([slow, fast]), np.array([1 + stretch - share, share]))


def exact(found: Modes, t: float) -> Motion:
    """Closed solution at ``t`` [s]."""
    K, s, a = found.stiffness, found.squares, found.amplitudes
    w = np.sqrt(s)
    shapes = np.array([np.ones(2), 1 - s / K, 1 - s / K])
    cos = a * np.cos(w * t)
    q, v = shapes @ cos, -shapes @ (w * a * np.sin(w * t))
    return Motion(q=q, v=v, lam=np.array([(s @ cos + q[1]) / 2]), mu=np.zeros(0))


def sketch(q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: masses a unit apart, springs, rod and wall; ``points`` (3, 2), ``lines`` (44, 2, 2) [m]."""
    points = np.column_stack([np.arange(3.0) + np.asarray(q), np.zeros(3)])
    gap, wall, post = np.array([(0.12, 0.0), (4.5, 0.0), (0.0, 0.15)])
    squares = [box_lines(p, 0.24, 0.24) for p in points]
    springs = [spring_lines(points[0] + gap, points[1] - gap, 4, 0.14), spring_lines(points[2] + gap, wall, 4, 0.14)]
    rod = [(points[1] + gap + side, points[2] - gap + side) for side in (0.2 * post, -0.2 * post)]
    ground = ground_lines(wall - post, wall + post, 0.1)
    note = "a fast vibration as small as the stretch at the start cannot be seen"
    return {"points": points, "lines": np.concatenate([*squares, *springs, rod, ground]), "note": note}


def spring_stretch(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Elongation of the stiff spring [m]."""
    return float(q[0] - q[1])


def problem(*, stiffness: float = 1e4, stretch: float = 1e-3, t_end: float = 10.0) -> Problem:
    """Make the problem: the masses from rest at (1 + stretch, 1, 1) over [0, ``t_end``] [s].

    Parameters
    ----------
    stiffness
        K [N/m], above 0.
    stretch
        Of the stiff spring at the start [m].
    """
    stiffness = checked("stiffness", stiffness, above=0.0, unit="N/m")
    stretch, t_end = checked("stretch", stretch, unit="m"), checked("t_end", t_end, above=0.0, unit="s")
    stored = PUBLISHED.get(stiffness) if stretch == 1e-3 else None
    found = modes(stiffness, stretch)
    fastest = float(np.sqrt(found.squares) @ np.abs(found.amplitudes))
    return Problem(
        name="hf_linear_constrained",
        system=StiffPair(stiffness=jnp.asarray(stiffness)),
        t_span=(0.0, t_end),
        q0=np.array([1 + stretch, 1.0, 1.0]),
        v0=np.zeros(3),
        scales=Scales(q=1.0, v=fastest, lam=(stiffness * abs(stretch) + 1) / 2),
        observables={"stretch": spring_stretch},
        exact=functools.partial(exact, found),
        reference=load_reference(stored, t_end) if stored else None,
        sketch=sketch,
        tags=("holonomic", "stiff"),
        good_for="how a method treats a fast vibration in the multiplier, against a closed solution for any stiffness",
        source=SOURCE,
    )
