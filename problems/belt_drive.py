r"""A belt on two wheels: the first is turned up to speed, the second is braked; the belt holds by friction.

Source of belt and wheels: example beltDrivesComparison of Exudyn (J. Gerstmayr; repository jgerstmayr/EXUDYN): section
2 mm by 2 mm, E = 1e9 Pa, 1000 kg/m^3, axial damping 0.01 s EA, stretched by 0.005, wheels of radius 0.25 m and 0.01 kg m^2,
0.6 m apart, friction 0.2, 2 pi rad/s.  Elements, contact, brake and the way up to speed are the team's own::

          .-"-.--------.-"-.        q = (r_0, r'_0, ..., r_(N-1), r'_(N-1), angle_1, angle_2): closed belt of N elements
         /     \      /     \       wheels at (0, 0) and (distance, 0)
        (   1   )    (   2   )
         \     /      \     /       contact at 4 points of each element, each for a quarter of its length w:
          `-_-'--------`-_-'        push  w k s^1.5 (1 + 1.5 loss s'),  s the smooth depth in the wheel, onset e
        driven       braked         friction  mu push  against the sliding, smooth below the speed ``creep``

    0 = g = angle_1 - Om (t - (ramp / pi) sin(pi t / ramp)) / 2  [rad], after the ramp at the rate Om;  -lam: torque [N m]

Strains and mass are those of ``hhtbench.mechanics.cables``, contact and friction those of ``hhtbench.mechanics.contact``.
The belt starts stretched, at rest, in the depth at which contact carries its tension.  The damping is fast: waves along the
belt die at rates up to 3e7 1/s.  Gravity is left out.  SI units.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import cables, contact
from hhtbench.mechanics.forces import force_at, force_of, power_lost, rates, spring_damper
from hhtbench.mechanics.lines import chain, circle_lines
from hhtbench.mechanics.plane import turned
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "belt of Exudyn's example beltDrivesComparison; drive, brake and contact by this bench"
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here
AT = (np.arange(4) + 0.5) / 4  # points of contact in an element


class BeltDrive(System):
    """``q`` (4 N + 2,): nodes of the belt, angles of the wheels; constant mass matrix, one moving position constraint."""

    EA: Array = parameter(1e9 * 4e-6, doc="axial stiffness [N]")
    EI: Array = parameter(1e9 * 2e-3**4 / 12, doc="bending stiffness [N m^2]")
    mass: Array = parameter(1e3 * 4e-6, doc="mass per length [kg/m]")
    damping: Array = parameter(40.0, doc="axial force over the rate of the strain [N s]")
    length: Array = parameter(2.75, doc="unstretched length of the belt [m]")
    J: Array = parameter(0.01, doc="inertia of a wheel [kg m^2]")
    R: Array = parameter(0.25, doc="radius of a wheel [m]")
    distance: Array = parameter(0.6, doc="of the wheels' axes [m]")
    k: Array = parameter(2.5e6, doc="stiffness of the contact per length [N/m^2.5]")
    loss: Array = parameter(0.5, doc="of the contact [s/m]")
    onset: Array = parameter(1e-4, doc="gap over which contact sets in [m]")
    mu: Array = parameter(0.2, doc="coefficient of friction [1]")
    creep: Array = parameter(0.01, doc="sliding at which 0.71 of the friction acts [m/s]")
    brake: Array = parameter(0.2, doc="torque over the rate of the second wheel [N m s]")
    Om: Array = parameter(2 * math.pi, doc="rate of the first wheel after the ramp [rad/s]")
    ramp: Array = parameter(0.25, doc="time until the full rate [s]")
    n_elements: int = eqx.field(static=True, default=16)

    @property
    def element(self) -> Array:
        """Unstretched length of an element [m]."""
        return self.length / self.n_elements

    def nodes(self, q: Array) -> Array:
        """Nodes (N + 1, 2, 2) of the belt, the first once more at the end."""
        nodes = q[:-2].reshape(-1, 2, 2)
        return jnp.concatenate([nodes, nodes[:1]])

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: consistent for the belt, (n, n) [kg, kg m, kg m^2]."""
        n = 4 * self.n_elements
        closed = np.vstack([np.eye(n), np.eye(4, n)])
        belt = closed.T @ cables.mass_matrix(self.n_elements, 2, self.mass, self.element) @ closed
        return jax.scipy.linalg.block_diag(belt, self.J * jnp.eye(2))

    def strains(self, q: Array) -> Array:
        """Strains (N, 7) of the elements."""
        return cables.strains(self.nodes(q), self.element)

    def section(self, axial: Any, bending: Any) -> Array:
        """Factors (7,) of the strains of an element in a linear law."""
        return cables.section(axial, bending, self.element, 2)

    @property
    def law(self) -> Callable[[Array, Array], Array]:
        """Forces and moments of an element from its strains and their rates, times the weights of the points."""
        return spring_damper(self.section(self.EA, self.EI), self.section(self.damping, 0.0), 0.0)

    @property
    def stiffness(self) -> Array:
        """Stiffness of the contact at one point [N/m^1.5]."""
        return self.k * self.element / AT.size

    @property
    def contact_law(self) -> Callable[[Array, Array], Array]:
        """Tension [N], below 0, of a contact from its gap and rate."""
        return contact.hunt_crossley(self.stiffness, self.loss, self.onset)

    def points(self, q: Array) -> Array:
        """Points (8 N, 2) of the belt that may touch the first wheel, then the same for the second."""
        return jnp.tile(cables.derivative_at(self.nodes(q), self.element, AT).reshape(-1, 2), (2, 1))

    @property
    def centres(self) -> Array:
        """Centre (8 N, 2) of the wheel that a point may touch."""
        return jnp.repeat(jnp.array([[0.0, 0.0], [1.0, 0.0]]) * self.distance, AT.size * self.n_elements, axis=0)

    def contacts(self, q: Array) -> contact.Contact:
        """Contacts (8 N,) of the belt with the wheels."""
        return contact.on_sphere(self.points(q), 0.0, self.centres, self.R)

    def gaps(self, q: Array) -> Array:
        """Gaps (8 N,) [m] between belt and wheels."""
        return self.contacts(q).gap

    def friction(self, q: Array, v: Array) -> tuple[Callable[[Array], Array], Array, Array]:
        """Return belt points relative to the wheels' points that they touch, as a function of q; friction and sliding."""
        touching, arms = self.contacts(q), self.contacts(q).point - self.centres

        def apart(moved: Array) -> Array:
            angle = jnp.repeat(moved[-2:] - q[-2:], AT.size * self.n_elements)
            return self.points(moved) - self.centres - turned(angle, arms)

        rate = rates(apart, q, v)[1]
        sliding = rate - jnp.sum(rate * touching.normal, axis=-1, keepdims=True) * touching.normal
        push = -self.contact_law(*rates(self.gaps, q, v))
        return apart, contact.friction(push, sliding, self.mu, self.creep), sliding

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: elements, contact, friction and brake, (n,) [N, N m]."""
        apart, friction, _ = self.friction(q, v)
        inner = force_of(self.strains, self.law, q, v) + force_of(self.gaps, self.contact_law, q, v)
        return inner + force_at(apart, friction, q) - self.brake * v * np.eye(4 * self.n_elements + 2)[-1]

    def drive(self, t: Array) -> Array:
        """Angle of the first wheel [rad]."""
        slow = self.Om * (t - self.ramp / math.pi * jnp.sin(math.pi * t / self.ramp)) / 2
        return jnp.where(t < self.ramp, slow, self.Om * (t - self.ramp / 2))

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: angle of the first wheel, (1,) [rad]."""
        return (q[-2] - self.drive(t))[None]

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy, strain and contact [J]."""
        strain = jnp.sum(self.section(self.EA, self.EI) * self.strains(q) ** 2) / 2
        return v @ self.mass_matrix @ v / 2 + strain + contact.contact_energy(self.gaps(q), self.stiffness, self.onset)

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the dampers, of friction, brake and drive [W]."""
        _, friction, sliding = self.friction(q, v)
        lost = power_lost(self.strains, self.law, q, v) + power_lost(self.gaps, self.contact_law, q, v)
        drive = jax.jvp(self.drive, (t,), (jnp.ones_like(t),))[1]
        return lost + jnp.sum(friction * sliding) - self.brake * v[-1] ** 2 - lam[0] * drive


def start(n: int, radius: float, distance: float, stretch: float) -> tuple[Vector, float]:
    """Nodes (n, 2, 2) of a belt stretched around two circles, and its unstretched length [m]."""
    arc = math.pi * radius
    s = np.arange(n) * 2 * (distance + arc) / n
    parts = [s < distance, s < distance + arc, s < 2 * distance + arc]
    angle = np.select(parts, [0 * s, (s - distance) / radius, 0 * s + math.pi], (s - 2 * distance) / radius)
    tangent = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    along = np.select(parts, [s, 0 * s + distance, 2 * distance + arc - s], 0.0)
    place = np.stack([along + radius * tangent[:, 1], -radius * tangent[:, 0]], axis=1)
    return np.stack([place, (1 + stretch) * tangent], axis=1), 2 * (distance + arc) / (1 + stretch)


def rates_of_wheels(t: float, q: Vector, v: Vector, lam: Vector) -> Vector:
    """Rates of the two wheels, (2,) [rad/s]."""
    return v[-2:]


def torque(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Torque of the drive on the first wheel [N m]."""
    return -float(lam[0])


def sketch(R: float, distance: float, length: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: nodes as ``points`` (N, 2); belt, wheels and a spoke of each as ``lines`` [m]."""
    nodes = np.asarray(q)[:-2].reshape(-1, 2, 2)
    closed = np.concatenate([nodes, nodes[:1]])
    curve = np.asarray(cables.derivative_at(closed, length / len(nodes), AT)).reshape(-1, 2)
    centres = np.array([(0.0, 0.0), (distance, 0.0)])
    rims = centres + R * np.stack([np.cos(q[-2:]), np.sin(q[-2:])], axis=1)
    wheels = [circle_lines(centre, R, 32) for centre in centres]
    return {
        "points": nodes[:, 0],
        "lines": np.concatenate([chain(np.vstack([curve, curve[:1]])), *wheels, np.stack([centres, rims], axis=1)]),
    }


def problem(
    *,
    n_elements: int = 16,
    EA: float = 4000.0,
    damping: float = 40.0,
    stretch: float = 0.005,
    k: float = 2.5e6,
    mu: float = 0.2,
    brake: float = 0.2,
    Om: float = 2 * math.pi,
    ramp: float = 0.25,
    t_end: float = 0.25,
) -> Problem:
    """Make the problem: the drive from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    n_elements
        N, at least 8.
    EA
        Axial stiffness of the belt [N], above 0.
    damping
        Its axial force over the rate of the strain [N s], at least 0.
    stretch
        Of the belt at the start [1], above 0.
    k
        Stiffness of the contact per length [N/m^2.5], above 0.
    mu
        Coefficient of friction [1], at least 0.
    brake
        Torque over the rate of the second wheel [N m s], at least 0.
    Om
        Rate of the first wheel after the ramp [rad/s], above 0.
    ramp
        Time until the full rate [s], above 0.
    """
    n = positive_integer("n_elements", n_elements)
    if n < 8:
        raise ProblemError(f"n_elements must be at least 8, for elements that bend around a wheel; got {n}.")
    values: dict[str, Any] = {
        "EA": checked("EA", EA, above=0.0, unit="N"),
        "damping": checked("damping", damping, at_least=0.0, unit="N s"),
        "k": checked("k", k, above=0.0, unit="N/m^2.5"),
        "mu": checked("mu", mu, at_least=0.0, unit="1"),
        "brake": checked("brake", brake, at_least=0.0, unit="N m s"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
        "ramp": checked("ramp", ramp, above=0.0, unit="s"),
    }
    stretch, t_end = checked("stretch", stretch, above=0.0, unit="1"), checked("t_end", t_end, above=0.0, unit="s")
    published = (n, *values.values(), stretch) == (16, 4000.0, 40.0, 2.5e6, 0.2, 0.2, 2 * math.pi, 0.25, 0.005)
    R, distance, tension = 0.25, 0.6, values["EA"] * stretch
    nodes, length = start(n, R - (tension / R / values["k"]) ** (2 / 3), distance, stretch)
    q0 = np.append(nodes.ravel(), [0.0, 0.0])
    sizes = np.append(np.tile([R, R, 1.0, 1.0], n), [1.0, 1.0])
    return Problem(
        name="belt_drive",
        system=BeltDrive(**values, length=jnp.asarray(length), n_elements=n),
        t_span=(0.0, t_end),
        q0=q0,
        v0=np.zeros(q0.size),
        scales=Scales(q=sizes, v=sizes * values["Om"], lam=tension * R),
        observables={"rates_of_wheels": rates_of_wheels, "torque": torque},
        reference=load_reference("belt_drive", t_end) if published else None,
        sketch=functools.partial(sketch, R, distance, length),
        tags=(
            *("holonomic", "rheonomic", "flexible", "stiff", "damped", "contact"),
            *(("large",) if q0.size >= LARGE else ()),
        ),
        good_for="friction that drives: a belt sticks and creeps on its wheels while fast damping wants an implicit method",
        source=SOURCE,
    )
