r"""The chain of Fermi, Pasta, Ulam and Tsingou: equal masses, springs with a quadratic and a cubic term; no constraints.

Source: E. Fermi, J. Pasta, S. Ulam (computations by M. Tsingou), Studies of Nonlinear Problems, report LA-1940, Los Alamos
1955; both nonlinear terms at once::

    |                                    |     q_i: displacement of mass i [m], i = 1..N,  q_0 = q_(N+1) = 0
    |-/\/\-[ m ]-/\/\-[ m ]- ... --/\/\--|     d_i = q_(i+1) - q_i: stretch of spring i, i = 0..N
    |   0     1     1     2          N   |     pull T(d) = k d + alpha d^2 + beta d^3

    m q_i'' = T(d_i) - T(d_(i-1)),    energy = sum m q_i'^2 / 2 + sum k d^2 / 2 + alpha d^3 / 3 + beta d^4 / 4

The start is at rest in the slowest mode of the linear chain, ``q_i = amplitude sin(i pi / (N + 1))``.  The nonlinear terms
pass its energy on to a few higher modes and, after many periods, nearly all of it back.  No closed solution.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import chain, ground_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference

SOURCE = "Fermi, Pasta, Ulam (and Tsingou), Studies of Nonlinear Problems, LA-1940, Los Alamos 1955"
LARGE = 100  # masses from which the tag "large" is set: dense linear algebra stops being the best choice about here


class FputChain(System):
    """``q`` (N,): displacements [m]; scalar mass, nonlinear springs."""

    m: Array = parameter(1.0, doc="each mass [kg]")
    k: Array = parameter(1.0, doc="linear stiffness [N/m]")
    alpha: Array = parameter(0.25, doc="quadratic stiffness [N/m^2]")
    beta: Array = parameter(0.5, doc="cubic stiffness [N/m^3]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: scalar [kg]: the same for every coordinate."""
        return self.m

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: springs, (N,) [N]."""
        d = jnp.diff(jnp.pad(q, 1))
        return jnp.diff(d * (self.k + d * (self.alpha + d * self.beta)))

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy and springs [J]."""
        d = jnp.diff(jnp.pad(q, 1))
        return self.m * jnp.sum(v**2) / 2 + jnp.sum(d**2 * (self.k / 2 + d * (self.alpha / 3 + d * self.beta / 4)))


def mode_energy(j: int, m: float, k: float, t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Energy of mode ``j`` of the linear chain [J]; without the nonlinear terms each is constant."""
    n = len(q)
    phi = np.sin(np.arange(1, n + 1) * j * math.pi / (n + 1)) * math.sqrt(2 / (n + 1))
    stiffness = 4 * k * math.sin(j * math.pi / (2 * (n + 1))) ** 2
    return float(m * (phi @ v) ** 2 + stiffness * (phi @ q) ** 2) / 2


def check_bounded(q0: Vector, k: float, alpha: float, beta: float) -> None:
    """Raise if the start could break a spring: with beta = 0 each loses its restoring force beyond ``d = -k / alpha``."""
    if beta > 0 or alpha == 0:
        return
    d = np.diff(np.pad(q0, 1))
    energy, barrier = float(np.sum(k * d**2 / 2 + alpha * d**3 / 3)), k**3 / (6 * alpha**2)
    if energy >= barrier:
        raise ProblemError(
            f"amplitude must give less energy than one spring can hold without its cubic term, "
            f"k^3 / (6 alpha^2) = {barrier:g} [J]; got {energy:g}.  Take a smaller amplitude or beta above 0."
        )


def sketch(q: Vector) -> dict[str, Any]:
    """Drawing at ``q``: displacements drawn across the chain, masses at unit spacing: ``points`` (N, 2), ``lines`` (N +
    13, 2, 2) [m].

    The masses move along the chain; across it the travelling shape is seen.
    """
    n = len(q)
    joints = np.column_stack([np.arange(n + 2.0), np.pad(np.asarray(q), 1)])
    walls = [ground_lines((x, 0.5 * side), (x, -0.5 * side), 0.2) for x, side in ((0.0, 1), (n + 1.0, -1))]
    return {
        "points": joints[1:-1],
        "lines": np.concatenate([chain(joints), *walls]),
        "note": "displacements along the chain are drawn across it",
    }


def problem(
    *,
    n_masses: int = 8,
    m: float = 1.0,
    k: float = 1.0,
    alpha: float = 0.25,
    beta: float = 0.5,
    amplitude: float = 1.0,
    t_end: float = 100.0,
) -> Problem:
    """Make the problem: the chain from rest over [0, ``t_end``] [s].

    Parameters
    ----------
    n_masses
        N, at least 1.
    m, k
        Each mass [kg] and linear stiffness of each spring [N/m], above 0.
    alpha, beta
        Quadratic [N/m^2] and cubic [N/m^3] stiffness; beta at least 0.
    amplitude
        Of the slowest mode at the start [m], not 0; limited where ``beta`` is 0 and ``alpha`` is not.
    """
    n = positive_integer("n_masses", n_masses)
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "k": checked("k", k, above=0.0, unit="N/m"),
        "alpha": checked("alpha", alpha, unit="N/m^2"),
        "beta": checked("beta", beta, at_least=0.0, unit="N/m^3"),
    }
    amplitude, t_end = checked("amplitude", amplitude, unit="m"), checked("t_end", t_end, above=0.0, unit="s")
    if amplitude == 0:
        raise ProblemError("amplitude must not be 0 [m]: nothing would move; got 0.")
    q0 = amplitude * np.sin(np.arange(1, n + 1) * math.pi / (n + 1))
    m, k, alpha, beta = values.values()
    check_bounded(q0, k, alpha, beta)
    slowest = 2 * math.sqrt(k / m) * math.sin(math.pi / (2 * (n + 1)))
    published = (n, *values.values(), amplitude) == (8, 1.0, 1.0, 0.25, 0.5, 1.0)
    size = abs(amplitude)
    return Problem(
        name="fput_chain",
        system=FputChain(**values),
        t_span=(0.0, t_end),
        q0=q0,
        v0=np.zeros(n),
        scales=Scales(q=size, v=size * slowest),
        observables={f"mode_{j}_energy": functools.partial(mode_energy, j, m, k) for j in range(1, min(n, 4) + 1)},
        reference=load_reference("fput_chain", t_end) if published else None,
        sketch=sketch,
        tags=("unconstrained", "large") if n >= LARGE else ("unconstrained",),
        good_for="long nonlinear motion without constraints: how well the energy and its way through the modes are kept",
        source=SOURCE,
    )
