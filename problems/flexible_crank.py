r"""A slider crank turned at a constant rate, its rod of any number of geometrically exact beam elements, damped.

Source of the numbers: slider crank problem of the Test Set for IVP Solvers (F. Mazzia, F. Iavernaro, C. Magherini, Bari), as
in ``slider_crank_flexible``, with four shapes for the rod.  Elements, the shear and the damping are of this bench::

             0                           q = (x_0, y_0, theta_0, ..., x_N, y_N, theta_N): nodes of the rod [m, m, rad]
            / '-.1_   rod, L2, N elements   node 0 is on the crank, node N is the slider
      L1   /      '-.2_                  lam: force of the rod on the crank's pin [N, N] and of the slider on its guide [N]
          / Om t       '-._
    -----O-----------------[ N ]----     0 = g = (x_0 - L1 cos(Om t),  y_0 - L1 sin(Om t),  y_N)

The crank has no mass of its own: its motion is prescribed.  Shear takes 5/6 of the section and Poisson's ratio 0.3; the
damping is ``beta`` times the stiffness.  Mass is consistent, and the slider's is added at node N.  Start: rigid motion of
the straight rod, so that it vibrates.  SI units.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import beams
from hhtbench.mechanics.forces import force_of, power_lost, spring_damper
from hhtbench.mechanics.lines import chain, pin_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "numbers of the Test Set for IVP Solvers, slider crank problem; beam elements, shear and damping by this bench"
NUMBERS = {"E": 2e11, "M3": 0.075552, "Om": 150.0, "beta": 1e-5}
LARGE = 100  # coordinates from which the tag "large" is set: dense linear algebra stops being the best choice about here


class FlexibleCrank(System):
    """``q`` (3 (N + 1),): nodes of the rod; constant mass matrix, three position constraints, two of them rheonomic."""

    E: Array = parameter(NUMBERS["E"], doc="modulus of the rod [Pa]")
    M3: Array = parameter(NUMBERS["M3"], doc="mass of the slider [kg]")
    Om: Array = parameter(NUMBERS["Om"], doc="rate of the crank [rad/s]")
    beta: Array = parameter(NUMBERS["beta"], doc="damping over stiffness [s]")
    L1: Array = parameter(0.15, doc="length of the crank [m]")
    L2: Array = parameter(0.30, doc="length of the rod [m]")
    rho: Array = parameter(7870.0, doc="density of the rod [kg/m^3]")
    side: Array = parameter(0.008, doc="width and height of the rod [m]")
    n_elements: int = eqx.field(static=True, default=4)

    @property
    def element(self) -> Array:
        """Length of an element [m]."""
        return self.L2 / self.n_elements

    @property
    def section(self) -> Array:
        """Area and second moment of area (3,) that extension, shear and bending see [m^2, m^2, m^4]."""
        return jnp.stack([self.side**2, self.side**2, self.side**4 / 12])

    @property
    def stiffness(self) -> Array:
        """Stiffness (3,) against extension, shear and bending [N, N, N m^2]."""
        return self.E * self.section * np.array([1.0, 5 / 6 / (2 * (1 + 0.3)), 1.0])

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: consistent, and the slider, (n, n) [kg, kg m^2]."""
        rod = jnp.kron(beams.consistent_lengths(self.n_elements, self.element), jnp.diag(self.rho * self.section))
        return rod.at[-3, -3].add(self.M3).at[-2, -2].add(self.M3)

    @property
    def law(self) -> Callable[[Array, Array], Array]:
        """Forces and moments of an element from its strains and their rates, times its length."""
        return spring_damper(self.element * self.stiffness, self.beta * self.element * self.stiffness, 0.0)

    def strains(self, q: Array) -> Array:
        """Strains (N, 3) of the elements."""
        nodes = q.reshape(-1, 3)
        return beams.strains_in_plane(nodes[:-1], nodes[1:], self.element)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: elements, (n,) [N, N, N m]."""
        return force_of(self.strains, self.law, q, v)

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: node 0 on the crank, node N in the guide, (3,) [m]."""
        turn = self.Om * t
        return jnp.stack([q[0] - self.L1 * jnp.cos(turn), q[1] - self.L1 * jnp.sin(turn), q[-2]])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic and strain energy [J]."""
        return v @ self.mass_matrix @ v / 2 + beams.strain_energy(self.strains(q), self.stiffness, self.element)

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the drive, ``lam . g_t``, and of the damping [W]."""
        turn = self.Om * t
        drive = self.L1 * self.Om * (lam[0] * jnp.sin(turn) - lam[1] * jnp.cos(turn))
        return drive + power_lost(self.strains, self.law, q, v)


def deflection(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Distance of the rod's middle node, or the one before, from the line between its ends [m]."""
    nodes = np.asarray(q).reshape(-1, 3)[:, :2]
    along = nodes[-1] - nodes[0]
    out = nodes[(len(nodes) - 1) // 2] - nodes[0]
    return float((along[0] * out[1] - along[1] * out[0]) / np.linalg.norm(along))


def slider(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Position of the slider [m]."""
    return float(q[-3])


def sketch(L1: float, L2: float, q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: bearing and nodes as ``points`` (N + 2, 2); crank, elements, guide and support as ``lines`` [m]."""
    points = np.concatenate([np.zeros((1, 2)), np.asarray(q).reshape(-1, 3)[:, :2]])
    guide = [(np.array([0.0, -0.05 * L2]), np.array([L1 + 1.1 * L2, -0.05 * L2]))]
    return {"points": points, "lines": np.concatenate([chain(points), guide, pin_lines(np.zeros(2), 0.1 * L2)])}


def problem(
    *,
    n_elements: int = 4,
    E: float = NUMBERS["E"],
    M3: float = NUMBERS["M3"],
    Om: float = NUMBERS["Om"],
    beta: float = NUMBERS["beta"],
    t_end: float = 0.1,
) -> Problem:
    """Make the problem: the mechanism over [0, ``t_end``] [s], started as if it were rigid.

    Parameters
    ----------
    n_elements
        N, at least 1.
    E
        Modulus of the rod [Pa], above 0.
    M3
        Mass of the slider [kg], at least 0.
    Om
        Rate of the crank [rad/s], above 0.
    beta
        Damping of the rod over its stiffness [s], at least 0.
    """
    n = positive_integer("n_elements", n_elements)
    values: dict[str, Any] = {
        "E": checked("E", E, above=0.0, unit="Pa"),
        "M3": checked("M3", M3, at_least=0.0, unit="kg"),
        "Om": checked("Om", Om, above=0.0, unit="rad/s"),
        "beta": checked("beta", beta, at_least=0.0, unit="s"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    system, Om = FlexibleCrank(**values, n_elements=n), values["Om"]
    L1, L2 = float(system.L1), float(system.L2)
    share = np.arange(n + 1) / n
    q0, v0 = np.zeros((2, n + 1, 3))
    q0[:, 0], v0[:, 1], v0[:, 2] = L1 + L2 * share, Om * L1 * (1 - share), -Om * L1 / L2
    force = (float(system.rho * system.side**2) * L2 + values["M3"]) * L1 * Om**2
    tags = ("holonomic", "rheonomic", "flexible", "stiff", *(("damped",) if values["beta"] else ()))
    return Problem(
        name="flexible_crank",
        system=system,
        t_span=(0.0, t_end),
        q0=q0.ravel(),
        v0=v0.ravel(),
        scales=Scales(q=np.tile([L1 + L2, L1, 1.0], n + 1), v=Om * np.tile([L1, L1, L1 / L2], n + 1), lam=force),
        observables={"deflection": deflection, "slider": slider},
        reference=load_reference("flexible_crank", t_end) if (n, values) == (4, NUMBERS) else None,
        sketch=functools.partial(sketch, L1, L2),
        tags=(*tags, "large") if q0.size >= LARGE else tags,
        good_for="an elastic rod as elements, not shapes: its fastest waves are a thousand times faster than the mechanism",
        source=SOURCE,
    )
