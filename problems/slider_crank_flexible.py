r"""A slider crank turned at a constant rate, its connecting rod elastic and undamped: a full mass matrix that moves.

Source: slider crank problem of the Test Set for IVP Solvers (F. Mazzia, F. Iavernaro, C. Magherini, Bari), linear
stiffness, no damping, no gravity::

             B                            q = (phi1, phi2, x3, q1, q2, q3, q4) [rad, rad, m, m...]
            / '-._   rod, L2, elastic     phi1: crank, phi2: rod (below 0 here), x3: slider
      L1   /      '-._                    q1, q2: rod across, sin(pi s), sin(2 pi s)   (s = 0 at B, 1 at the slider)
          / phi1  phi2'-._                q3, q4: rod along, 4 s (1 - s), s (2 s - 1)  (its middle and its end)
    -----O-----------------[ x3 ]----

    M(q) v' = F(q, v) - g_q^T lam
    0 = g = (L1 sin phi1 + (L2 + q4) sin phi2,  x3 - L1 cos phi1 - (L2 + q4) cos phi2,  phi1 - Om t)

With Q = (q1..q4), C, S = cos, sin(phi1 - phi2), V1 = phi1', V2 = phi2'::

    M11 = J1 + M2 L1^2,   M12 = L1 L2 M2 C / 2 + rho L1 (S c2 + C c1).Q,   M22 = J2 + Q.MQ Q + 2 rho c12.Q,   M33 = M3
    M1Q = rho L1 (C c2 - S c1),   M2Q = rho (c21 + BQ^T Q),   MQQ = MQ,   elastic energy Q.KQ Q / 2

F is what Lagrange's equations give for them.  c1, c2, c12, c21 and BQ are integrals of the shapes over the rod.  Taken over
from the source as they are: pi = 3.1415927, and the block of MQ for q3, q4, which is 15 times that of the shapes.

Start: rigid motion of the undeformed rod, ``q = (0, 0, L1 + L2, 0, 0, 0, 0)``, ``v = (Om, -Om L1 / L2, 0, ...)``: exactly
consistent, and off the slow motion, so the rod vibrates (1277, 5107, 6841, 24613 rad/s).  SI units; lam [N, N, N m].
"""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import chain, pin_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Test Set for IVP Solvers, slider crank problem"
PI = 3.1415927  #: the source's value, which its reference values need
MAGNIFIED = 20.0  #: deflections in the drawing


class FlexibleSliderCrank(System):
    """Seven coordinates, three position constraints; names and numbers of the source."""

    M2: Array = parameter(0.151104, doc="mass of the rod [kg]")
    M3: Array = parameter(0.075552, doc="mass of the slider [kg]")
    L1: Array = parameter(0.15, doc="length of the crank [m]")
    L2: Array = parameter(0.30, doc="length of the rod [m]")
    J1: Array = parameter(0.002727, doc="inertia of the crank about its bearing [kg m^2]")
    J2: Array = parameter(0.0045339259, doc="inertia of the straight rod about its end B [kg m^2]")
    E: Array = parameter(2e11, doc="modulus of the rod [Pa]")
    rho: Array = parameter(7870.0, doc="density of the rod [kg/m^3]")
    B: Array = parameter(0.008, doc="width of the rod [m]")
    H: Array = parameter(0.008, doc="height of the rod [m]")
    Om: Array = parameter(150.0, doc="rate of the crank [rad/s]")

    @property
    def modal_mass(self) -> Array:
        """Modal mass matrix MQ (4, 4) [kg] of the elastic rod."""
        entries = np.array([[0.5, 0, 0, 0], [0, 0.5, 0, 0], [0, 0, 8, 1], [0, 0, 1, 2]])
        return self.rho * self.B * self.H * self.L2 * entries

    @property
    def stiffness(self) -> Array:
        """Stiffness matrix KQ (4, 4) [N/m] of the elastic rod: bending, stretching."""
        bending = np.diag([PI**4 / 24, PI**4 * 2 / 3, 0, 0])
        stretching = np.zeros((4, 4))
        stretching[2:, 2:] = [[16 / 3, -8 / 3], [-8 / 3, 7 / 3]]
        return self.E * self.B * self.H / self.L2 * (bending * (self.H / self.L2) ** 2 + stretching)

    @property
    def gyroscopic(self) -> Array:
        """Antisymmetric gyroscopic matrix BQ (4, 4) [m^3]: integrals of transverse times axial shapes."""
        upper = np.zeros((4, 4))
        upper[0, 2:], upper[1, 3] = (-16 / PI**3, 8 / PI**3 - 1 / PI), 1 / (2 * PI)
        return self.B * self.H * self.L2 * (upper - upper.T)

    @property
    def shape_integrals(self) -> tuple[Array, Array, Array, Array]:
        """Integrals c1, c2 [m^3] and c12, c21 [m^4] of the shapes and of their moments, (4,) each."""
        volume = self.B * self.H * self.L2
        along, across = np.array([0, 0, 2 / 3, 1 / 6]), np.array([2 / PI, 0, 0, 0])
        moment_along, moment_across = np.array([0, 0, 1 / 3, 1 / 6]), np.array([1 / PI, -1 / (2 * PI), 0, 0])
        return volume * along, volume * across, volume * self.L2 * moment_along, volume * self.L2 * moment_across

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix: (7, 7) [kg m^2, kg m, kg]."""
        Q, C, S = q[3:], jnp.cos(q[0] - q[1]), jnp.sin(q[0] - q[1])
        c1, c2, c12, c21 = self.shape_integrals
        MQ = self.modal_mass
        m12 = self.L1 * (self.L2 * self.M2 * C / 2 + self.rho * (S * c2 + C * c1) @ Q)
        m22 = self.J2 + Q @ MQ @ Q + 2 * self.rho * c12 @ Q
        zero = jnp.zeros_like(m12)
        m11 = self.J1 + self.M2 * self.L1**2
        rigid = jnp.stack([m11, m12, zero, m12, m22, zero, zero, zero, self.M3]).reshape(3, 3)
        side = self.rho * jnp.stack([self.L1 * (C * c2 - S * c1), c21 + self.gyroscopic.T @ Q, jnp.zeros(4)])
        return jnp.block([[rigid, side], [side.T, MQ]])

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: stiffness and the terms quadratic in v, (7,)."""
        Q, C, S = q[3:], jnp.cos(q[0] - q[1]), jnp.sin(q[0] - q[1])
        V1, V2, rate = v[0], v[1], v[3:]
        c1, c2, c12, _ = self.shape_integrals
        MQ, BQ = self.modal_mass, self.gyroscopic
        turned, ahead = S * c1 - C * c2, C * c1 + S * c2
        half = self.L1 * self.L2 * self.M2 * S / 2
        crank = -half * V2**2 - self.rho * self.L1 * V2 * (V2 * turned @ Q + 2 * ahead @ rate)
        rod = half * V1**2 + self.rho * self.L1 * V1**2 * turned @ Q - 2 * V2 * (self.rho * c12 + MQ @ Q) @ rate
        elastic = V2**2 * (MQ @ Q + self.rho * c12) - self.stiffness @ Q
        elastic += self.rho * (self.L1 * V1**2 * ahead + 2 * V2 * BQ @ rate)
        return jnp.concatenate([jnp.stack([crank, rod, jnp.zeros_like(rod)]), elastic])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: the rod's end in the slider (across, along) and the drive, (3,) [m, m, rad]."""
        end = self.L2 + q[6]
        return jnp.stack(
            [
                self.L1 * jnp.sin(q[0]) + end * jnp.sin(q[1]),
                q[2] - self.L1 * jnp.cos(q[0]) - end * jnp.cos(q[1]),
                q[0] - self.Om * t,
            ]
        )

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and elastic energy [J]."""
        return (v @ self.mass_matrix(t, q) @ v + q[3:] @ self.stiffness @ q[3:]) / 2

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the drive, ``lam . g_t`` [W]."""
        return -self.Om * lam[2]


def deflection(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Transverse deflection of the rod's middle [m]."""
    return float(q[3])


def slider(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Position of the slider [m]."""
    return float(q[2])


def sketch(L1: float, L2: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: bearing, B, slider as ``points`` (3, 2); crank, bent rod, slider, guide and support as ``lines``
    (31, 2, 2) [m].

    Deflections across the rod are drawn ``MAGNIFIED`` times.
    """
    phi1, phi2, x3, q1, q2, q3, q4 = np.asarray(q)
    O, joint, end = np.zeros(2), L1 * np.array([np.cos(phi1), np.sin(phi1)]), np.array([x3, 0.0])  # noqa: E741
    s = np.linspace(0.0, 1.0, 17)
    along = L2 * s + 4 * s * (1 - s) * q3 + s * (2 * s - 1) * q4
    across = MAGNIFIED * (np.sin(np.pi * s) * q1 + np.sin(2 * np.pi * s) * q2)
    turn = np.array([[np.cos(phi2), np.sin(phi2)], [-np.sin(phi2), np.cos(phi2)]])
    rod = joint + np.column_stack([along, across]) @ turn
    corners = end + 0.1 * L2 * np.array([(-1, -0.5), (1, -0.5), (1, 0.5), (-1, 0.5)])
    outline = [(corners[i], corners[i - 3]) for i in range(4)]
    guide = (np.array([-L1, -0.05 * L2]), np.array([L1 + 1.1 * L2, -0.05 * L2]))
    bars = np.concatenate([[(O, joint)], chain(rod), outline, [guide], pin_lines(O, 0.1 * L2)])
    note = f"deflections of the rod are drawn {MAGNIFIED:g} times"
    return {"points": np.array([O, joint, end]), "lines": bars, "note": note}


def typical_sizes(s: FlexibleSliderCrank) -> Scales:
    """Scales from the inertia of rod and slider, ``(M2 + M3) L1 Om^2``, and the rod's stiffness.

    Bending follows the drive with overtones of about 3 Om, stretching vibrates at the rod's own frequency.
    """
    L1, L2, Om, load = float(s.L1), float(s.L2), float(s.Om), float((s.M2 + s.M3) * s.L1 * s.Om**2)
    bend = float(s.M2 * s.L1 * s.Om**2) / 2 / np.diag(np.asarray(s.stiffness))[:2]
    stretch, rate = load * L2 / float(s.E * s.B * s.H), float(jnp.sqrt(s.E / s.rho)) / L2
    return Scales(
        q=np.array([1.0, 1.0, L1 + L2, *bend, stretch, stretch]),
        v=np.array([Om, Om * L1 / L2, Om * L1, *(3 * Om * bend), rate * stretch, rate * stretch]),
        lam=np.array([load, load, load * L1]),
    )


def problem(*, E: float = 2e11, M3: float = 0.075552, Om: float = 150.0, t_end: float = 0.1) -> Problem:
    """Make the problem: the mechanism over [0, ``t_end``] [s], started as if it were rigid.

    Parameters
    ----------
    E
        Modulus of the rod [Pa], above 0.
    M3
        Mass of the slider [kg], above 0.
    Om
        Rate of the crank [rad/s], above 0.
    """
    values: dict[str, Any] = {
        "E": checked("E", E, above=0.0, unit="Pa"),
        "M3": checked("M3", M3, above=0.0, unit="kg"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = tuple(values.values()) == (2e11, 0.075552, 150.0)
    system, Om = FlexibleSliderCrank(**values), values["Om"]
    L1, L2 = float(system.L1), float(system.L2)
    return Problem(
        name="slider_crank_flexible",
        system=system,
        t_span=(0.0, t_end),
        q0=np.array([0.0, 0.0, L1 + L2, 0.0, 0.0, 0.0, 0.0]),
        v0=np.array([Om, -Om * L1 / L2, 0.0, 0.0, 0.0, 0.0, 0.0]),
        scales=typical_sizes(system),
        observables={"deflection": deflection, "slider": slider},
        reference=load_reference("slider_crank_flexible", t_end) if published else None,
        sketch=functools.partial(sketch, L1, L2),
        tags=("holonomic", "rheonomic", "flexible", "stiff", "variable mass"),
        good_for="numerical damping: undamped vibrations of an elastic rod up to 24613 rad/s in a slowly turning mechanism",
        source=SOURCE,
    )
