"""Vibrating systems whose tangential motion is one oscillator, stepped by the integrator itself, and its closed forms.

Each scene has one free direction ``u`` (n,) with u^T M u = 1.  What the force does along it is
``-w^2 y - 2 zeta w y'`` with ``y = u^T M q``; across it there is a force too, which reactions must take up.  The
extended method then promises that (y, h y', h^2 u^T M a) is advanced by the matrix (H18), constraints or not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.protocol import System, parameter
from hhtbench.result import Solution, Status
from solvers.hht.solver import HHT
from solvers.hht.verify.closed import Swing

STEP = 0.01  # h [s]; the matrix knows w h alone
START = 0.2  # [s] where the driven scene has both a position and a velocity
MASS = np.array([[2.0, 0.3, 0.1], [0.3, 1.0, -0.2], [0.1, -0.2, 1.5]])
ROWS = np.array([[1.0, 2.0, -1.0], [0.5, -1.0, 1.0]])
DRIVE = 1e-3  # [m]; springs stretched by w^2 times it leave their roundoff in every sum of forces
ACROSS = (0.7, -0.4)  # force across the free direction per force along it, for each row of ROWS


class Free(System):
    """Masses on springs and dampers."""

    mass_matrix: Any = parameter(doc="[kg]")
    stiffness: Any = parameter(doc="[N/m]")
    damper: Any = parameter(doc="[N s/m]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """(n,)."""
        return -(self.stiffness @ q) - self.damper @ v


class Guided(Free):
    """The same, guided by position constraints."""

    rows: Any = parameter(ROWS)

    def constraint(self, t: Any, q: Any) -> Any:
        """(2,)."""
        return self.rows @ q


class Driven(Guided):
    """The same with guides that move."""

    def constraint(self, t: Any, q: Any) -> Any:
        """(2,)."""
        return self.rows @ q - guide(t)


class Rolling(Free):
    """The same, guided by velocity constraints."""

    rows: Any = parameter(ROWS)

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """(2,)."""
        return self.rows @ v


class Mixed(Free):
    """One constraint of each kind."""

    rows: Any = parameter(ROWS)

    def constraint(self, t: Any, q: Any) -> Any:
        """(1,)."""
        return self.rows[:1] @ q

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """(1,)."""
        return self.rows[1:] @ v


def guide(t: Any) -> Any:
    """Where the two guides of :class:`Driven` are, (2,)."""
    return DRIVE * jnp.stack([jnp.cos(3.0 * t), jnp.sin(2.0 * t)])


def guide_rate(t: float) -> Vector:
    """Its derivative by time, (2,)."""
    return DRIVE * np.array([-3.0 * np.sin(3.0 * t), 2.0 * np.cos(2.0 * t)])


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A system up to frequency and damping, with its free direction."""

    name: str
    kind: type[Free]
    mass: Matrix  #: (n, n)
    free: Vector  #: (n,) u
    shape: Matrix  #: (n, n) of the stiffness for w = 1, and of the damper
    at_rest: tuple[Vector, Vector]  #: q, v (n,) at START with y = y' = 0

    @property
    def along(self) -> Vector:
        """M u (n,): y = along @ q."""
        return self.mass @ self.free

    @property
    def across(self) -> Vector:
        """A unit direction (n,) in which only a reaction acts."""
        normal = np.linalg.solve(self.mass, ROWS[0])
        return normal / np.linalg.norm(normal)

    def system(self, omega: float, zeta: float) -> Free:
        """The system with frequency ``omega`` [rad/s] and damping ratio ``zeta``."""
        return self.kind(mass_matrix=self.mass, stiffness=omega**2 * self.shape, damper=2.0 * zeta * omega * self.shape)


def oscillator() -> Scene:
    """One mass, no constraint."""
    one, nothing = np.ones((1, 1)), np.zeros(1)
    return Scene(name="oscillator", kind=Free, mass=one, free=one[0], shape=one, at_rest=(nothing, nothing))


def pair() -> Scene:
    """Two masses that know nothing of each other, let go together: frequencies w and 2 w in one run."""
    eye = np.eye(2)
    return Scene(
        name="pair", kind=Free, mass=eye, free=np.ones(2), shape=np.diag([1.0, 4.0]), at_rest=(eye[0] * 0, eye[0] * 0)
    )


def constrained(name: str, kind: type[Free]) -> Scene:
    """Three coordinates, two constraints of ``kind``.

    Springs couple both ways with a coordinate that a position constraint holds.  A velocity constraint lets it drift by
    O(h^3) a step, so there the coupling goes one way, from y into the reaction.  The springs across are as stiff as
    those along: soft ones would drown in the roundoff of a stiffness of 1e16 in skew coordinates.
    """
    free = np.cross(*ROWS)
    free = free / np.sqrt(free @ MASS @ free)
    along = MASS @ free
    shape = np.outer(along, along) + ROWS.T @ ROWS + np.outer(ACROSS @ ROWS, along)
    if kind is not Rolling:
        shape = shape + ACROSS[0] * np.outer(along, ROWS[0])
    nothing = np.zeros(3)
    at_rest = (nothing, nothing)
    if kind is Driven:
        held = np.linalg.solve(MASS, ROWS.T) @ np.linalg.inv(ROWS @ np.linalg.solve(MASS, ROWS.T))
        at_rest = (held @ np.asarray(guide(START)), held @ guide_rate(START))
    return Scene(name=name, kind=kind, mass=MASS, free=free, shape=shape, at_rest=at_rest)


def measured_matrix(scene: Scene, method: dict[str, Any], frequency: float, zeta: float) -> Matrix:
    """The (3, 3) map of (y, h y', h^2 u^T M a) made by one step with w h = ``frequency``."""
    hht = HHT(scene.system(frequency / STEP, zeta), **method)
    q, v = scene.at_rest
    u, nothing = scene.free, np.zeros(scene.free.size)
    ends = np.array(
        [
            _end(hht, scene, q + u, v, nothing),
            _end(hht, scene, q, v + u / STEP, nothing),
            _end(hht, scene, q, v, u / STEP**2),
        ]
    )
    if np.any(q) or np.any(v):  # the step is then an affine map; its constant part is where rest goes
        ends = ends - _end(hht, scene, q, v, nothing)
    return ends.T


def _end(hht: HHT, scene: Scene, q: Vector, v: Vector, a: Vector) -> Vector:
    hht.init_step(START, q, v, step=STEP)
    hht.restart(replace(hht.state, a=a, h=STEP))
    take_step(hht, scene.name)
    state, along = hht.state, scene.along
    return np.array([along @ state.q, STEP * (along @ state.v), STEP**2 * (along @ state.a)])


def take_step(hht: HHT, name: str) -> None:
    """One step.

    Raises
    ------
    RuntimeError
        It failed: a verification has nothing to measure then.
    """
    if hht.step() is not Status.success:
        raise RuntimeError(f"{name}: {hht.message}")


Reading = Callable[[Matrix, Matrix], tuple[Vector, Vector]]  # y and y' (k,) of q and v (k, n)


def long_run(scene: Scene, method: dict[str, Any], frequency: float, zeta: float, periods: float) -> Solution:
    """``periods`` of the vibration let go at q = u, with w h = ``frequency``."""
    steps = int(np.ceil(periods * 2.0 * np.pi / frequency))
    hht = HHT(scene.system(frequency / STEP, zeta), **method)
    return run(hht, scene.free, np.zeros(scene.free.size), steps, scene.name)


def run(hht: HHT, q: Vector, v: Vector, steps: int, name: str) -> Solution:
    """``steps`` steps of STEP from t = 0.

    Raises
    ------
    RuntimeError
        They failed: a verification has nothing to measure then.
    """
    end = steps * STEP
    solution = hht.solve((0.0, end), q, v, steps=steps, t_eval=[end])
    if not solution.success:
        raise RuntimeError(f"{name}: {solution.message}")
    return solution


def read_swing(solution: Solution, reading: Reading, omega: float) -> Swing:
    """Period from zero crossings of y, decay from the heights of its peaks; ``omega`` [rad/s] is the exact frequency."""
    times = np.concatenate([[0.0], solution.steps_data.t])  # type: ignore[union-attr]
    rows = solution(times)
    y, rate = reading(rows.q, rows.v)
    crossings = _zeros(times, y)
    period = 2.0 * (crossings[-1] - crossings[0]) / (crossings.size - 1)
    peaks = _zeros(times, rate)
    at_peaks = solution(peaks)
    heights = np.abs(reading(at_peaks.q, at_peaks.v)[0])
    decay = -np.polyfit(peaks, np.log(heights), 1)[0]
    return Swing(float(decay / np.hypot(decay, 2.0 * np.pi / period)), float(period * omega / (2.0 * np.pi) - 1.0))


def _zeros(times: Vector, values: Vector) -> Vector:
    """Where ``values`` (k,) change sign, straight lines between ``times`` (k,)."""
    before = np.flatnonzero(values[:-1] * values[1:] < 0.0)
    share = values[before] / (values[before] - values[before + 1])
    return times[before] + share * (times[before + 1] - times[before])
