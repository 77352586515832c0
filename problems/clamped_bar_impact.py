r"""An elastic bar that meets a wall with its whole length in motion and sticks to it: a shock through finite elements.

Source: longitudinal bar with linear elements and consistent mass as in T. J. R. Hughes, The Finite Element Method,
Prentice Hall 1987; the wall as a constraint with a multiplier::

    |/                                        q = (q_0, ..., q_N): displacements of the nodes [m]
    |O-----o-----o-----o----- ... -----o      h = length / N,  N elements of stiffness EA / h
    |/0     1     2     3              N      each node i > 0 starts with -speed, node 0 at rest
        <-- speed                             0 = g = q_0

    element mass  mass h / 6 [[2, 1], [1, 2]]     (mass per length)
    M q'' = -K q - lam (1, 0, ..., 0)

lam < 0 is a bar pressed against the wall.  In the continuous bar a shock of stress ``speed sqrt(EA mass)`` runs to the free
end and back in ``2 length / c``, c = sqrt(EA / mass); the mesh follows it with vibrations up to ``sqrt(12) c / h``.

Modes j = 1..N with ``th = (2 j - 1) pi / (2 N)``: shape ``sin(i th)``, ``w = (c / h) sqrt(6 (1 - cos th) / (2 + cos th))``;
row 0 of the equations gives ``lam = (EA / h) q_1 - (mass h / 6) q_1''``.  SI units.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import ground_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Hughes, The Finite Element Method, Prentice Hall 1987 (linear bar elements, consistent mass)"
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here


class ClampedBar(System):
    """``q`` (N + 1,): displacements [m]; constant tridiagonal mass, one linear position constraint."""

    EA: Array = parameter(1.0, doc="axial stiffness [N]")
    mass: Array = parameter(1.0, doc="mass per length [kg/m]")
    length: Array = parameter(1.0, doc="length [m]")
    n_elements: int = eqx.field(static=True, default=10)

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: (N + 1, N + 1) [kg]."""
        n = self.n_elements
        shares = 4 * np.eye(n + 1) + np.eye(n + 1, k=1) + np.eye(n + 1, k=-1)
        shares[[0, -1], [0, -1]] = 2
        return self.mass * self.length / (6 * n) * shares

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: elements, (N + 1,) [N]."""
        return self.EA * self.n_elements / self.length * jnp.diff(jnp.pad(jnp.diff(q), 1))

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: node 0 at the wall, (1,) [m]."""
        return q[:1]

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy and strain [J]."""
        return v @ self.mass_matrix @ v / 2 + self.EA * self.n_elements / self.length * jnp.sum(jnp.diff(q) ** 2) / 2


@dataclass(frozen=True)
class Modes:
    """Modes of the unit bar (EA = mass = length = speed = 1) that starts with -1 at every free node."""

    shapes: Vector  #: (N, N) displacement of node i + 1 in mode j
    frequencies: Vector  #: (N,) [rad/s]
    speeds: Vector  #: (N,) share of each mode in the start


@functools.cache
def modes(n: int) -> Modes:
    """Mode shapes and shares in closed form; the shapes are orthogonal in M, so each share is a projection of the start."""
    angle = (2 * np.arange(1, n + 1) - 1) * math.pi / (2 * n)
    shapes = np.sin(np.outer(np.arange(1, n + 1), angle))
    cos, rows = np.cos(angle), np.append(np.ones(n - 1), 0.5) / n
    rows[0] -= 1 / (6 * n)  # sums of the rows of M; node 0 is missing in the first
    size = (2 + cos) / 6  # phi^T M phi
    return Modes(shapes, n * np.sqrt(6 * (1 - cos) / (2 + cos)), -(rows @ shapes) / size)


def exact(n: int, EA: float, mass: float, length: float, speed: float, t: float) -> Motion:
    """Modal solution at ``t`` [s]."""
    unit = modes(n)
    second = length * math.sqrt(mass / EA)  # time of the shock through the bar
    w, phase = unit.frequencies, unit.frequencies * t / second
    sin, cos = unit.speeds * np.sin(phase), unit.speeds * np.cos(phase)
    q, v, a = unit.shapes @ (sin / w), unit.shapes @ cos, -unit.shapes[0] @ (sin * w)
    lam = speed * math.sqrt(EA * mass) * (n * q[0] - a / (6 * n))
    return Motion(q=speed * second * np.append(0.0, q), v=speed * np.append(0.0, v), lam=np.array([lam]), mu=np.zeros(0))


def tip(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Displacement of the free end [m]."""
    return float(q[-1])


def tip_speed(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Velocity of the free end [m/s]."""
    return float(v[-1])


def sketch(length: float, scale: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: nodes as ``points`` (N + 1, 2); faces between elements, both sides and the wall as ``lines`` (3 N
    + 7, 2, 2) [m].

    Displacements are drawn ``scale`` times: a bar that meets a wall at the speed of sound would fold up.
    """
    n, half = len(q) - 1, 0.05 * length
    x = np.linspace(0.0, length, n + 1) + scale * np.asarray(q)
    up, down = np.column_stack([x, np.full(n + 1, half)]), np.column_stack([x, np.full(n + 1, -half)])
    sides = np.concatenate([np.stack([side[:-1], side[1:]], axis=1) for side in (up, down)])
    wall = ground_lines((0.0, 1.6 * half), (0.0, -1.6 * half), half)
    faces = np.stack([down, up], axis=1)
    note = f"displacements are drawn {scale:g} times" if scale != 1 else ""
    return {"points": (up + down) / 2, "lines": np.concatenate([sides, faces, wall]), "note": note}


def problem(
    *,
    n_elements: int = 10,
    EA: float = 1.0,
    mass: float = 1.0,
    length: float = 1.0,
    speed: float = 1.0,
    t_end: float = 3.0,
) -> Problem:
    """Make the problem: the bar from the moment it meets the wall over [0, ``t_end``] [s].

    Parameters
    ----------
    n_elements
        N, at least 1.
    EA
        Axial stiffness [N], above 0.
    mass
        Mass per length [kg/m], above 0.
    length
        Of the bar [m], above 0.
    speed
        Towards the wall [m/s], above 0.
    """
    n = positive_integer("n_elements", n_elements)
    EA, mass = checked("EA", EA, above=0.0, unit="N"), checked("mass", mass, above=0.0, unit="kg/m")
    length, speed = checked("length", length, above=0.0, unit="m"), checked("speed", speed, above=0.0, unit="m/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = (EA, mass, length, speed) == (1.0, 1.0, 1.0, 1.0) and n in (10, 100)
    squeeze = speed * length * math.sqrt(mass / EA)  # largest displacement of the continuous bar's end
    return Problem(
        name="clamped_bar_impact",
        system=ClampedBar(EA=jnp.asarray(EA), mass=jnp.asarray(mass), length=jnp.asarray(length), n_elements=n),
        t_span=(0.0, t_end),
        q0=np.zeros(n + 1),
        v0=np.append(0.0, np.full(n, -speed)),
        scales=Scales(q=squeeze, v=speed, lam=speed * math.sqrt(EA * mass)),
        observables={"tip": tip, "tip_speed": tip_speed},
        exact=functools.partial(exact, n, EA, mass, length, speed),
        reference=load_reference(f"clamped_bar_impact_n{n}", t_end) if published else None,
        sketch=functools.partial(sketch, length, min(1.0, 0.2 * length / squeeze)),
        tags=("holonomic", "flexible", "stiff", *(("large",) if n + 1 >= LARGE else ())),
        good_for="noise of the mesh's fast vibrations in the multiplier after a shock, and what damping by the method does",
        source=SOURCE,
    )
