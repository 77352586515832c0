r"""Second test problem of Jay and Negrut: a pendulum held by a rotational spring and damper.

Source: L. O. Jay, D. Negrut, "Extensions of the HHT-alpha method to differential-algebraic equations in mechanics",
ETNA 26 (2007) 190-208, section 5, second problem::

      ---O---  pivot with spring k and damper c     q = (y1, y2, y3): centre of mass, angle from the y1 axis
          \  y3                                     M = diag(m, m, m L^2 / 3)
           \                                        F = (0, -m g, -c z3 - k (y3 - 3 pi / 2))
            o  centre of mass, L from the pivot     0 = y1 - L cos y3,   0 = y2 - L sin y3
             \
              rod of length 2 L, mass m

It starts hanging, ``y3 = 3 pi / 2``, with the rate z3.  Eliminating both multipliers gives

    (4 m L^2 / 3) y3'' + c y3' + k (y3 - 3 pi / 2) + m g L cos y3 = 0,

and the balance of forces ``lam1 = -m y1''``, ``lam2 = -m (g + y2'')``.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import chain, pin_lines
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked, load_reference, minimal

SOURCE = "Jay and Negrut, ETNA 26 (2007) 190-208, section 5, second problem"
REST_ANGLE = 1.5 * math.pi  # hanging [rad]
ORDER = 24  # of the Taylor series: near the cheapest for double precision
SERIES_REACH = math.exp(-2.0)  # share of the radius of convergence that one expansion serves: exp(-2 * 24) is below 1e-20


class Pendulum(System):
    """``q = (y1, y2, y3)`` [m, m, rad]; constant mass, two position constraints."""

    m: Array = parameter(5.0, doc="mass of the rod [kg]")
    L: Array = parameter(2.0, doc="pivot to centre of mass [m]")
    k: Array = parameter(3000.0, doc="rotational stiffness [N m/rad]")
    c: Array = parameter(100.0, doc="rotational damping [N m s/rad]")
    g: Array = parameter(9.81, doc="gravity [m/s^2]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: diagonal (3,) [kg, kg, kg m^2]."""
        return jnp.stack([self.m, self.m, self.m * self.L**2 / 3])

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: gravity, spring and damper, (3,)."""
        moment = -self.c * v[2] - self.k * (q[2] - REST_ANGLE)
        return jnp.stack([jnp.zeros_like(moment), -self.m * self.g, moment])

    def constraint(self, t: Array, q: Array) -> Array:
        """Position constraints: the centre of mass sits at L on the rod, (2,) [m]."""
        y1, y2, y3 = q
        return jnp.stack([y1 - self.L * jnp.cos(y3), y2 - self.L * jnp.sin(y3)])

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy, gravity and spring [J]."""
        kinetic = jnp.sum(self.mass_matrix * v**2) / 2
        return kinetic + self.m * self.g * q[1] + self.k * (q[2] - REST_ANGLE) ** 2 / 2


class Damped(Pendulum):
    """The pendulum with a damper, whose power is declared."""

    def power(self, t: Array, q: Array, v: Array, lam: Array, mu: Array) -> Array:
        """Power of the damper [W]."""
        return -self.c * v[2] ** 2


@functools.cache
def taylor_pieces(m: float, L: float, k: float, c: float, g: float, z3: float, t_end: float) -> tuple[Vector, Matrix]:
    """Taylor series of y3(t) over [0, ``t_end``], accurate to roundoff.

    The dense output of a Runge-Kutta code has two or three digits fewer.  The number of pieces grows with the
    frequency, ``sqrt(3 k / (4 m L^2))`` for a stiff spring.

    Returns
    -------
    starts
        (N,) times at which the pieces begin [s].
    series
        (N, ORDER + 1) coefficients: ``y3 = sum_i series[j, i] (t - starts[j])^i``.
    """
    inertia = 4 * m * L**2 / 3
    t, angle, rate = 0.0, REST_ANGLE, z3
    starts: list[float] = []
    series: list[Vector] = []
    while not starts or t < t_end:
        row = taylor_series(angle, rate, (k / inertia, c / inertia, m * g * L / inertia))
        starts.append(t)
        series.append(row)
        size = max(abs(row[ORDER]), abs(row[ORDER - 1]) ** (ORDER / (ORDER - 1)), 1e-300)
        h = min(SERIES_REACH * size ** (-1 / ORDER), t_end)
        t, angle, rate = t + h, float(np.polyval(row[::-1], h)), float(np.polyval(np.polyder(row[::-1]), h))
    return np.array(starts), np.array(series)


def taylor_series(angle: float, rate: float, weights: tuple[float, float, float]) -> Vector:
    """Coefficients (ORDER + 1,) of the solution of ``y'' = -w0 (y - 3 pi / 2) - w1 y' - w2 cos y``."""
    spring, damper, gravity = weights
    y, sine, cosine = np.zeros(ORDER + 1), np.zeros(ORDER + 1), np.zeros(ORDER + 1)
    y[0], y[1], sine[0], cosine[0] = angle, rate, math.sin(angle), math.cos(angle)
    for i in range(ORDER - 1):
        stretch = y[i] - REST_ANGLE if i == 0 else y[i]
        y[i + 2] = -(spring * stretch + damper * (i + 1) * y[i + 1] + gravity * cosine[i]) / ((i + 1) * (i + 2))
        slopes = np.arange(1, i + 2) * y[1 : i + 2]  # coefficients of y'; (sin y)' = y' cos y, (cos y)' = -y' sin y
        sine[i + 1] = slopes @ cosine[i::-1] / (i + 1)
        cosine[i + 1] = -slopes @ sine[i::-1] / (i + 1)
    return y


def exact(parameters: tuple[float, ...], t_end: float, t: float) -> Motion:
    """Solution at ``t`` in [0, ``t_end``] [s] for ``parameters`` = (m, L, k, c, g, z3); computed on first use."""
    roundoff = 1e-12 * t_end  # an integrator's last time may miss the end by the rounding of its sum
    if not -roundoff <= t <= t_end + roundoff:
        raise ProblemError(f"t must be in [0, {t_end:g}] [s], the span of the problem; got {t:g}.")
    m, L, k, c, g, _ = parameters
    starts, series = taylor_pieces(*parameters, t_end)
    piece = max(int(np.searchsorted(starts, t, side="right")) - 1, 0)
    coefficients, s = series[piece][::-1], t - starts[piece]
    angle, rate = np.polyval(coefficients, s), np.polyval(np.polyder(coefficients), s)
    acceleration = -(c * rate + k * (angle - REST_ANGLE) + m * g * L * math.cos(angle)) / (4 * m * L**2 / 3)
    along, across = L * np.array([math.cos(angle), math.sin(angle)]), L * np.array([-math.sin(angle), math.cos(angle)])
    lam = -m * (across * acceleration - along * rate**2 + np.array([0.0, g]))
    return Motion(q=np.append(along, angle), v=np.append(across * rate, rate), lam=lam, mu=np.zeros(0))


def sketch(L: float, q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: pivot and centre of mass as ``points`` (2, 2); rod, spring, support as ``lines`` (42, 2, 2) [m]."""
    end = 2 * L * np.array([np.cos(q[2]), np.sin(q[2])])
    turn = np.linspace(np.pi, q[2] + 4 * np.pi, 33)  # from the support, twice round, to the rod
    spiral = L * np.linspace(0.12, 0.3, 33)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
    lines = np.concatenate([[[[0.0, 0.0], end]], chain(spiral), pin_lines((0.0, 0.0), 0.2 * L, 1.0)])
    return {"points": np.array([[0.0, 0.0], q[:2]]), "lines": lines}


def angle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle of the rod [rad]."""
    return float(q[2])


def problem(
    *,
    m: float = 5.0,
    L: float = 2.0,
    k: float = 3000.0,
    c: float = 100.0,
    g: float = 9.81,
    z3: float = 10.0,
    t_end: float = 4.0,
) -> Problem:
    """Make the problem: the pendulum over [0, ``t_end``] [s].

    Parameters
    ----------
    m, L
        Mass [kg] and distance of the centre of mass from the pivot [m], above 0.
    k, c
        Rotational stiffness [N m/rad] and damping [N m s/rad], at least 0.
    g
        Gravity [m/s^2].
    z3
        Rate at the start [rad/s].
    """
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "L": checked("L", L, above=0.0, unit="m"),
        "k": checked("k", k, at_least=0.0, unit="N m/rad"),
        "c": checked("c", c, at_least=0.0, unit="N m s/rad"),
        "g": checked("g", g, unit="m/s^2"),
    }
    z3, t_end = checked("z3", z3, unit="rad/s"), checked("t_end", t_end, above=0.0, unit="s")
    parameters = (*values.values(), z3)
    published = parameters == (5.0, 2.0, 3000.0, 100.0, 9.81, 10.0)
    L = values["L"]
    return Problem(
        name="jay_negrut_pendulum",
        system=(Damped if values["c"] > 0 else Pendulum)(**values),
        t_span=(0.0, t_end),
        q0=np.array([0.0, -L, REST_ANGLE]),
        v0=np.array([L * z3, 0.0, z3]),
        scales=Scales(q=np.array([L, L, 1.0]), v=np.array([10 * L, 10 * L, 10.0]), lam=values["m"] * 100 * L),
        observables={"angle": angle},
        exact=functools.partial(exact, parameters, t_end),
        reference=load_reference("jay_negrut_pendulum", t_end) if published else None,
        sketch=functools.partial(sketch, L),
        minimal=minimal("paper_pendulum", values, REST_ANGLE, z3),
        tags=("holonomic",),
        good_for="the paper's own curves: orders, damping, multipliers with a stiff spring and damper",
        source=SOURCE,
    )
