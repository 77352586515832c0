r"""Chaplygin's sleigh: a rigid body on ice with one skate behind its centre of mass.

Source: A. M. Bloch, Nonholonomic Mechanics and Control, Springer 2003 (Chaplygin sleigh); solution by hyperbolic functions
of the reduced equations::

          ______                q = (x, y, th): centre of mass [m] and heading [rad]
         |      `-.             M = diag(m, m, I),  F = 0
         |=o  a  C >  ahead
         |______,-'             0 = -x' sin th + y' cos th - a th'
         skate                  no motion of the skate across its blade, nonholonomic

With u the speed ahead and w = th':  ``u' = a w^2``,  ``w' = -(a / A) u w``,  ``A = (I + m a^2) / m``.  So
``V^2 = u^2 + A w^2`` is conserved (2 energy / m) and, with ``tau = tau0 + (a V / A) t``, ``sinh tau0 = u0 / (sqrt(A) w0)``:

    u = V tanh tau,   w = V / sqrt(A) sech tau,   th = sqrt(A) / a (gd tau - gd tau0),   mu = -(I / A) u w,

gd the Gudermannian, ``tan gd = sinh``.  The skate's path ``integral of u (cos th, sin th) dt`` has no closed form that
is of use: Gauss's quadrature on short pieces of tau gives it to roundoff.  Without any friction the sleigh comes to run
straight ahead, the skate behind: the constraint makes that motion attracting although the energy is conserved.  SI units.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Bloch, Nonholonomic Mechanics and Control, Springer 2003 (Chaplygin sleigh)"
NODES, WEIGHTS = np.polynomial.legendre.leggauss(20)  # poles at distance pi / 2: a piece of length 1 errs by less than 1e-16


class ChaplyginSleigh(System):
    """``q = (x, y, th)``; constant mass, one velocity constraint, no force."""

    m: Array = parameter(1.0, doc="mass [kg]")
    I: Array = parameter(0.1, doc="inertia about the centre of mass [kg m^2]")  # noqa: E741
    a: Array = parameter(0.2, doc="skate to centre of mass [m]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (3,) [kg, kg, kg m^2]."""
        return jnp.stack([self.m, self.m, self.I])

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: none, (3,)."""
        return jnp.zeros_like(q)

    def velocity_constraint(self, t: Array, q: Array, v: Array) -> Array:
        """Velocity constraints: velocity of the skate across its blade, (1,) [m/s]."""
        return jnp.stack([-v[0] * jnp.sin(q[2]) + v[1] * jnp.cos(q[2]) - self.a * v[2]])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy [J]."""
        return jnp.sum(self.mass_matrix * v**2) / 2

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: ``V^2`` [m^2/s^2], and the heading less ``sqrt(A) / a gd(tau)`` [rad]: it ties the heading to the
        velocities.
        """
        A = (self.I + self.m * self.a**2) / self.m
        ahead = v[0] * jnp.cos(q[2]) + v[1] * jnp.sin(q[2])
        gd = jnp.arctan2(ahead, jnp.sqrt(A) * v[2])
        return {"V_squared": ahead**2 + A * v[2] ** 2, "heading": q[2] - jnp.sqrt(A) / self.a * gd}


@dataclass(frozen=True)
class Run:
    """Exact motion of the sleigh from the origin with heading 0."""

    I: float  #: [kg m^2]  # noqa: E741
    a: float  #: [m]
    A: float  #: (I + m a^2) / m [m^2]
    u0: float  #: speed ahead at the start [m/s]
    w0: float  #: turning rate at the start [rad/s]

    @property
    def V(self) -> float:
        """Conserved speed [m/s]."""
        return math.hypot(self.u0, math.sqrt(self.A) * self.w0)

    @property
    def tau0(self) -> float:
        """Value of the scaled time tau at the start."""
        return math.asinh(self.u0 / (math.sqrt(self.A) * self.w0))

    def heading(self, tau: Any) -> Any:
        """Heading [rad] at the scaled time."""
        return math.sqrt(self.A) / self.a * (gudermannian(tau) - gudermannian(self.tau0))

    def skate(self, tau: float) -> Vector:
        """Path of the skate from its start, (2,) [m]: ``integral of u (cos th, sin th) dt``, in pieces of tau."""
        turns = max(1.0, math.sqrt(self.A) / self.a)
        edges = np.linspace(self.tau0, tau, 1 + math.ceil(max(abs(tau - self.tau0) * turns, 1.0)))
        half = np.diff(edges)[:, None] / 2
        nodes = (edges[:-1] + edges[1:])[:, None] / 2 + half * NODES
        weights = self.A / self.a * half * WEIGHTS * np.tanh(nodes)
        th = self.heading(nodes)
        return np.array([np.sum(weights * np.cos(th)), np.sum(weights * np.sin(th))])


def gudermannian(tau: Any) -> Any:
    """Angle in (-pi/2, pi/2) whose tangent is ``sinh tau``."""
    return 2 * np.arctan(np.tanh(np.asarray(tau) / 2))


def exact(run: Run, t: float) -> Motion:
    """Solution at ``t`` [s]: velocities and heading in closed form, the position by quadrature to roundoff."""
    a, tau = run.a, run.tau0 + run.a * run.V / run.A * t
    decay = math.exp(-abs(tau))
    u, w = run.V * math.tanh(tau), run.V / math.sqrt(run.A) * 2 * decay / (1 + decay**2)
    th = float(run.heading(tau))
    sin, cos = math.sin(th), math.cos(th)
    place = run.skate(tau) + a * np.array([cos - 1, sin])
    return Motion(
        q=np.array([*place, th]),
        v=np.array([u * cos - a * w * sin, u * sin + a * w * cos, w]),
        lam=np.zeros(0),
        mu=np.array([-run.I / run.A * u * w]),
    )


def sketch(a: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: centre of mass and skate as ``points`` (2, 2), the body's outline and the blade as ``lines`` (6, 2,
    2) [m].
    """
    ahead = np.array([math.cos(q[2]), math.sin(q[2])])
    side, centre = np.array([-ahead[1], ahead[0]]), np.asarray(q[:2])
    skate = centre - a * ahead
    shape = a * np.array([[-1.3, -0.7], [0.5, -0.7], [1.3, 0.0], [0.5, 0.7], [-1.3, 0.7]])
    corners = centre + np.outer(shape[:, 0], ahead) + np.outer(shape[:, 1], side)
    blade = np.array([[skate - 0.3 * a * ahead, skate + 0.3 * a * ahead]])
    outline = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return {"points": np.array([centre, skate]), "lines": np.concatenate([outline, blade])}


def forward_speed(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Speed along the blade [m/s]."""
    return float(v[0] * np.cos(q[2]) + v[1] * np.sin(q[2]))


def problem(
    *,
    m: float = 1.0,
    I: float = 0.1,  # noqa: E741
    a: float = 0.2,
    u0: float = 0.5,
    w0: float = 2.0,
    t_end: float = 5.0,
) -> Problem:
    """Make the problem: the sleigh from the origin, heading along x, over [0, ``t_end``] [s].

    Parameters
    ----------
    m, I
        Mass [kg] and inertia about the centre of mass [kg m^2], above 0.
    a
        Skate to centre of mass [m], at least 0.001: the closed solution divides by it.
    u0
        Speed ahead at the start [m/s]; negative: the sleigh backs up and turns round.
    w0
        Turning rate at the start [rad/s], at least 0.001.
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "I": checked("I", I, above=0.0, unit="kg m^2"),
        "a": checked("a", a, at_least=1e-3, unit="m"),
    }
    u0, w0 = checked("u0", u0, unit="m/s"), checked("w0", w0, at_least=1e-3, unit="rad/s")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = (*values.values(), u0, w0) == (1.0, 0.1, 0.2, 0.5, 2.0)
    m, I, a = values.values()  # noqa: E741
    run = Run(I=I, a=a, A=(I + m * a**2) / m, u0=u0, w0=w0)
    rate = run.V / math.sqrt(run.A)
    return Problem(
        name="chaplygin_sleigh",
        system=ChaplyginSleigh(**values),
        t_span=(0.0, t_end),
        q0=np.zeros(3),
        v0=np.array([u0, a * w0, w0]),
        scales=Scales(
            q=np.array([run.V * t_end, run.V * t_end, math.sqrt(run.A) / a]),
            v=np.array([run.V, run.V, rate]),
            mu=I / run.A * run.V * rate,
        ),
        observables={"forward_speed": forward_speed},
        exact=functools.partial(exact, run),
        reference=load_reference("chaplygin_sleigh", t_end) if published else None,
        sketch=functools.partial(sketch, a),
        tags=("velocity-level",),
        good_for="asymptotic stability without friction: a method's damping must not be mistaken for the constraint's",
        source=SOURCE,
    )
