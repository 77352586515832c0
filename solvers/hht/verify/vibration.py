"""Vibrating systems whose tangential motion is one oscillator, stepped by the integrator itself, and its closed forms.

Each scene has one free direction ``u`` (n,) with u^T M u = 1.  The force along it is ``-w^2 y - 2 zeta w y'`` with
``y = u^T M q``; across it there is a force too, which reactions must take up.  The extended method then promises that
(y, h y', h^2 u^T M a) is advanced by the matrix (H18), constraints or not.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from hhtbench.arguments import Matrix, Vector
from hhtbench.protocol import System, parameter
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import solved, step_by_hand
from solvers.hht.verify.study import Method

STEP = 0.01  # h [s]; the matrix depends on w h alone
MASS = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.5]])
ROWS = np.array([[1.0, 2.0, -1.0], [0.5, -1.0, 1.0]])
ACROSS = (0.7, -0.4)  # force across the free direction per force along it, for each row of ROWS
AMPLITUDE = 1e-3  # [rad] of the bead: its square is far below the elongations that are measured
DIED_OUT = 20  # steps: the third root is below 1e-3 at w h <= 0.1

Spectrum = NDArray[np.complex128]


class Masses(System):
    """Masses on springs and dampers, and the constraints of a scene."""

    mass_matrix: Any = parameter(doc="[kg]")
    stiffness: Any = parameter(doc="[N/m]")
    damper: Any = parameter(doc="[N s/m]")
    constraint: Any = eqx.field(static=True, default=None)
    velocity_constraint: Any = eqx.field(static=True, default=None)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """(n,)."""
        return -(self.stiffness @ q) - self.damper @ v


CONSTRAINTS: dict[str, dict[str, Callable[..., Any]]] = {
    "oscillator": {},
    "guided": {"constraint": lambda t, q: ROWS @ q},
    "rolling": {"velocity_constraint": lambda t, q, v: ROWS @ v},
    "mixed": {"constraint": lambda t, q: ROWS[:1] @ q, "velocity_constraint": lambda t, q, v: ROWS[1:] @ v},
    "bead": {"constraint": lambda t, q: jnp.stack([(q @ q - 1.0) / 2.0])},
}


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A system up to frequency and damping, with its free direction."""

    name: str
    mass: Matrix  #: (n, n)
    free: Vector  #: (n,) u
    shape: Matrix  #: (n, n) of the stiffness for w = 1, and of the damper
    start: Vector  #: (n,) q at rest from which it is let go
    constraints: Mapping[str, Callable[..., Any]] = field(default_factory=dict)

    @property
    def along(self) -> Vector:
        """M u (n,): y = along @ q."""
        return self.mass @ self.free

    def integrator(self, method: Method, frequency: float, zeta: float = 0.0, kind: type[HHT] = HHT) -> HHT:
        """Of a ``kind``, for the system with w h = ``frequency`` and damping ratio ``zeta``, for steps of STEP."""
        omega = frequency / STEP
        stiffness, damper = omega**2 * self.shape, 2.0 * zeta * omega * self.shape
        return kind(Masses(mass_matrix=self.mass, stiffness=stiffness, damper=damper, **self.constraints), **method)


def make_scene(name: str) -> Scene:
    """One of CONSTRAINTS.

    The bead on a circle of 1 m is pulled to the vertical line through its centre.  The others with constraints have three
    coordinates and two rows.  Springs couple both ways with a coordinate that a position constraint holds.  A velocity
    constraint lets it drift by O(h^3) a step, so there the coupling goes one way, from y into the reaction.  The springs
    across are as stiff as those along: soft ones would drown in the roundoff of a stiffness of 1e16 in skew coordinates.
    """
    constraints = CONSTRAINTS[name]
    if name == "oscillator":
        one = np.ones((1, 1))
        return Scene(name=name, mass=one, free=one[0], shape=one, start=one[0])
    if name == "bead":
        start, free = np.array([np.sin(AMPLITUDE), -np.cos(AMPLITUDE)]), np.array([1.0, 0.0])
        return Scene(name=name, mass=np.eye(2), free=free, shape=np.diag(free), start=start, constraints=constraints)
    free = np.cross(*ROWS)
    free = free / np.sqrt(free @ MASS @ free)
    along = MASS @ free
    shape = np.outer(along, along) + ROWS.T @ ROWS + np.outer(ACROSS @ ROWS, along)
    if name != "rolling":
        shape = shape + ACROSS[0] * np.outer(along, ROWS[0])
    return Scene(name=name, mass=MASS, free=free, shape=shape, start=free, constraints=constraints)


def measured_matrix(scene: Scene, method: Method, frequency: float, zeta: float = 0.0, kind: type[HHT] = HHT) -> Matrix:
    """The (3, 3) map of (y, h y', h^2 u^T M a) made by one step of an integrator of a ``kind`` with w h = ``frequency``."""
    hht, u, along = scene.integrator(method, frequency, zeta, kind), scene.free, scene.along
    nothing = np.zeros(u.size)

    def end(q: Vector, v: Vector, a: Vector) -> Vector:
        hht.init_step(0.0, q, v, step=STEP)
        hht.restart(replace(hht.state, a=a, h=STEP))
        state = step_by_hand(scene.name, hht)
        return np.array([along @ state.q, STEP * (along @ state.v), STEP**2 * (along @ state.a)])

    return np.array([end(u, nothing, nothing), end(nothing, u / STEP, nothing), end(nothing, nothing, u / STEP**2)]).T


@dataclass(frozen=True)
class Swing:
    """How a vibration decays and how much too long its period is."""

    damping: float  #: ratio xi
    elongation: float  #: of the period 2 pi / w, relative


def measured_swing(scene: Scene, method: Method, frequency: float, periods: float) -> Swing:
    """That of the recurrence y2 = p y1 - d y0 which fits a run without dampers best, when its third root has died out."""
    steps = int(np.ceil(periods * 2.0 * np.pi / frequency))
    start = (0.0, steps * STEP), scene.start, np.zeros(scene.start.size)
    y = solved(scene.name, scene.integrator(method, frequency), *start, steps=steps).q[DIED_OUT:] @ scene.along
    (p, d), *_ = np.linalg.lstsq(np.stack([y[1:-1], -y[:-2]], axis=1), y[2:], rcond=None)
    return swing_of(np.roots([1.0, -p, d]).astype(np.complex128), frequency)


def closed_invariants(alpha: float, frequency: float, zeta: float) -> tuple[float, float, float]:
    """Trace, sum of principal minors and determinant in closed form, (H18) with (H3)."""
    a, o, e = alpha, frequency, 1.0 + alpha
    d = 4.0 + (1.0 - a) ** 2 * e * o**2 + 4.0 * zeta * o * e * (1.0 - 2.0 * a)
    trace = (8.0 + (3.0 * a**3 - a - 2.0) * o**2 - 12.0 * zeta * o * a * (1.0 + 2.0 * a)) / d
    minors = (4.0 + (3.0 * a**3 + 3.0 * a**2 + a + 1.0) * o**2 - 4.0 * zeta * o * (6.0 * a**2 + 3.0 * a + 1.0)) / d
    return trace, minors, a * o * (e**2 * o - 4.0 * zeta * (1.0 + 2.0 * a)) / d


def roots(alpha: float, frequency: float, zeta: float = 0.0) -> Spectrum:
    """The three eigenvalues in closed form, complex: roots of the characteristic polynomial of (H18)."""
    trace, minors, determinant = closed_invariants(alpha, frequency, zeta)
    return np.roots([1.0, -trace, minors, -determinant]).astype(np.complex128)


def swing_of(eigenvalues: Spectrum, frequency: float) -> Swing:
    """Damping ratio and elongation of the vibration with the given eigenvalues at w h = ``frequency``."""
    principal = np.log(max(eigenvalues, key=lambda root: root.imag))
    return Swing(float(-principal.real / abs(principal)), float(frequency / principal.imag - 1.0))


def series(alpha: float, frequency: float) -> Swing:
    """The leading terms of both in w h for zeta = 0, from the logarithm of the principal root of (H18)."""
    damping = -alpha * (1.0 + alpha) ** 2 * frequency**3 / 8.0
    return Swing(damping, frequency**2 * (2.0 - 6.0 * alpha - 9.0 * alpha**2) / 24.0)


def spectrum(matrix: Matrix) -> Spectrum:
    """Its eigenvalues, complex also where they are real."""
    return np.linalg.eigvals(matrix).astype(np.complex128)


def radius(eigenvalues: Spectrum) -> float:
    """Largest magnitude."""
    return float(np.max(np.abs(eigenvalues)))


def invariants_error(measured: Matrix, alpha: float, frequency: float, zeta: float = 0.0) -> float:
    """Largest error of trace, sum of principal minors and determinant (3, 3), each over the larger of one and its value."""
    a = measured
    minors = sum(a[i, i] * a[j, j] - a[i, j] * a[j, i] for i, j in ((0, 1), (0, 2), (1, 2)))
    found = float(np.trace(a)), float(minors), float(np.linalg.det(a))
    closed = closed_invariants(alpha, frequency, zeta)
    return max(abs(x - y) / max(1.0, abs(y)) for x, y in zip(found, closed, strict=True))
