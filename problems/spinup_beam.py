r"""A flexible beam on a hub that spins up to a constant rate: geometrically exact, in the plane, undamped.

Source: J. C. Simo, L. Vu-Quoc, On the dynamics of flexible beams under large overall motions - the plane case, Journal of
Applied Mechanics 53 (1986) 849-863; after T. R. Kane, R. R. Ryan, A. K. Banerjee, Journal of Guidance, Control, and Dynamics
10 (1987) 139-151::

               ,o N              q = (x_0, y_0, theta_0, x_1, ...): position and angle of each node [m, m, rad]
          ,o-'                   lam: force [N, N] and moment [N m] of the hub's end of the beam on the hub
      ,o-'    theta_1
    O 0 - - - - - - - x          0 = g = (x_0, y_0, theta_0 - psi(t)),   L: length

    psi(t) = 6/15 (t^2 / 2 + (15 / (2 pi))^2 (cos(2 pi t / 15) - 1))  up to 15 s,   6 t - 45  after

Elements of ``hhtbench.mechanics.beams`` with consistent mass.  First the beam lags, then it stretches and
is steady: along a rotating bar with w = 6 rad/s the stretch is tan(a L) / a - L with a^2 = rho A w^2 / EA, 5.14317e-4 m.
The fastest waves are far above the motion: with 8 elements 1e5 rad/s.  SI units.
"""

from __future__ import annotations

import functools
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import beams
from hhtbench.mechanics.forces import force_of, spring_damper
from hhtbench.mechanics.lines import chain, pin_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Simo and Vu-Quoc, J. Appl. Mech. 53 (1986) 849-863; Kane, Ryan, Banerjee, J. Guidance 10 (1987) 139-151"
BEAM = {"length": 10.0, "EA": 2.8e7, "GA": 1e7, "EI": 1.4e4, "rho_A": 1.2, "rho_I": 6e-4, "rate": 6.0, "spin_up": 15.0}
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here


class SpinUpBeam(System):
    """``q`` (3 (N + 1),): nodes of N elements; constant mass matrix, three position constraints, the third rheonomic."""

    length: Array = parameter(BEAM["length"], doc="of the unstrained beam [m]")
    EA: Array = parameter(BEAM["EA"], doc="axial stiffness [N]")
    GA: Array = parameter(BEAM["GA"], doc="shear stiffness [N]")
    EI: Array = parameter(BEAM["EI"], doc="bending stiffness [N m^2]")
    rho_A: Array = parameter(BEAM["rho_A"], doc="mass per length [kg/m]")
    rho_I: Array = parameter(BEAM["rho_I"], doc="rotary inertia per length [kg m]")
    rate: Array = parameter(BEAM["rate"], doc="of the hub at the end [rad/s]")
    spin_up: Array = parameter(BEAM["spin_up"], doc="time until the hub turns at a constant rate [s]")
    n_elements: int = eqx.field(static=True, default=8)

    @property
    def element(self) -> Array:
        """Length of an element [m]."""
        return self.length / self.n_elements

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: consistent, (n, n) [kg, kg m^2]."""
        section = jnp.diag(jnp.stack([self.rho_A, self.rho_A, self.rho_I]))
        return jnp.kron(beams.consistent_lengths(self.n_elements, self.element), section)

    @property
    def stiffness(self) -> Array:
        """Stiffness (3,) of the section against extension, shear and bending [N, N, N m^2]."""
        return jnp.stack([self.EA, self.GA, self.EI])

    def strains(self, q: Array) -> Array:
        """Strains (N, 3) of the elements."""
        nodes = q.reshape(-1, 3)
        return beams.strains_in_plane(nodes[:-1], nodes[1:], self.element)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: elements, (n,) [N, N, N m]."""
        return force_of(self.strains, spring_damper(self.element * self.stiffness, 0.0, 0.0), q, v)

    def hub_rate(self, t: Array) -> Array:
        """Prescribed rate of the hub [rad/s]."""
        turn = 2 * jnp.pi / self.spin_up
        return self.rate * jnp.where(t < self.spin_up, (t - jnp.sin(turn * t) / turn) / self.spin_up, 1.0)

    def hub_angle(self, t: Array) -> Array:
        """Prescribed angle of the hub [rad]."""
        turn = 2 * jnp.pi / self.spin_up
        early = (t**2 / 2 + (jnp.cos(turn * t) - 1) / turn**2) / self.spin_up
        return self.rate * jnp.where(t < self.spin_up, early, t - self.spin_up / 2)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: node 0 in the hub, (3,) [m, m, rad]."""
        return q[:3] - jnp.zeros(3).at[2].set(self.hub_angle(t))

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and strain energy [J]."""
        return v @ self.mass_matrix @ v / 2 + beams.strain_energy(self.strains(q), self.stiffness, self.element)

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the drive, ``lam . g_t`` [W]."""
        return -lam[2] * self.hub_rate(t)


def extension(length: float, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Distance of the tip from the hub beyond the length without strain [m]; below zero where the beam is bent."""
    return float(np.hypot(q[-3], q[-2])) - length


def drive(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Moment of the hub on the beam [N m]."""
    return -float(lam[2])


def sketch(length: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: nodes as ``points`` (N + 1, 2); elements and the hub's support as ``lines`` [m]."""
    points = np.asarray(q).reshape(-1, 3)[:, :2]
    return {"points": points, "lines": np.concatenate([chain(points), pin_lines(np.zeros(2), 0.05 * length)])}


def problem(
    *,
    n_elements: int = 8,
    length: float = BEAM["length"],
    EA: float = BEAM["EA"],
    GA: float = BEAM["GA"],
    EI: float = BEAM["EI"],
    rho_A: float = BEAM["rho_A"],
    rho_I: float = BEAM["rho_I"],
    rate: float = BEAM["rate"],
    spin_up: float = BEAM["spin_up"],
    t_end: float = 20.0,
) -> Problem:
    """Make the problem: the beam from rest along x over [0, ``t_end``] [s].

    Parameters
    ----------
    n_elements
        N, at least 1.
    length
        Of the beam [m], above 0.
    EA, GA, EI
        Stiffness against extension, shear [N] and bending [N m^2], above 0.
    rho_A, rho_I
        Mass [kg/m] and rotary inertia [kg m] per length, above 0.
    rate, spin_up
        Rate of the hub in the end [rad/s] and time until then [s], above 0.
    """
    n = positive_integer("n_elements", n_elements)
    values: dict[str, Any] = {
        "length": checked("length", length, above=0.0, unit="m"),
        "EA": checked("EA", EA, above=0.0, unit="N"),
        "GA": checked("GA", GA, above=0.0, unit="N"),
        "EI": checked("EI", EI, above=0.0, unit="N m^2"),
        "rho_A": checked("rho_A", rho_A, above=0.0, unit="kg/m"),
        "rho_I": checked("rho_I", rho_I, above=0.0, unit="kg m"),
        "rate": checked("rate", rate, above=0.0, unit="rad/s"),
        "spin_up": checked("spin_up", spin_up, above=0.0, unit="s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    length, rate = values["length"], values["rate"]
    q0 = np.zeros((n + 1, 3))
    q0[:, 0] = length * np.arange(n + 1) / n
    sizes = np.tile([length, length, 1.0], n + 1)
    force = values["rho_A"] * length**2 * rate**2 / 2
    tags = ("holonomic", "rheonomic", "flexible", "stiff")
    return Problem(
        name="spinup_beam",
        system=SpinUpBeam(**values, n_elements=n),
        t_span=(0.0, t_end),
        q0=q0.ravel(),
        v0=np.zeros(3 * n + 3),
        scales=Scales(q=sizes, v=sizes * rate, lam=np.array([force, force, force * length])),
        observables={"extension": functools.partial(extension, length), "drive": drive},
        reference=load_reference("spinup_beam", t_end) if (n, values) == (8, BEAM) else None,
        sketch=functools.partial(sketch, length),
        tags=(*tags, "large") if q0.size >= LARGE else tags,
        good_for="a slow motion with stiff waves on top that hardly move: 1e5 rad/s under a turn that takes a second",
        source=SOURCE,
    )
