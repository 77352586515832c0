r"""N four-bar windows in a row that pass through positions where all bars are horizontal and the constraints lose rank.

Source: IFToMM library of computational benchmarks of multibody dynamics, problem A02 (N four-bar mechanism)::

      B0------B1------B2 ...  coupler j joins Bj and B(j+1)     uniform bars of mass m and length l: N + 1 cranks,
      |       |       |       crank i joins (i l, 0) and Bi     then N couplers
      | phi   |       |       gravity g downwards               q = (x, y, theta) of each bar: centre of mass [m],
      O       O       O                                         angle from the x axis [rad]; M = diag(m, m, m l^2 / 12)
     0        l      2 l ...                                    phi = pi/2 - theta_0: crank 0 from the upright

    0 = lower end of crank i - (i l, 0)             i = 0..N        2 (3 N + 1) equations [m] for 3 (2 N + 1)
    0 = left end of coupler j - B_j                 j = 0..N-1      coordinates
    0 = right end of coupler j - B_(j+1)            j = 0..N-1

It starts upright with the velocity ``speed`` of B0 along x.  On the smooth branch all cranks stay parallel,

    J l phi'' = c g sin phi,  J = (N + 1) / 3 + N,  c = (N + 1) / 2 + N,  B0 = l (sin phi, cos phi),

which turns over and over: with ``w^2 = c g / (J l)`` and ``Om^2 = phi'(0)^2 + 4 w^2``

    phi = pi + 2 am(Om t / 2 - K),   phi' = Om dn(Om t / 2 - K),   parameter 4 w^2 / Om^2.

At ``phi = pi/2 + n pi`` all bars are horizontal, the rank of g_q drops by N (14 to 12 for N = 2) and other branches
cross the smooth one: any window may go on as an antiparallelogram.  The equations do not say which one follows.  For
N = 1 the multipliers of the smooth branch stay bounded.  For N > 1 they have poles there: weight and inertia turn each
crank differently, and coupler j keeps them parallel by ``+-m g tan(phi) (j - (N - 1) / 2) / (2 (4 N + 1))`` along x at
its left and right end.  Solvers may stop, change branch or step across; a finer step is no safer.  SI units.
"""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
from scipy.special import ellipj, ellipkm1

from hhtbench.mechanics.lines import pin_lines
from hhtbench.mechanics.multibody.mechanism import Mechanism
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from problems._common import checked, load_reference, minimal

SOURCE = "IFToMM library of computational benchmarks, A02: N four-bar mechanism"
LARGE = 50  # windows from which the tag "large" is set: about 300 coordinates
SEPARATRIX = 1e-8  # 1 - parameter below which the elliptic functions in use switch to a limit: no closed solution then


def parallel_state(n: int, l: float, phi: float, rate: float) -> tuple[Vector, Vector]:  # noqa: E741
    """State ``q, v`` with all cranks at ``phi`` [rad] from upright, rotating with ``rate`` [rad/s]."""
    B = l * np.array([math.sin(phi), math.cos(phi)])
    velocity = l * rate * np.array([math.cos(phi), -math.sin(phi)])
    q, v = np.zeros((2 * n + 1, 3)), np.zeros((2 * n + 1, 3))
    q[: n + 1, 0], q[n + 1 :, 0] = l * np.arange(n + 1), l * (np.arange(n) + 0.5)
    q[: n + 1] += [B[0] / 2, B[1] / 2, math.pi / 2 - phi]
    q[n + 1 :, :2] += B
    v[: n + 1], v[n + 1 :, :2] = [velocity[0] / 2, velocity[1] / 2, -rate], velocity
    return q.ravel(), v.ravel()


def mechanism(
    *,
    n_windows: int = 2,
    m: float = 1.0,
    l: float = 1.0,  # noqa: E741
    g: float = 9.81,
    speed: float = 1.0,
) -> Mechanism:
    """Bodies ``crank 0``, ..., ``coupler 0``, ...; joints ``O0``, ... on the ground, ``left 0``, ..., ``right 0``, ..."""
    windows = Mechanism((0.0, -g), plane=True)
    bars = [f"crank {i}" for i in range(n_windows + 1)] + [f"coupler {j}" for j in range(n_windows)]
    states = (part.reshape(-1, 3) for part in parallel_state(n_windows, l, 0.0, speed / l))
    for bar, (*at, angle), (*velocity, rate) in zip(bars, *states, strict=True):
        windows.body(bar, m, m * l**2 / 12, at=at, turned=angle, velocity=velocity, rate=rate)
    for i in range(n_windows + 1):
        windows.revolute(f"O{i}", f"crank {i}", "ground", (i * l, 0.0))
    for side, end in enumerate(("left", "right")):
        for j in range(n_windows):
            windows.revolute(f"{end} {j}", f"coupler {j}", f"crank {j + side}", ((j + side) * l, l))
    return windows


def frequency_squared(n: int, l: float, g: float) -> float:  # noqa: E741
    """Squared circular frequency ``w^2 = c g / (J l)`` [1/s^2] of the parallel motion."""
    return 3 * (3 * n + 1) / (2 * (4 * n + 1)) * g / l


def parallel_multipliers(n: int, m: float, l: float, g: float, phi: float, rate: float) -> Vector:  # noqa: E741
    """``lam`` (2 (3 n + 1),) [N] on the smooth branch, from the balances of each bar."""
    sin, cos = math.sin(phi), math.cos(phi)
    turning = frequency_squared(n, l, g) * sin
    a = l * np.array([cos * turning - sin * rate**2, -sin * turning - cos * rate**2])  # of every B
    weight = np.array([0.0, m * g])
    axial = m * g * sin / cos / (2 * (4 * n + 1)) * (np.arange(n) - (n - 1) / 2)
    left, right = np.tile(-(m * a + weight) / 2, (n, 1)), np.tile(-(m * a + weight) / 2, (n, 1))
    left[:, 0] += axial
    right[:, 0] -= axial
    on_crank = np.zeros((n + 1, 2))
    on_crank[:-1] += left
    on_crank[1:] += right
    return np.concatenate([on_crank - weight - m * a / 2, left, right]).ravel()


def exact(n: int, m: float, l: float, g: float, speed: float, t: float) -> Motion:  # noqa: E741
    """Smooth branch at ``t`` [s]; the multipliers of n > 1 have poles where the bars are horizontal."""
    start, w2 = (speed / l) ** 2, frequency_squared(n, l, g)
    Om, beyond = math.sqrt(start + 4 * w2), start / (start + 4 * w2)
    _, _, dn, amplitude = ellipj(Om * t / 2 - float(ellipkm1(beyond)), 1 - beyond)
    phi, rate = math.pi + 2 * float(amplitude), Om * float(dn)
    q, v = parallel_state(n, l, phi, rate)
    return Motion(q=q, v=v, lam=parallel_multipliers(n, m, l, g, phi, rate), mu=np.zeros(0))


def bar_ends(l: float, q: Vector) -> tuple[Vector, Vector]:  # noqa: E741
    """Lower or left, and upper or right ends of every bar, (2 N + 1, 2) each [m]."""
    bars = q.reshape(-1, 3)
    arm = l / 2 * np.stack([np.cos(bars[:, 2]), np.sin(bars[:, 2])], axis=1)
    return bars[:, :2] - arm, bars[:, :2] + arm


def B0(l: float, t: float, q: Vector, v: Vector, lam: Vector) -> Vector:  # noqa: E741
    """Position (x, y) of the first free joint [m]."""
    return q[:2] + l / 2 * np.array([math.cos(q[2]), math.sin(q[2])])


def crank_angle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angle phi of crank 0 from upright [rad]."""
    return math.pi / 2 - float(q[2])


def crank_rate(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Angular velocity phi' of crank 0 [rad/s]."""
    return -float(v[2])


def sketch(l: float, q: Vector) -> dict[str, Vector]:  # noqa: E741
    """Drawing at ``q``: joints as ``points`` (2 N + 2, 2), bars and supports as ``lines`` (11 N + 10, 2, 2) [m]."""
    begins, ends = bar_ends(l, np.asarray(q))
    cranks = len(begins) // 2 + 1
    ground = [pin_lines((i * l, 0.0), 0.1 * l) for i in range(cranks)]
    lines = np.concatenate([np.stack([begins, ends], axis=1), *ground])
    return {"points": np.vstack([begins[:cranks], ends[:cranks]]), "lines": lines}


def problem(
    *,
    n_windows: int = 2,
    m: float = 1.0,
    l: float = 1.0,  # noqa: E741
    g: float = 9.81,
    speed: float = 1.0,
    t_end: float = 10.0,
) -> Problem:
    """Make the problem: the upright mechanism over [0, ``t_end``] [s]; the first singular position comes near 0.71 s.

    Parameters
    ----------
    n_windows
        N, at least 1.
    m, l
        Mass [kg] and length [m] of every bar, above 0.
    g
        Gravity [m/s^2], at least 0.
    speed
        Velocity of B0 along x at the start [m/s], above 0: upright at rest is an equilibrium.
    """
    n = positive_integer("n_windows", n_windows)
    values: dict[str, Any] = {
        "m": checked("m", m, above=0.0, unit="kg"),
        "l": checked("l", l, above=0.0, unit="m"),
        "g": checked("g", g, at_least=0.0, unit="m/s^2"),
    }
    m, l, g = values.values()  # noqa: E741
    speed, t_end = checked("speed", speed, above=0.0, unit="m/s"), checked("t_end", t_end, above=0.0, unit="s")
    fastest = math.sqrt((speed / l) ** 2 + 4 * frequency_squared(n, l, g))
    closed = (speed / l / fastest) ** 2 >= SEPARATRIX
    published = (*values.values(), speed) == (1.0, 1.0, 9.81, 1.0)
    return mechanism(n_windows=n, **values, speed=speed).problem(
        (0.0, t_end),
        name="four_bars",
        scales=Scales(
            q=np.tile([l, l, 1.0], 2 * n + 1),
            v=fastest * np.tile([l, l, 1.0], 2 * n + 1),
            lam=m * (g + l * fastest**2),
        ),
        observables={"B0": functools.partial(B0, l), "crank_angle": crank_angle, "crank_rate": crank_rate},
        exact=functools.partial(exact, n, m, l, g, speed) if closed else None,
        reference=load_reference(f"four_bars_n{n}", t_end) if published else None,
        sketch=functools.partial(sketch, l),
        minimal=minimal("upright_bars", n, m, l, g, speed),
        tags=("holonomic", "singular", "large") if n >= LARGE else ("holonomic", "singular"),
        good_for="Whether a solver survives rank loss of many constraints at once and keeps the cranks parallel afterwards.",
        source=SOURCE,
    )
