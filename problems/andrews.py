r"""Andrews' squeezing mechanism: seven bars, six loop equations, a constant drive torque, a mass matrix that moves.

Source: W. Schiehlen (ed.), Multibody Systems Handbook, Springer 1990; E. Hairer, G. Wanner, Solving
Ordinary Differential Equations II, Springer 1996, section VII.7; parameters and start as in "Andrews' squeezing
mechanism" of the Test Set for IVP Solvers (F. Mazzia, F. Iavernaro, C. Magherini, Bari)::

                                    C       q = (beta, Theta, gamma, Phi, delta, Omega, epsilon) [rad]
                                  ,'
          B------.__  3         ,' spring     crank 1 (beta) turns about O, driven by mom
           \        `--------D-'  (c0, l0)    coupler 2 (Theta) from K to P
            \           _.-'                  triangle 3 (gamma) turns about B, carries D and P
        H    \      _.-'                      5 (delta) turns about A, 4 (Phi) joins H and P
     5 .' `-. \ _.-'                          7 (epsilon) turns about A, 6 (Omega) joins J and P
      .'   4 `-P------------2---------K
     A      _.-'                   O-' 1
      `. _.-'  6
     7  J

    along 1, 2:  P = (rr cos beta - d cos(beta + Theta),  rr sin beta - d sin(beta + Theta)),  O = (0, 0)
    along 3:     P = B + (ss sin gamma,  -ss cos gamma)
    along 5, 4:  P = A + (zt cos delta + e sin(Phi + delta),  zt sin delta - e cos(Phi + delta))
    along 7, 6:  P = A + (u sin epsilon + zf cos(Omega + epsilon),  -u cos epsilon + zf sin(Omega + epsilon))

``M(q) v' = F(q, v) - g_q^T lam``.  The constraints are the first line for P less each of the other three.  F contains
the terms quadratic in v that belong to M(q).  SI units throughout.
"""

from __future__ import annotations

import functools
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import pin_lines, spring_lines
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Schiehlen (ed.), Multibody Systems Handbook, 1990; Test Set for IVP Solvers, Andrews' squeezing mechanism"

#: consistent start of the Test Set [rad]; the mechanism is at rest
START = (
    -0.0617138900142764496358948458001,
    0.0,
    0.455279819163070380255912382449,
    0.222668390165885884674473185609,
    0.487364979543842550225598953530,
    -0.222668390165885884674473185609,
    1.23054744454982119249735015568,
)
LAM_START = (98.5668703962410896057654982170, -6.12268834425566265503114393122, 0.0, 0.0, 0.0, 0.0)  #: [N], same source


class SqueezingMechanism(System):
    """Seven angles, six position constraints; lengths and forces carry the source's names."""

    m: Array = parameter((0.04325, 0.00365, 0.02373, 0.00706, 0.07050, 0.00706, 0.05498), doc="masses 1..7 [kg]")
    I: Array = parameter(  # noqa: E741
        (2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5), doc="inertias 1..7 [kg m^2]"
    )
    A: Array = parameter((-0.06934, -0.00227), doc="bearing of bodies 5 and 7, (xa, ya) [m]")
    B: Array = parameter((-0.03635, 0.03273), doc="bearing of body 3, (xb, yb) [m]")
    C: Array = parameter((0.014, 0.072), doc="fixed end of the spring, (xc, yc) [m]")
    c0: Array = parameter(4530.0, doc="stiffness of the spring [N/m]")
    l0: Array = parameter(0.07785, doc="free length of the spring [m]")
    mom: Array = parameter(0.033, doc="drive torque on the crank [N m]")
    d: Array = parameter(0.028, doc="length of the coupler 2 [m]")
    da: Array = parameter(0.0115, doc="body 2: joint to centre of mass [m]")
    e: Array = parameter(0.02, doc="length of body 4 [m]")
    ea: Array = parameter(0.01421, doc="body 4: P to centre of mass [m]")
    rr: Array = parameter(0.007, doc="length of the crank 1 [m]")
    ra: Array = parameter(0.00092, doc="body 1: bearing to centre of mass [m]")
    ss: Array = parameter(0.035, doc="body 3: B to P [m]")
    sa: Array = parameter(0.01874, doc="body 3: centre of mass, along [m]")
    sb: Array = parameter(0.01043, doc="body 3: centre of mass, across [m]")
    sc: Array = parameter(0.018, doc="body 3: B to D, along [m]")
    sd: Array = parameter(0.02, doc="body 3: B to D, across [m]")
    ta: Array = parameter(0.02308, doc="body 5: centre of mass, along [m]")
    tb: Array = parameter(0.00916, doc="body 5: centre of mass, across [m]")
    u: Array = parameter(0.04, doc="length of body 7 [m]")
    ua: Array = parameter(0.01228, doc="body 7: centre of mass, along [m]")
    ub: Array = parameter(0.00449, doc="body 7: centre of mass, across [m]")
    zf: Array = parameter(0.02, doc="length of body 6 [m]")
    zt: Array = parameter(0.04, doc="length of body 5 [m]")
    fa: Array = parameter(0.01421, doc="body 6: P to centre of mass [m]")

    def mass_matrix(self, t: Array, q: Array) -> Array:
        """Mass matrix: (7, 7) [kg m^2]: full 2x2 blocks for the pairs (1, 2), (4, 5), (6, 7), and M33."""
        m, I = self.m, self.I  # noqa: E741
        _, T, _, P, _, O, _ = q  # noqa: E741
        e, f = self.e - self.ea, self.zf - self.fa
        m22 = m[1] * self.da**2 + I[1]
        m12 = m22 - m[1] * self.da * self.rr * jnp.cos(T)
        m11 = 2 * m12 - m22 + m[0] * self.ra**2 + m[1] * self.rr**2 + I[0]
        m33 = m[2] * (self.sa**2 + self.sb**2) + I[2]
        m44 = m[3] * e**2 + I[3]
        m45 = m44 + m[3] * self.zt * e * jnp.sin(P)
        m55 = 2 * m45 - m44 + m[3] * self.zt**2 + m[4] * (self.ta**2 + self.tb**2) + I[4]
        m66 = m[5] * f**2 + I[5]
        m67 = m66 - m[5] * self.u * f * jnp.sin(O)
        m77 = 2 * m67 - m66 + m[5] * self.u**2 + m[6] * (self.ua**2 + self.ub**2) + I[6]
        rows = np.array([0, 0, 1, 1, 2, 3, 3, 4, 4, 5, 5, 6, 6])
        columns = np.array([0, 1, 0, 1, 2, 3, 4, 3, 4, 5, 6, 5, 6])
        entries = jnp.stack([m11, m12, m12, m22, m33, m44, m45, m45, m55, m66, m67, m67, m77])
        return jnp.zeros((7, 7)).at[rows, columns].set(entries)

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: drive torque, spring and the terms quadratic in v, (7,) [N m]."""
        _, T, g, P, _, O, _ = q  # noqa: E741
        vb, vT, _, vP, vd, vO, ve = v
        arm = self.spring_arm(g)
        stretch = self.spring_vector(g)
        length = jnp.sqrt(stretch @ stretch)
        pull = -self.c0 * (length - self.l0) / length * stretch
        crank = self.m[1] * self.da * self.rr * jnp.sin(T)
        left = self.m[3] * self.zt * (self.e - self.ea) * jnp.cos(P)
        right = self.m[5] * self.u * (self.zf - self.fa) * jnp.cos(O)
        return jnp.stack(
            [
                self.mom - crank * vT * (vT + 2 * vb),
                crank * vb**2,
                pull[1] * arm[0] - pull[0] * arm[1],
                left * vd**2,
                -left * vP * (vP + 2 * vd),
                -right * ve**2,
                right * vO * (vO + 2 * ve),
            ]
        )

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: three loops, (6,) [m]."""
        b, T, g, P, d, O, e = q  # noqa: E741
        x = self.rr * jnp.cos(b) - self.d * jnp.cos(b + T)
        y = self.rr * jnp.sin(b) - self.d * jnp.sin(b + T)
        (xa, ya), (xb, yb) = self.A, self.B
        return jnp.stack(
            [
                x - self.ss * jnp.sin(g) - xb,
                y + self.ss * jnp.cos(g) - yb,
                x - self.e * jnp.sin(P + d) - self.zt * jnp.cos(d) - xa,
                y + self.e * jnp.cos(P + d) - self.zt * jnp.sin(d) - ya,
                x - self.zf * jnp.cos(O + e) - self.u * jnp.sin(e) - xa,
                y - self.zf * jnp.sin(O + e) + self.u * jnp.cos(e) - ya,
            ]
        )

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy, spring, and the potential ``-mom beta`` of the constant torque [J]."""
        length = jnp.linalg.norm(self.spring_vector(q[2]))
        return v @ self.mass_matrix(t, q) @ v / 2 + self.c0 * (length - self.l0) ** 2 / 2 - self.mom * q[0]

    def spring_arm(self, g: Array) -> Array:
        """Vector from B to D (2,) [m]; ``g`` is the angle gamma."""
        cos, sin = jnp.cos(g), jnp.sin(g)
        return jnp.stack([self.sd * cos + self.sc * sin, self.sd * sin - self.sc * cos])

    def spring_vector(self, g: Array) -> Array:
        """Vector from C to D (2,) [m]; ``g`` is the angle gamma."""
        return self.spring_arm(g) + self.B - self.C


@functools.cache
def published_mechanism() -> SqueezingMechanism:
    """Return the mechanism with the source's lengths, made once."""
    return SqueezingMechanism()


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: joints as ``points`` (9, 2), bars, the spring and the supports as ``lines`` (57, 2, 2) [m]."""
    s = published_mechanism()
    A, B, C = np.asarray(s.A), np.asarray(s.B), np.asarray(s.C)
    b, _, g, _, d, _, e = np.asarray(q)
    joint1 = float(s.rr) * np.array([np.cos(b), np.sin(b)])
    P = B + float(s.ss) * np.array([np.sin(g), -np.cos(g)])
    D = B + np.asarray(s.spring_arm(g))
    joint5 = A + float(s.zt) * np.array([np.cos(d), np.sin(d)])
    joint7 = A + float(s.u) * np.array([np.sin(e), -np.cos(e)])
    O = np.zeros(2)  # noqa: E741
    bars = [(O, joint1), (joint1, P), (B, P), (B, D), (D, P), (A, joint5), (joint5, P), (A, joint7), (joint7, P)]
    ground = [pin_lines(fixed, 0.004) for fixed in (O, A, B, C)]
    lines = np.concatenate([bars, spring_lines(C, D, 5, 0.006), *ground])
    return {"points": np.array([O, A, B, C, D, P, joint1, joint5, joint7]), "lines": lines}


def spring_length(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Distance from C to D [m]."""
    return float(np.linalg.norm(published_mechanism().spring_vector(q[2])))


def problem(*, mom: float = 0.033, c0: float = 4530.0, l0: float = 0.07785, t_end: float = 0.03) -> Problem:
    """Make the problem: the mechanism from rest over [0, ``t_end``] [s]: 0.03 in the Test Set, 0.05 in the IFToMM library.

    The lengths are not offered here: another length needs another consistent start.

    Parameters
    ----------
    mom
        Drive torque [N m].
    c0, l0
        Stiffness [N/m], at least 0, and free length [m] of the spring, at least 0.
    """
    values: dict[str, Any] = {
        "mom": checked("mom", mom, unit="N m"),
        "c0": checked("c0", c0, at_least=0.0, unit="N/m"),
        "l0": checked("l0", l0, at_least=0.0, unit="m"),
    }
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    published = tuple(values.values()) == (0.033, 4530.0, 0.07785)
    return Problem(
        name="andrews",
        system=SqueezingMechanism(**values),
        t_span=(0.0, t_end),
        q0=np.array(START),
        v0=np.zeros(7),
        lam_guess=np.array(LAM_START),
        scales=Scales(
            q=np.array([10.0, 10.0, 1.0, 1.0, 1.0, 1.0, 1.0]),
            v=np.array([1000.0, 1000.0, 100.0, 100.0, 10.0, 100.0, 10.0]),
            lam=100.0,
        ),
        observables={"spring_length": spring_length},
        reference=load_reference("andrews", t_end) if published else None,
        sketch=sketch,
        tags=("holonomic", "variable mass"),
        good_for="fast turning mechanism with a mass matrix that moves; work against precision",
        source=SOURCE,
    )
