"""Vibrating systems whose tangential motion is one oscillator, stepped by the integrator itself, and its closed forms.

Each scene has one free direction ``u`` (n,) with u^T M u = 1.  What the force does along it is
``-w^2 y - 2 zeta w y'`` with ``y = u^T M q``; across it there is a force too, which reactions must take up.  The
extended method then promises that (y, h y', h^2 u^T M a) is advanced by the matrix (H18), constraints or not; all closed
forms are those of its characteristic polynomial.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray
from scipy.special import ellipk

from hhtbench.arguments import Matrix, Vector
from hhtbench.protocol import System, parameter
from solvers.hht.solver import HHT
from solvers.hht.verify.measure import solved, step_by_hand
from solvers.hht.verify.study import Method

STEP = 0.01  # h [s]; the matrix knows w h alone
START = 0.2  # [s] where the driven scene has both a position and a velocity
MASS = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.5]])
ROWS = np.array([[1.0, 2.0, -1.0], [0.5, -1.0, 1.0]])
DRIVE = 1e-3  # [m]; springs stretched by w^2 times it leave their roundoff in every sum of forces
ACROSS = (0.7, -0.4)  # force across the free direction per force along it, for each row of ROWS
AMPLITUDE = 0.02  # [rad] of the bead; the next terms in it are 1e-4 of those of w h = 0.1

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


def guide(t: Any) -> Any:
    """Where the two guides of the driven scene are, (2,)."""
    return DRIVE * jnp.stack([jnp.cos(3.0 * t), jnp.sin(2.0 * t)])


CONSTRAINTS: dict[str, dict[str, Callable[..., Any]]] = {
    "guided": {"constraint": lambda t, q: ROWS @ q},
    "driven": {"constraint": lambda t, q: ROWS @ q - guide(t)},
    "rolling": {"velocity_constraint": lambda t, q, v: ROWS @ v},
    "mixed": {"constraint": lambda t, q: ROWS[:1] @ q, "velocity_constraint": lambda t, q, v: ROWS[1:] @ v},
    "bead": {"constraint": lambda t, q: jnp.stack([(q @ q - 1.0) / 2.0])},
}


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A system up to frequency and damping, with its free direction."""

    name: str
    mass: Matrix  #: (n, n)
    free: Vector  #: (n,) u, where it is let go
    shape: Matrix  #: (n, n) of the stiffness for w = 1, and of the damper
    constraints: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    at_rest: tuple[Vector, ...] | None = None  #: q, v (n,) at START with y = y' = 0; None: nothing moves there
    reading: Callable[[Matrix, Matrix], tuple[Vector, Vector]] | None = None  #: y, y' (k,) of q, v (k, n) if not along u
    stretch: float = 1.0  #: exact frequency over w

    @property
    def along(self) -> Vector:
        """M u (n,): y = along @ q."""
        return self.mass @ self.free

    @property
    def across(self) -> Vector:
        """A unit direction (n,) in which only a reaction acts."""
        normal = np.linalg.solve(self.mass, ROWS[0])
        return normal / np.linalg.norm(normal)

    def read(self, q: Matrix, v: Matrix) -> tuple[Vector, Vector]:
        """y and y' (k,) of q and v (k, n)."""
        return self.reading(q, v) if self.reading else (q @ self.along, v @ self.along)

    def integrator(self, method: Method, frequency: float, zeta: float = 0.0, kind: type[HHT] = HHT) -> HHT:
        """Of a ``kind``, for the system with w h = ``frequency`` and damping ratio ``zeta``, for steps of STEP."""
        omega = frequency / STEP
        stiffness, damper = omega**2 * self.shape, 2.0 * zeta * omega * self.shape
        return kind(Masses(mass_matrix=self.mass, stiffness=stiffness, damper=damper, **self.constraints), **method)


def make_scene(name: str) -> Scene:
    """The oscillator, a bead on a circle, or one of those with three coordinates; worker processes can be sent its name.

    The bead, on a circle of 1 m, is pulled to the vertical line through its centre; its period is ``4 K(sin^2 A) / w``.
    """
    if name == "oscillator":
        one = np.ones((1, 1))
        return Scene(name=name, mass=one, free=one[0], shape=one)
    if name != "bead":
        return _constrained(name)
    return Scene(
        name="bead on a circle",
        mass=np.eye(2),
        free=np.array([np.sin(AMPLITUDE), -np.cos(AMPLITUDE)]),
        shape=np.diag([1.0, 0.0]),
        constraints=CONSTRAINTS[name],
        reading=lambda q, v: (np.arctan2(q[:, 0], -q[:, 1]), v[:, 1] * q[:, 0] - v[:, 0] * q[:, 1]),
        stretch=np.pi / (2.0 * ellipk(np.sin(AMPLITUDE) ** 2)),
    )


def _constrained(name: str) -> Scene:
    """Three coordinates, two constraints.

    Springs couple both ways with a coordinate that a position constraint holds.  A velocity constraint lets it drift by
    O(h^3) a step, so there the coupling goes one way, from y into the reaction.  The springs across are as stiff as
    those along: soft ones would drown in the roundoff of a stiffness of 1e16 in skew coordinates.
    """
    free = np.cross(*ROWS)
    free = free / np.sqrt(free @ MASS @ free)
    along, at_rest = MASS @ free, None
    shape = np.outer(along, along) + ROWS.T @ ROWS + np.outer(ACROSS @ ROWS, along)
    if name != "rolling":
        shape = shape + ACROSS[0] * np.outer(along, ROWS[0])
    if name == "driven":
        held = np.linalg.solve(MASS, ROWS.T) @ np.linalg.inv(ROWS @ np.linalg.solve(MASS, ROWS.T))
        at_rest = tuple(held @ np.asarray(x) for x in jax.jvp(guide, (START,), (1.0,)))
    return Scene(name=name, mass=MASS, free=free, shape=shape, constraints=CONSTRAINTS[name], at_rest=at_rest)


def measured_matrix(scene: Scene, method: Method, frequency: float, zeta: float = 0.0, kind: type[HHT] = HHT) -> Matrix:
    """The (3, 3) map of (y, h y', h^2 u^T M a) made by one step of an integrator of a ``kind`` with w h = ``frequency``."""
    hht, u, along = scene.integrator(method, frequency, zeta, kind), scene.free, scene.along
    nothing = np.zeros(u.size)
    q, v = scene.at_rest or (nothing, nothing)

    def end(q: Vector, v: Vector, a: Vector) -> Vector:
        hht.init_step(START, q, v, step=STEP)
        hht.restart(replace(hht.state, a=a, h=STEP))
        state = step_by_hand(scene.name, hht)
        return np.array([along @ state.q, STEP * (along @ state.v), STEP**2 * (along @ state.a)])

    ends = np.array([end(q + u, v, nothing), end(q, v + u / STEP, nothing), end(q, v, u / STEP**2)])
    if scene.at_rest:  # the step is then an affine map; its constant part is where rest goes
        ends = ends - end(q, v, nothing)
    return ends.T


@dataclass(frozen=True)
class Swing:
    """How a vibration decays and how much too long its period is."""

    damping: float  #: ratio xi
    elongation: float  #: of the period 2 pi / w, relative


def measured_swing(scene: Scene, method: Method, frequency: float, zeta: float = 0.0, periods: float = 10) -> Swing:
    """Period from zero crossings of y, decay from the heights of its peaks, after the scene is let go at u."""
    steps = int(np.ceil(periods * 2.0 * np.pi / frequency))
    start = (0.0, steps * STEP), scene.free, np.zeros(scene.free.size)
    solution = solved(scene.name, scene.integrator(method, frequency, zeta), *start, steps=steps, t_eval=[steps * STEP])
    times = np.concatenate([[0.0], solution.steps_data.t])  # type: ignore[union-attr]
    y, rate = scene.read(*solution(times))
    crossings, peaks = _zeros(times, y), _zeros(times, rate)
    period = 2.0 * (crossings[-1] - crossings[0]) / (crossings.size - 1)
    decay = -np.polyfit(peaks, np.log(np.abs(scene.read(*solution(peaks))[0])), 1)[0]
    omega = scene.stretch * frequency / STEP
    return Swing(float(decay / np.hypot(decay, 2.0 * np.pi / period)), float(period * omega / (2.0 * np.pi) - 1.0))


def _zeros(times: Vector, values: Vector) -> Vector:
    """Where ``values`` (k,) change sign, straight lines between ``times`` (k,)."""
    before = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    share = values[before] / (values[before] - values[before + 1])
    return times[before] + share * (times[before + 1] - times[before])


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
