r"""A stiff chain of equal masses and springs between two walls; no constraints.

Source: textbook, for instance L. Meirovitch, Fundamentals of Vibrations, McGraw-Hill 2001 (modal analysis); the start
with one slow and one fast mode is the usual test of numerical damping of high frequencies::

    |                                    |     q_i: displacement of mass i [m], i = 1..N
    |-/\/\-[ m ]-/\/\-[ m ]- ... --/\/\--|     m q_i'' = k (q_(i-1) - 2 q_i + q_(i+1)),  q_0 = q_(N+1) = 0
    |   k     1     k     2          k   |

Modes ``phi_ji = sin(i j pi / (N + 1))``, frequencies ``w_j = 2 sqrt(k / m) sin(j pi / (2 (N + 1)))``.  Mode 1 is slow,
mode N the fastest, and the motion is the sum of these two alone:

    q = sum over j in (1, N) of phi_j / max|phi_j| (A_j cos(w_j t) + V_j sin(w_j t) / w_j).
"""

from __future__ import annotations

import functools
import itertools
import math

import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics.lines import box_lines, ground_lines, spring_lines
from hhtbench.protocol.arguments import Vector, positive_integer
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Motion, Problem
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import System, parameter
from problems._common import checked

SOURCE = "linear chain, modal analysis as in Meirovitch, Fundamentals of Vibrations, McGraw-Hill 2001"
LARGE = 100  # masses from which the tag "large" is set: dense linear algebra stops being the best choice about here


class OscillatorChain(System):
    """``q`` (N,): displacements [m]; scalar mass, linear springs."""

    m: Array = parameter(1.0, doc="each mass [kg]")
    k: Array = parameter(1e4, doc="stiffness of each of the N + 1 springs [N/m]")

    @property
    def mass_matrix(self) -> Array:
        """Mass matrix: scalar [kg]: the same for every coordinate."""
        return self.m

    def force(self, t: Array, q: Array, v: Array) -> Array:
        """Applied force: springs, (N,) [N]."""
        return self.k * jnp.diff(jnp.diff(jnp.pad(q, 1)))

    def energy(self, t: Array, q: Array, v: Array) -> Array:
        """Kinetic energy and springs [J]."""
        return (self.m * jnp.sum(v**2) + self.k * jnp.sum(jnp.diff(jnp.pad(q, 1)) ** 2)) / 2

    def invariants(self, t: Array, q: Array, v: Array) -> dict[str, Array]:
        """Invariants: energy held in mode 1 and in mode N [J]: each is conserved by itself."""
        n = q.shape[0]
        found = {}
        for name, j in (("slow_mode_energy", 1), ("fast_mode_energy", n)):
            phi = jnp.sin(jnp.arange(1, n + 1) * j * jnp.pi / (n + 1)) * jnp.sqrt(2 / (n + 1))
            stiffness = 4 * self.k * jnp.sin(j * jnp.pi / (2 * (n + 1))) ** 2
            found[name] = (self.m * (phi @ v) ** 2 + stiffness * (phi @ q) ** 2) / 2
        return found


def mode(n: int, j: int) -> Vector:
    """Shape (n,) of vibration mode ``j``, its largest entry scaled to 1."""
    shape = np.sin(np.arange(1, n + 1) * j * math.pi / (n + 1))
    return shape / np.abs(shape).max()


def frequency(n: int, j: int, m: float, k: float) -> float:
    """Circular frequency of mode ``j`` [rad/s]."""
    return 2 * math.sqrt(k / m) * math.sin(j * math.pi / (2 * (n + 1)))


def exact(n: int, m: float, k: float, start: tuple[tuple[float, float], tuple[float, float]], t: float) -> Motion:
    """Modal solution at ``t`` [s]; ``start`` holds (A, V) of mode 1 and of mode ``n``."""
    q, v = np.zeros(n), np.zeros(n)
    for j, (amplitude, speed) in zip((1, n), start, strict=True):
        w = frequency(n, j, m, k)
        cos, sin = math.cos(w * t), math.sin(w * t)
        q += mode(n, j) * (amplitude * cos + speed / w * sin)
        v += mode(n, j) * (speed * cos - amplitude * w * sin)
    return Motion(q=q, v=v, lam=np.zeros(0), mu=np.zeros(0))


def sketch(q: Vector) -> dict[str, Vector]:
    """Drawing at ``q``: masses at unit spacing as ``points`` (N, 2), springs, blocks and walls as ``lines`` (14 N + 22, 2,
    2) [m].
    """
    n = len(q)
    joints = np.column_stack([np.arange(n + 2) + np.pad(q, 1), np.zeros(n + 2)])
    gap, post = np.array([0.15, 0.0]), np.array([0.0, 0.3])
    springs = [spring_lines(a + gap, b - gap, 4, 0.25) for a, b in itertools.pairwise(joints)]
    blocks = [box_lines(joint, 0.3, 0.3) for joint in joints[1:-1]]
    left, right = joints[0] + gap, joints[-1] - gap
    walls = [ground_lines(left + post, left - post, 0.15), ground_lines(right - post, right + post, 0.15)]
    return {"points": joints[1:-1], "lines": np.concatenate([*springs, *blocks, *walls])}


def middle(t: float, q: Vector, v: Vector, lam: Vector) -> float:
    """Displacement of the middle mass [m]."""
    return float(q[q.size // 2])


def problem(
    *,
    n_masses: int = 8,
    m: float = 1.0,
    k: float = 1e4,
    slow: float = 1.0,
    fast: float = 0.01,
    slow_speed: float = 10.0,
    fast_speed: float = 1.0,
    t_end: float = 1.0,
) -> Problem:
    """Make the problem: the chain over [0, ``t_end``] [s].

    Parameters
    ----------
    n_masses
        N, at least 2.
    m, k
        Each mass [kg] and stiffness of each spring [N/m], above 0.
    slow, fast
        Amplitudes A_1 and A_N at the start [m].
    slow_speed, fast_speed
        Speeds V_1 and V_N at the start [m/s].
    """
    n = positive_integer("n_masses", n_masses)
    if n < 2:
        raise ProblemError(f"n_masses must be at least 2, for a slow and a fast mode; got {n}.")
    m, k = checked("m", m, above=0.0, unit="kg"), checked("k", k, above=0.0, unit="N/m")
    t_end = checked("t_end", t_end, above=0.0, unit="s")
    start = (
        (checked("slow", slow, unit="m"), checked("slow_speed", slow_speed, unit="m/s")),
        (checked("fast", fast, unit="m"), checked("fast_speed", fast_speed, unit="m/s")),
    )
    motion = functools.partial(exact, n, m, k, start)
    first = motion(0.0)
    return Problem(
        name="oscillator_chain",
        system=OscillatorChain(m=jnp.asarray(m), k=jnp.asarray(k)),
        t_span=(0.0, t_end),
        q0=first.q,
        v0=first.v,
        scales=Scales(q=1.0, v=max(frequency(n, 1, m, k), 1e-3)),
        observables={"middle": middle},
        exact=motion,
        sketch=sketch,
        tags=("unconstrained", "stiff", "large") if n >= LARGE else ("unconstrained", "stiff"),
        good_for="damping of fast vibrations, cost of an ODE without constraints, size",
        source=SOURCE,
    )
