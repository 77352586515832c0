r"""A point on a stiff spring carries a second point on a rigid rod: from soft to rigid with one parameter.

Source: textbook mechanics (Newton's law for two points, Hooke's law); the usual stiff spring pendulum with a rod added::

    y ^     spring k,        rigid rod
      |     free length l1   of length l2     q = (x1, y1, x2, y2) [m],  M = diag(m1, m1, m2, m2)
      O-/\/\/\/\/\-(m1)-----------(m2)--> x   d = (x2 - x1, y2 - y1),  r = |(x1, y1)|

      start: (l1, 0), (l1 + l2, 0) at rest    F = (-k (r - l1) x1 / r, -k (r - l1) y1 / r - m1 g, 0, -m2 g)

    0 = (|d|^2 - l2^2) / 2   [m^2],      k = inf:   0 = (x1^2 + y1^2 - l1^2) / 2 comes first and the spring goes

The multipliers are forces over lengths [N/m].  The spring vibrates with sqrt(k / m1) rad/s and more; from the start given
the vibration is small, of the order of m g / k, and the motion tends to that of the rigid double pendulum.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import chain, pin_lines, spring_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference, minimal

SOURCE = "textbook mechanics, stiff spring pendulum with a rigid rod added"
COILS = 6  # of the drawn spring
STEMS = {1e2: "k1e2", 1e4: "k1e4", 1e6: "k1e6", 1e8: "k1e8", 1e12: "k1e12", math.inf: "rigid"}  # of the reference files


class RigidPendulum(System):
    """Double pendulum as the limit of a rigid spring: ``q = (x1, y1, x2, y2)``, constant mass, two rods."""

    m: Array = parameter((1.0, 1.0), doc="masses m1, m2 [kg]")
    l: Array = parameter((1.0, 1.0), doc="free length l1 of the spring, length l2 of the rod [m]")  # noqa: E741
    g: Array = parameter(9.81, doc="gravity [m/s^2]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (4,) [kg]."""
        return jnp.repeat(self.m, 2)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight, (4,) [N]."""
        return jnp.outer(-self.m * self.g, jnp.array([0.0, 1.0])).ravel()

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: lengths of both rods, (2,) [m^2]."""
        first, second = q[:2], q[2:] - q[:2]
        return (jnp.stack([first @ first, second @ second]) - self.l**2) / 2

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and gravitational energy [J]."""
        return jnp.sum(self.mass_matrix * v**2) / 2 + self.g * (self.m @ q[1::2])


class SpringPendulum(RigidPendulum):
    """The pendulum with a spring in place of the first rod and one constraint."""

    k: Array = parameter(1e4, doc="stiffness of the spring [N/m]")

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight and spring, (4,) [N]."""
        length = jnp.sqrt(q[:2] @ q[:2])
        pull = -self.k * (length - self.l[0]) / length * q[:2]
        return super().force(t, q, v) + jnp.pad(pull, (0, 2))

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: length of the rod, (1,) [m^2]."""
        return super().constraint(t, q)[1:]

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic, gravitational and spring energy [J]."""
        length = jnp.sqrt(q[:2] @ q[:2])
        return super().energy(t, q, v) + self.k * (length - self.l[0]) ** 2 / 2


def tip(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Position and velocity (x2, y2, x2', y2') of the second point [m, m/s]."""
    return np.concatenate([q[2:], v[2:]])


def sketch(rigid: bool, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: pin and both masses as ``points`` (3, 2), spring (a zigzag, or a rod), rod and support as ``lines``
    [m].
    """
    points = np.vstack([np.zeros(2), np.asarray(q).reshape(2, 2)])
    rods, size = chain(points), 0.06 * float(np.linalg.norm(points[2] - points[1]))
    first = rods[:1] if rigid else spring_lines(points[0], points[1], COILS, 1.4 * size)
    return {"points": points, "lines": np.concatenate([first, rods[1:], pin_lines(points[0], size, 1.0)])}


def is_rigid(stiffness: Any) -> bool:
    """True for infinite ``stiffness``; a spec can only give it as the word ``inf``."""
    return (isinstance(stiffness, str) and stiffness == "inf") or (isinstance(stiffness, float) and stiffness == math.inf)


def problem(
    *,
    stiffness: float | str = 1e4,
    m1: float = 1.0,
    m2: float = 1.0,
    l1: float = 1.0,
    l2: float = 1.0,
    g: float = 9.81,
    t_end: float = 1.0,
) -> Problem:
    """Make the problem: both points on the x axis at rest, over [0, ``t_end``] [s].

    Parameters
    ----------
    stiffness
        k [N/m], above 0; ``inf`` gives the rigid limit (two constraints, no spring).
    m1, m2
        Masses [kg], above 0.
    l1, l2
        Free length of the spring and length of the rod [m], above 0.
    g
        Gravity [m/s^2], above 0.
    """
    rigid = is_rigid(stiffness)
    k = math.inf if rigid else checked("stiffness", stiffness, above=0.0, unit="N/m")
    m = np.array([checked("m1", m1, above=0.0, unit="kg"), checked("m2", m2, above=0.0, unit="kg")])
    l = np.array([checked("l1", l1, above=0.0, unit="m"), checked("l2", l2, above=0.0, unit="m")])  # noqa: E741
    g, t_end = checked("g", g, above=0.0, unit="m/s^2"), checked("t_end", t_end, above=0.0, unit="s")
    length, weight = float(l.sum()), float(m.sum()) * g
    values: dict[str, Any] = {"m": m, "l": l, "g": g}
    published = (*m, *l, g) == (1.0, 1.0, 1.0, 1.0, 9.81) and k in STEMS
    return Problem(
        name="stiff_spring_pendulum",
        system=RigidPendulum(**values) if rigid else SpringPendulum(**values, k=jnp.asarray(k)),
        t_span=(0.0, t_end),
        q0=np.array([l[0], 0.0, length, 0.0]),
        v0=np.zeros(4),
        scales=Scales(q=length, v=math.sqrt(g * length), lam=weight / l if rigid else weight / l[1:]),
        observables={"tip": tip},
        reference=load_reference(f"stiff_spring_pendulum_{STEMS[k]}", t_end) if published else None,
        sketch=functools.partial(sketch, rigid),
        minimal=minimal("level_spring", k, m, l, g),
        tags=("holonomic",) if rigid else ("holonomic", "stiff"),
        good_for="How cost and error depend on stiffness alone, from a soft spring to its rigid limit, at the same motion.",
        source=SOURCE,
    )
