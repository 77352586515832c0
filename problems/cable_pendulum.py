r"""A very flexible cable, pinned at one end and let go in the horizontal; in the plane or in space.

Source of the cable: C. Westin, R. A. Irani, Efficient semi-implicit numerical integration of ANCF and ALE-ANCF cable models
with holonomic constraints, Computational Mechanics 2023, by the authors' program (repository cjwestin/ALE-ANCF_pendulum):
1 m, diameter 0.01 m, E = 2e7 Pa, I = 1e-8 m^4, 5000 kg/m^3, 10 elements.  The start, the damping, the length of the
interval and the motion in space are the team's own::

    y ^                                      q = (r_0, r'_0, r_1, r'_1, ...): position and slope of each node, d numbers each
      |                                      d = 2: (x, y);  d = 3: (x, y, z), y up, z towards the reader
      O====o====o====o== ... ==o--> x        x along the unstretched cable, node i at  i length / N
     pin   1    2    3         N             start: straight, unstretched; velocity (x / length) speed along the last axis

    M q'' = weight - eps_q^T (EA eps + c eps') - k_q^T EI k - lam      0 = g = r_0   [m]

The elements are those of ``hhtbench.mechanics.cables`` (J. Gerstmayr, A. A. Shabana, Nonlinear Dynamics 45 (2006) 109-130),
with consistent mass; c is an axial damping, without which the source's cable rings at up to 8e3 rad/s.  The cable has no
bending moment at the pin and none at its free end.  ``lam`` (d,) is the force of the cable on the pin [N].  SI units.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import cables
from hhtbench.mechanics.forces import force_of, power_lost, spring_damper
from hhtbench.mechanics.lines import chain, outline, pin_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = (
    "Westin and Irani, Computational Mechanics 2023 (cable); Gerstmayr and Shabana, Nonlinear Dynamics 45, 2006 (element)"
)
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here
PIECES = 4  # straight pieces that an element is drawn with
AREA = math.pi * 0.01**2 / 4  # of the section [m^2]
CABLE = {"EA": 2e7 * AREA, "EI": 2e7 * 1e-8, "mass": 5000 * AREA}  # [N, N m^2, kg/m] of the source


class CablePendulum(System):
    """``q`` (2 d (N + 1),): nodes of N elements one after another; constant mass matrix, d linear position constraints."""

    EA: Array = parameter(CABLE["EA"], doc="axial stiffness [N]")
    EI: Array = parameter(CABLE["EI"], doc="bending stiffness [N m^2]")
    mass: Array = parameter(CABLE["mass"], doc="mass per length [kg/m]")
    damping: Array = parameter(1.0, doc="axial force over the rate of the strain [N s]")
    length: Array = parameter(1.0, doc="unstretched length of the cable [m]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")
    n_elements: int = eqx.field(static=True, default=10)
    dimension: int = eqx.field(static=True, default=2)

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: consistent, (n, n) [kg, kg m, kg m^2]."""
        return cables.mass_matrix(self.n_elements, self.dimension, self.mass, self.length / self.n_elements)

    @property
    def weight(self) -> Array:
        """Generalised force (n,) of gravity."""
        down = -self.g * jnp.eye(self.dimension)[1]
        return self.mass_matrix @ cables.uniform(self.n_elements, down)

    def strains(self, q: Array) -> Array:
        """Strains (N, 3 + 2 d) of the elements."""
        return cables.strains(q.reshape(-1, 2, self.dimension), self.length / self.n_elements)

    def section(self, axial: Any, bending: Any) -> Array:
        """Factors (3 + 2 d,) of the strains of an element in a linear law."""
        return cables.section(axial, bending, self.length / self.n_elements, self.dimension)

    @property
    def law(self) -> Callable[[Array, Array], Array]:
        """Forces and moments of an element from its strains and their rates, times the weights of the points."""
        return spring_damper(self.section(self.EA, self.EI), self.section(self.damping, 0.0), 0.0)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: weight and elements, (n,) [N, N m]."""
        return self.weight + force_of(self.strains, self.law, q, v)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: node 0 at the pin, (d,) [m]."""
        return q[: self.dimension]

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy, weight and strain [J]."""
        strain = jnp.sum(self.section(self.EA, self.EI) * self.strains(q) ** 2) / 2
        return v @ self.mass_matrix @ v / 2 - self.weight @ q + strain

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the damping [W]."""
        return power_lost(self.strains, self.law, q, v)


def tip(dimension: int, t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Position of the free end, (d,) [m]."""
    return q[-2 * dimension : -dimension]


def pull(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Force at the pin [N]."""
    return float(np.linalg.norm(lam))


def sketch(dimension: int, length: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: nodes as ``points`` (N + 1, d); the bent elements and a support as ``lines`` [m]; y up."""
    nodes = np.asarray(q).reshape(-1, 2, dimension)
    at = np.arange(PIECES) / PIECES
    curve = np.asarray(cables.derivative_at(nodes, length / (len(nodes) - 1), at)).reshape(-1, dimension)
    size = 0.05 * length
    plate = outline(size * np.array([(-1, 0, -1), (1, 0, -1), (1, 0, 1), (-1, 0, 1)]))
    support = plate if dimension == 3 else pin_lines(np.zeros(2), size, up=1.0)
    drawing = {"points": nodes[:, 0], "lines": np.concatenate([chain(np.vstack([curve, nodes[-1:, 0]])), support])}
    return drawing | ({"up": 1} if dimension == 3 else {})


def start(n: int, dimension: int, length: float, speed: float) -> tuple[Vector, Vector]:
    """Coordinates and velocities (n,) each of the straight cable that turns about its pin."""
    q0, v0 = np.zeros((2, n + 1, 2, dimension))
    share = np.arange(n + 1) / n
    q0[:, 0, 0], q0[:, 1, 0] = length * share, 1.0
    v0[:, 0, -1], v0[:, 1, -1] = speed * share, speed / length
    return q0.ravel(), v0.ravel()


def problem(
    *,
    n_elements: int = 10,
    dimension: int = 2,
    length: float = 1.0,
    EA: float = CABLE["EA"],
    EI: float = CABLE["EI"],
    mass: float = CABLE["mass"],
    damping: float = 1.0,
    g: float = 9.81,
    speed: float = 1.0,
    t_end: float = 1.0,
) -> Problem:
    """Make the problem: the cable let go in the horizontal over [0, ``t_end``] [s].

    Parameters
    ----------
    n_elements
        N, at least 1.
    dimension
        2, plane, or 3, space.
    length
        Of the unstretched cable [m], above 0.
    EA, EI
        Axial stiffness [N], above 0, and bending stiffness [N m^2], at least 0; at 0 nothing holds the free end's slope.
    mass
        Mass per length [kg/m], above 0.
    damping
        Axial force over the rate of the strain [N s], at least 0.
    g
        Gravity [m/s^2], above 0.
    speed
        Of the free end at the start [m/s], along the last axis: upwards in the plane, sideways in space.
    """
    n, dimension = positive_integer("n_elements", n_elements), positive_integer("dimension", dimension)
    if dimension not in (2, 3):
        raise ProblemError(f"dimension must be at least 2, the plane, and at most 3, space; got {dimension}.")
    values: dict[str, Any] = {
        "length": checked("length", length, above=0.0, unit="m"),
        "EA": checked("EA", EA, above=0.0, unit="N"),
        "EI": checked("EI", EI, at_least=0.0, unit="N m^2"),
        "mass": checked("mass", mass, above=0.0, unit="kg/m"),
        "damping": checked("damping", damping, at_least=0.0, unit="N s"),
        "g": checked("g", g, above=0.0, unit="m/s^2"),
    }
    speed, t_end = checked("speed", speed, unit="m/s"), checked("t_end", t_end, above=0.0, unit="s")
    published = (n, *values.values(), speed) == (10, 1.0, *CABLE.values(), 1.0, 9.81, 1.0)
    length, mass, g = values["length"], values["mass"], values["g"]
    q0, v0 = start(n, dimension, length, speed)
    fall = math.hypot(math.sqrt(g * length), speed)
    sizes = np.broadcast_to(np.array([length, 1.0])[:, None], (n + 1, 2, dimension)).ravel()
    more = [name for name, there in (("damped", values["damping"]), ("large", q0.size >= LARGE)) if there]
    tags = ("holonomic", "flexible", "stiff", *more)
    return Problem(
        name="cable_pendulum",
        system=CablePendulum(**values, n_elements=n, dimension=dimension),
        t_span=(0.0, t_end),
        q0=q0,
        v0=v0,
        scales=Scales(q=sizes, v=sizes * fall / length, lam=mass * (g * length + fall**2)),
        observables={"tip": functools.partial(tip, dimension), "pull": pull},
        reference=load_reference(f"cable_pendulum_{dimension}d", t_end) if published else None,
        sketch=functools.partial(sketch, dimension, length),
        tags=tags,
        good_for="a cable that bends as it likes: stiffness that changes with the motion, damped axial waves",
        source=SOURCE,
    )
