r"""A cantilever with a right angle in it, kicked out of its plane: geometrically exact beams in space, undamped.

Source: J. C. Simo, L. Vu-Quoc, On the dynamics in space of rods undergoing large motions - a geometrically exact approach,
Computer Methods in Applied Mechanics and Engineering 66 (1988) 125-161, right-angle cantilever beam::

      y ^
        |         o 2N  free end          q = (x_0, p_0, x_1, p_1, ...): position and unit quaternion of each node, 7 each
        |         |                       node i < N: leg along x, node N: elbow, node i > N: leg along y
        |         |  second leg           lam (6 + 2N + 1,): force [N] and moment [N m] of the beam on the clamp, then
        |         |                         the multipliers of p_i . p_i = 1
     ###0---------N ----> x               P(t): force along z at the elbow, up to 50 N at 1 s, back to zero at 2 s

    M q'' = F - strains_q^T C strains + P(t) e_z - g_q^T lam      0 = g = (x_0,  2 e_0,  p_i . p_i - 1),  p_i = (e0_i, e_i)

Elements of ``hhtbench.mechanics.beams``; the mass is consistent for the positions, the rotary inertia lumped at the nodes,
as in the library's bodies.  After 2 s the energy stays.  The elbow swings by half a leg's length.  SI units.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import beams, space
from hhtbench.mechanics.forces import force_of, spring_damper
from hhtbench.mechanics.lines import chain, outline
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Simo and Vu-Quoc, Comput. Methods Appl. Mech. Eng. 66 (1988) 125-161, right-angle cantilever beam"
NUMBERS = {"length": 10.0, "EA": 1e6, "GA": 1e6, "GJ": 1e3, "EI": 1e3, "rho_A": 1.0, "rho_I": 10.0, "peak": 50.0}
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here


class RightAngleCantilever(System):
    """``q`` (7 (2N + 1),): nodes of two legs of N elements; mass matrix that moves with the quaternions."""

    length: Array = parameter(NUMBERS["length"], doc="of each leg without strain [m]")
    EA: Array = parameter(NUMBERS["EA"], doc="axial stiffness [N]")
    GA: Array = parameter(NUMBERS["GA"], doc="shear stiffness, both ways [N]")
    GJ: Array = parameter(NUMBERS["GJ"], doc="stiffness against twist [N m^2]")
    EI: Array = parameter(NUMBERS["EI"], doc="bending stiffness, both ways [N m^2]")
    rho_A: Array = parameter(NUMBERS["rho_A"], doc="mass per length [kg/m]")
    rho_I: Array = parameter(
        NUMBERS["rho_I"], doc="rotary inertia of bending per length; that of twist is twice as large [kg m]"
    )
    peak: Array = parameter(NUMBERS["peak"], doc="largest force at the elbow [N]")
    n_elements: int = eqx.field(static=True, default=2)

    @property
    def element(self) -> Array:
        """Length of an element [m]."""
        return self.length / self.n_elements

    @property
    def stiffness(self) -> Array:
        """Stiffness (6,) of the section against extension, two shears [N], twist and two bendings [N m^2]."""
        return jnp.stack([self.EA, self.GA, self.GA, self.GJ, self.EI, self.EI])

    @property
    def translation(self) -> Array:
        """Mass matrix of the positions: consistent, (n, n) [kg], zero for the quaternions."""
        lengths = beams.consistent_lengths(2 * self.n_elements, self.element)
        return jnp.kron(lengths, self.rho_A * np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0]))

    @property
    def inertia(self) -> Array:
        """Moments of inertia (2N + 1, 3) of the nodes about the axes of their frames [kg m^2]."""
        leg = beams.lumped_lengths(self.n_elements, self.element)
        none = np.zeros(self.n_elements)
        along_x, along_y = jnp.concatenate([leg, none]), jnp.concatenate([none, leg])
        return self.rho_I * (along_x[:, None] * np.array([2.0, 1.0, 1.0]) + along_y[:, None] * np.array([1.0, 2.0, 1.0]))

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix (n, n) [kg, kg m^2]; the part along each quaternion is the largest moment, which moves nothing."""
        J = self.inertia
        return self.translation + space.mass_of_bodies(q, np.zeros(len(J)), J, jnp.max(J, axis=1))

    def strains(self, q: Array) -> Array:
        """Strains (2N, 6) of the elements."""
        nodes = q.reshape(-1, 7)
        frames = np.repeat([np.eye(3), [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]], self.n_elements, axis=0)
        return beams.strains_in_space(nodes[:-1], nodes[1:], frames, self.element)

    def load(self, t: Array) -> Array:
        """Force at the elbow [N]."""
        return self.peak * jnp.maximum(0.0, 1 - jnp.abs(t - 1))

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: elements, load and the terms quadratic in the rates of the quaternions, (n,) [N, N m]."""
        J = self.inertia
        turning = space.force_on_bodies(q, v, np.zeros(len(J)), J, np.zeros(3))
        elements = force_of(self.strains, spring_damper(self.element * self.stiffness, 0.0, 0.0), q, v)
        return (elements + turning).at[7 * self.n_elements + 2].add(self.load(t))

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: the clamp and the lengths of the quaternions, (6 + 2N + 1,) [m, rad, 1]."""
        return jnp.concatenate([q[:3], 2 * q[4:7], space.norm_rows(q.reshape(-1, 7)[:, 3:])])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and strain energy [J]."""
        J = self.inertia
        turning = space.energy_of_bodies(q, v, np.zeros(len(J)), J, np.zeros(3))
        return turning + v @ self.translation @ v / 2 + beams.strain_energy(self.strains(q), self.stiffness, self.element)

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the force at the elbow [W]."""
        return self.load(t) * v[7 * self.n_elements + 2]


def elbow(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Position of the elbow out of the plane at rest [m]."""
    return float(np.asarray(q).reshape(-1, 7)[len(q) // 14, 2])


def tip(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Position of the free end out of the plane at rest [m]."""
    return float(q[-5])


def sketch(q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: nodes as ``points`` (2N + 1, 3); elements and the clamp as ``lines`` [m]; z up."""
    points = np.asarray(q).reshape(-1, 7)[:, :3]
    plate = outline(np.array([(0, -1, -1), (0, 1, -1), (0, 1, 1), (0, -1, 1)], dtype=float))
    return {"points": points, "lines": np.concatenate([chain(points), plate]), "up": 2}


def problem(
    *,
    n_elements: int = 2,
    length: float = NUMBERS["length"],
    EA: float = NUMBERS["EA"],
    GA: float = NUMBERS["GA"],
    GJ: float = NUMBERS["GJ"],
    EI: float = NUMBERS["EI"],
    rho_A: float = NUMBERS["rho_A"],
    rho_I: float = NUMBERS["rho_I"],
    peak: float = NUMBERS["peak"],
    t_end: float = 4.0,
) -> Problem:
    """Make the problem: the beam from rest over [0, ``t_end``] [s]; the source goes up to 30 s.

    Parameters
    ----------
    n_elements
        N, of each leg, at least 1.
    length
        Of each leg [m], above 0.
    EA, GA
        Stiffness against extension and shear [N], above 0.
    GJ, EI
        Stiffness against twist and bending [N m^2], above 0.
    rho_A, rho_I
        Mass [kg/m] and rotary inertia of bending [kg m] per length, above 0; the rotary inertia of twist is 2 ``rho_I``.
    peak
        Largest force at the elbow [N].
    """
    n = positive_integer("n_elements", n_elements)
    values: dict[str, Any] = {
        "length": checked("length", length, above=0.0, unit="m"),
        "EA": checked("EA", EA, above=0.0, unit="N"),
        "GA": checked("GA", GA, above=0.0, unit="N"),
        "GJ": checked("GJ", GJ, above=0.0, unit="N m^2"),
        "EI": checked("EI", EI, above=0.0, unit="N m^2"),
        "rho_A": checked("rho_A", rho_A, above=0.0, unit="kg/m"),
        "rho_I": checked("rho_I", rho_I, above=0.0, unit="kg m"),
        "peak": checked("peak", peak, unit="N"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    length = values["length"]
    q0 = np.zeros((2 * n + 1, 7))
    q0[:, 0] = length * np.minimum(np.arange(2 * n + 1) / n, 1.0)
    q0[:, 1] = length * np.maximum(np.arange(2 * n + 1) / n - 1.0, 0.0)
    q0[:, 3] = 1.0
    sizes = np.tile([length] * 3 + [1.0] * 4, 2 * n + 1)
    tags = ("holonomic", "flexible", "stiff", "variable mass")
    return Problem(
        name="right_angle_cantilever",
        system=RightAngleCantilever(**values, n_elements=n),
        t_span=(0.0, t_end),
        q0=q0.ravel(),
        v0=np.zeros(q0.size),
        scales=Scales(q=sizes, v=sizes, lam=np.r_[[50.0] * 3, [50.0 * length] * (2 * n + 4)]),
        observables={"elbow": elbow, "tip": tip},
        reference=load_reference("right_angle_cantilever", t_end) if (n, values) == (2, NUMBERS) else None,
        sketch=sketch,
        tags=(*tags, "large") if q0.size >= LARGE else tags,
        good_for="beams in space that bend and twist as far as they are long, with rotations as unit quaternions",
        source=SOURCE,
    )
