"""Small mechanisms with closed solutions, one for every kind of equation, and what holds along their motions.

What a solver is judged by is written here by hand in NumPy and shares no code with what solvers receive: a fault in derived
functions is seen like one in the solver.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.special import ellipj, ellipk

from hhtbench.arguments import Matrix, Vector
from hhtbench.protocol import Motion, NumpySystem, Problem, Scales, System, parameter

SPAN = (0.0, 1.5)  # [s]
UNIT = Scales()
CORRECTIONS = 4  # Newton's, onto the position constraints


class Equations(NamedTuple):
    """``mass vdot + rows^T multipliers = force`` and ``rows vdot + curvature = 0``; position constraints come first."""

    mass: Matrix  #: (n, n)
    force: Vector  #: (n,)
    rows: Matrix  #: (m + p, n)
    curvature: Vector  #: (m + p,)


class Levels(NamedTuple):
    """By how much a state is off the constraints."""

    position: Vector  #: (m,)
    velocity: Vector  #: (m + p,)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """A problem, and its equations once more."""

    problem: Problem
    equations: Callable[[float, Vector, Vector], Equations]
    levels: Callable[[float, Vector, Vector], Levels]

    def put_back(self, t: float, q: Vector, v: Vector) -> tuple[Vector, Vector]:
        """The nearest state on both levels of the constraints."""
        m = self.levels(t, q, v).position.size
        at, moved = np.array(q, dtype=np.float64), np.array(v, dtype=np.float64)
        for _ in range(CORRECTIONS if m else 0):
            at -= _least(self.equations(t, at, v).rows[:m], self.levels(t, at, v).position)
        moved -= _least(self.equations(t, at, v).rows, self.levels(t, at, v).velocity)
        return at, moved

    @property
    def name(self) -> str:
        """Of the problem."""
        return self.problem.name

    def multipliers(self, t: float, q: Vector, v: Vector) -> Vector:
        """(m + p,) at the acceleration level."""
        return multipliers(self.equations(t, q, v))

    def exact(self, t: float) -> Motion:
        """The closed solution."""
        if self.problem.exact is None:
            raise ValueError(f"{self.name} has no closed solution")
        return self.problem.exact(t)


def _least(rows: Matrix, misfit: Vector) -> Vector:
    """The shortest (n,) that ``rows`` (k, n) map to ``misfit`` (k,)."""
    return np.asarray(np.linalg.pinv(rows) @ misfit, dtype=np.float64)


def multipliers(e: Equations) -> Vector:
    """(m + p,): Schur complement of the KKT system."""
    if not e.rows.shape[0]:
        return np.zeros(0)
    schur = e.rows @ np.linalg.solve(e.mass, e.rows.T)
    right = e.rows @ np.linalg.solve(e.mass, e.force) + e.curvature
    return np.asarray(np.linalg.solve(schur, right), dtype=np.float64)


def make_scene(
    name: str,
    system: System | NumpySystem,
    motion: Callable[[float], tuple[Vector, Vector]],
    equations: Callable[[float, Vector, Vector], Equations],
    levels: Callable[[float, Vector, Vector], Levels],
    t_span: tuple[float, float] = SPAN,
    scales: Scales = UNIT,
) -> Scene:
    """A scene that starts on its closed ``motion``; the multipliers follow from the equations."""
    m = levels(t_span[0], *motion(t_span[0])).position.size

    def exact(t: float) -> Motion:
        q, v = motion(t)
        found = multipliers(equations(t, q, v))
        return Motion(q, v, found[:m], found[m:])

    start = exact(t_span[0])
    problem = Problem(name=name, system=system, t_span=t_span, q0=start.q, v0=start.v, exact=exact, scales=scales)
    return Scene(problem=problem, equations=equations, levels=levels)


# --- position constraints: a pendulum in a plane of space ---------------------------------------------------------------


class Pendulum(System):
    """A mass on a rod in a plane of space; every unit, the frame and the constraints' scale are parameters."""

    mass: Any = parameter(2.0, doc="[kg]")
    radius: Any = parameter(1.2, doc="[m]")
    gravity: Any = parameter((0.0, -9.81, 0.0), doc="[m/s^2]")
    normal: Any = parameter((0.0, 0.0, 1.0), doc="of the plane")
    centre: Any = parameter((0.0, 0.0, 0.0), doc="[m]")
    scale: Any = parameter(1.0, doc="of the constraints")

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Constant."""
        return self.mass * jnp.eye(3)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weight."""
        return self.mass * self.gravity

    def constraint(self, t: Any, q: Any) -> Any:
        """Rod and plane."""
        d = q - self.centre
        return self.scale * jnp.stack([(d @ d - self.radius**2) / 2, self.normal @ d])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic and potential energy."""
        return self.mass * (v @ v / 2 - self.gravity @ (q - self.centre))


class DeclaredPendulum(Pendulum):
    """The same with every derivative declared."""

    def force_jacobians(self, t: Any, q: Any, v: Any) -> Any:
        """The weight depends on nothing."""
        return jnp.zeros((3, 3)), jnp.zeros((3, 3))

    def constraint_jacobian(self, t: Any, q: Any) -> Any:
        """Directions of rod and normal."""
        return self.scale * jnp.stack([q - self.centre, self.normal])

    def constraint_time_derivative(self, t: Any, q: Any) -> Any:
        """Nothing moves."""
        return jnp.zeros(2)

    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """Centripetal."""
        return self.scale * jnp.stack([v @ v, 0.0])

    def reaction(self, t: Any, q: Any, lam: Any) -> Any:
        """Along rod and normal."""
        return -self.constraint_jacobian(t, q).T @ lam

    def reaction_jacobians(self, t: Any, q: Any, lam: Any) -> Any:
        """The rod's direction turns."""
        return -self.scale * lam[0] * jnp.eye(3), -self.constraint_jacobian(t, q).T


class RedundantPendulum(Pendulum):
    """The rod's row twice."""

    def constraint(self, t: Any, q: Any) -> Any:
        """The last row follows from the first."""
        rows = super().constraint(t, q)
        return jnp.append(rows, 2.0 * rows[0])


class HeavyingPendulum(Pendulum):
    """Its mass depends on time and place: in the multipliers, not in the motion."""

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Grows."""
        return (self.mass + q[0] + t) * jnp.eye(3)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weight."""
        return (self.mass + q[0] + t) * self.gravity

    energy: Any = None


@dataclass(frozen=True, kw_only=True)
class Frame:
    """Units, origin and axes in which a pendulum is described."""

    length: float = 1.0  #: how many new units are one metre
    mass: float = 1.0
    time: float = 1.0
    axes: Matrix | None = None  #: (3, 3) orthogonal; None: as they are
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: of the pendulum [new units]
    scale: float = 1.0  #: of the constraints

    def turned(self, x: Vector) -> Vector:
        """``x`` (3,) along the new axes."""
        return x if self.axes is None else self.axes @ x


AMPLITUDE = 1.1  # of the pendulum [rad]
RADIUS, MASS, GRAVITY = 1.2, 2.0, 9.81


def swing(t: float) -> tuple[float, float]:
    """Angle from below [rad] and its rate: sin(angle/2) = k cd(omega t, k^2), released at rest."""
    k, omega = np.sin(AMPLITUDE / 2), np.sqrt(GRAVITY / RADIUS)
    sn, cn, dn, _ = ellipj(omega * t, k**2)
    angle = 2 * np.arcsin(k * cn / dn)
    rate = -2 * k * omega * (1 - k**2) * sn / dn**2 / np.cos(angle / 2)
    return float(angle), float(rate)


PERIOD = 4 * float(ellipk(np.sin(AMPLITUDE / 2) ** 2)) / np.sqrt(GRAVITY / RADIUS)  # [s]


def pendulum(
    kind: type[Pendulum] = Pendulum,
    frame: Frame = Frame(),
    name: str = "position",
    t_span: tuple[float, float] = SPAN,
    start: float | None = None,
) -> Scene:
    """A pendulum seen from ``frame``, released at the time ``start`` [s], by default that of ``t_span``."""
    begin = t_span[0] if start is None else start
    per_time, origin = frame.length / frame.time, np.array(frame.origin)
    gravity = frame.turned(np.array([0.0, -GRAVITY, 0.0])) * per_time / frame.time
    normal, radius, mass = frame.turned(np.array([0.0, 0.0, 1.0])), RADIUS * frame.length, MASS * frame.mass
    fields = {"mass": mass, "radius": radius, "gravity": gravity, "normal": normal, "centre": origin, "scale": frame.scale}

    def motion(t: float) -> tuple[Vector, Vector]:
        angle, rate = swing((t - begin) / frame.time)
        along = np.array([np.sin(angle), -np.cos(angle), 0.0])
        across = np.array([np.cos(angle), np.sin(angle), 0.0])
        return origin + radius * frame.turned(along), RADIUS * per_time * rate * frame.turned(across)

    def weight(t: float, q: Vector) -> float:
        return float(mass + q[0] + t) if kind is HeavyingPendulum else mass

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        m = weight(t, q)
        rows = frame.scale * np.stack([q - origin, normal])
        return Equations(m * np.eye(3), m * gravity, rows, frame.scale * np.array([v @ v, 0.0]))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        d = q - origin
        return Levels(
            frame.scale * np.array([(d @ d - radius**2) / 2, normal @ d]), frame.scale * np.array([d @ v, normal @ v])
        )

    scales = Scales(q=frame.length, v=per_time, lam=abs(frame.mass / frame.time**2 / frame.scale))
    return make_scene(name, kind(**fields), motion, equations, levels, t_span, scales)


# --- rheonomic: a bead on a circle that grows and moves -----------------------------------------------------------------

TURN, GROWTH, DRIFT = 1.5, 0.3, 0.4  # [rad/s], [m/s], [m/s]


class MovingCircle(System):
    """A bead on a circle whose radius grows and whose centre moves; the constraint does work."""

    begin: Any = parameter(0.0, doc="time at which the radius is 1 m [s]")
    growth: Any = parameter(GROWTH, doc="[m/s]")
    drift: Any = parameter(DRIFT, doc="[m/s]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """None."""
        return jnp.zeros(2)

    def constraint(self, t: Any, q: Any) -> Any:
        """The circle."""
        s = t - self.begin
        return jnp.stack([((q[0] - self.drift * s) ** 2 + q[1] ** 2 - (1 + self.growth * s) ** 2) / 2])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic energy."""
        return v @ v / 2

    def power(self, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
        """That of the reaction."""
        s = t - self.begin
        return -lam[0] * ((q[0] - self.drift * s) * v[0] + q[1] * v[1])


def moving_circle(begin: float = 0.0) -> Scene:
    """From ``begin`` [s] on; the moment of momentum about the centre is kept."""

    def motion(t: float) -> tuple[Vector, Vector]:
        s = t - begin
        radius = 1 + GROWTH * s
        angle, rate = TURN * s / radius, TURN / radius**2
        normal, along = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
        shift = np.array([DRIFT, 0.0])
        return shift * s + radius * normal, shift + GROWTH * normal + radius * rate * along

    def relative(t: float, q: Vector, v: Vector) -> tuple[Vector, Vector, float]:
        shift = np.array([DRIFT, 0.0])
        return q - shift * (t - begin), v - shift, 1 + GROWTH * (t - begin)

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        d, u, _ = relative(t, q, v)
        return Equations(np.eye(2), np.zeros(2), d[None, :], np.array([u @ u - GROWTH**2]))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        d, u, radius = relative(t, q, v)
        return Levels(np.array([(d @ d - radius**2) / 2]), np.array([d @ u - radius * GROWTH]))

    system = MovingCircle(begin=begin)
    return make_scene("rheonomic", system, motion, equations, levels, (begin, begin + SPAN[1]))


# --- velocity constraints -----------------------------------------------------------------------------------------------


class Skate(System):
    """A plate that slides along its edge only, on a slope, and turns steadily."""

    slope: Any = parameter(2.0, doc="[m/s^2]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Weight along the slope."""
        return jnp.stack([self.slope, 0.0, 0.0])

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """No motion across the edge."""
        return jnp.stack([v[0] * jnp.sin(q[2]) - v[1] * jnp.cos(q[2])])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic and potential energy."""
        return v @ v / 2 - self.slope * q[0]


def skate() -> Scene:
    """The speed u along the edge obeys u' = 2 cos(phi), phi = TURN t."""

    def motion(t: float) -> tuple[Vector, Vector]:
        angle = TURN * t
        speed = 2 * np.sin(angle) / TURN
        q = np.array([np.sin(angle) ** 2 / TURN**2, (angle - np.sin(angle) * np.cos(angle)) / TURN**2, angle])
        return q, np.array([speed * np.cos(angle), speed * np.sin(angle), TURN])

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        s, c = np.sin(q[2]), np.cos(q[2])
        curvature = v[2] * (v[0] * c + v[1] * s)
        return Equations(np.eye(3), np.array([2.0, 0.0, 0.0]), np.array([[s, -c, 0.0]]), np.array([curvature]))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        return Levels(np.zeros(0), np.array([v[0] * np.sin(q[2]) - v[1] * np.cos(q[2])]))

    return make_scene("velocity", Skate(), motion, equations, levels)


PULL, SLIP = 3.0, 1.0  # of the nut [N], [m/s^2]; (PULL - SLIP) / 2 = 1 rad/s^2


class Screw(System):
    """A nut on a circle, turned by a velocity constraint with a slip that grows with time."""

    pull: Any = parameter(PULL, doc="[N]")
    slip: Any = parameter(SLIP, doc="[m/s^2]")

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Along the screw."""
        return jnp.stack([0.0, 0.0, self.pull])

    def constraint(self, t: Any, q: Any) -> Any:
        """The circle."""
        return jnp.stack([(q[0] ** 2 + q[1] ** 2 - 1.0) / 2])

    def velocity_constraint(self, t: Any, q: Any, v: Any) -> Any:
        """The nut rises as it turns, and slips."""
        return jnp.stack([v[2] + q[1] * v[0] - q[0] * v[1] - self.slip * t])


def screw() -> Scene:
    """phi'' = (PULL - SLIP) / 2."""
    rate = (PULL - SLIP) / 2

    def motion(t: float) -> tuple[Vector, Vector]:
        angle, turn = TURN * t + rate * t**2 / 2, TURN + rate * t
        c, s = np.cos(angle), np.sin(angle)
        return np.array([c, s, angle + SLIP * t**2 / 2]), np.array([-turn * s, turn * c, turn + SLIP * t])

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        rows = np.array([[q[0], q[1], 0.0], [q[1], -q[0], 1.0]])
        return Equations(np.eye(3), np.array([0.0, 0.0, PULL]), rows, np.array([v[0] ** 2 + v[1] ** 2, -SLIP]))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        across = v[2] + q[1] * v[0] - q[0] * v[1] - SLIP * t
        return Levels(np.array([(q[0] ** 2 + q[1] ** 2 - 1) / 2]), np.array([q[0] * v[0] + q[1] * v[1], across]))

    return make_scene("mixed", Screw(), motion, equations, levels)


# --- unconstrained ------------------------------------------------------------------------------------------------------

STIFFNESS, DAMPING, DRIVE, FREQUENCY = 9.0, 0.5, 2.0, 2.0
INERTIA = np.array([[2.0, 1.0], [1.0, 2.0]])
SHARES = np.array([1.0, -0.5])  # of the two coordinates in the drive


class Oscillator(System):
    """Two coordinates coupled by their masses, damped and driven."""

    stiffness: Any = parameter(STIFFNESS, doc="[1/s^2]")
    damping: Any = parameter(DAMPING, doc="[1/s]")
    drive: Any = parameter(DRIVE, doc="[m/s^2]")

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Full."""
        return jnp.asarray(INERTIA)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Springs, dampers and the drive."""
        drive = self.drive * jnp.cos(FREQUENCY * t) * jnp.asarray(SHARES)
        return INERTIA @ (drive - self.stiffness * q - self.damping * v)

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic and of the springs."""
        return (v @ INERTIA @ v + self.stiffness * (q @ INERTIA @ q)) / 2

    def power(self, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
        """Of dampers and drive."""
        drive = self.drive * jnp.cos(FREQUENCY * t) * jnp.asarray(SHARES)
        return v @ (INERTIA @ (drive - self.damping * v))


def oscillator(
    name: str = "unconstrained", stiffness: float = STIFFNESS, damping: float = DAMPING, free: float = 1.0
) -> Scene:
    """Every coordinate for itself: x'' + d x' + k x = A cos(w t), from x = 1 at rest; without ``free`` the forced motion.

    Overdamped without ``free`` only.
    """
    amplitude = DRIVE * stiffness / STIFFNESS  # so that what is stiff moves as far
    gain = amplitude * SHARES / ((stiffness - FREQUENCY**2) ** 2 + (damping * FREQUENCY) ** 2)
    in_phase, behind = gain * (stiffness - FREQUENCY**2), gain * damping * FREQUENCY
    decay, own = damping / 2, np.sqrt(abs(stiffness - damping**2 / 4))
    cosine = free * (1.0 - in_phase)
    sine = free * (decay * cosine - behind * FREQUENCY) / own

    def motion(t: float) -> tuple[Vector, Vector]:
        c, s, e = np.cos(own * t), np.sin(own * t), np.exp(-decay * t)
        wc, ws = np.cos(FREQUENCY * t), np.sin(FREQUENCY * t)
        q = e * (cosine * c + sine * s) + in_phase * wc + behind * ws
        free = e * (own * (sine * c - cosine * s) - decay * (cosine * c + sine * s))
        return q, free + FREQUENCY * (behind * wc - in_phase * ws)

    def equations(t: float, q: Vector, v: Vector) -> Equations:
        drive = amplitude * np.cos(FREQUENCY * t) * SHARES
        return Equations(INERTIA, INERTIA @ (drive - stiffness * q - damping * v), np.zeros((0, 2)), np.zeros(0))

    def levels(t: float, q: Vector, v: Vector) -> Levels:
        return Levels(np.zeros(0), np.zeros(0))

    return make_scene(name, Oscillator(stiffness=stiffness, damping=damping, drive=amplitude), motion, equations, levels)


SCENES: dict[str, Callable[[], Scene]] = {
    "unconstrained": oscillator,
    "position": pendulum,
    "declared": lambda: pendulum(DeclaredPendulum, name="declared"),
    "mass": lambda: pendulum(HeavyingPendulum, name="mass"),
    "rheonomic": moving_circle,
    "velocity": skate,
    "mixed": screw,
}


# --- plain functions ----------------------------------------------------------------------------------------------------

Function = Callable[..., Any]


def numpy_pendulum(t_span: tuple[float, float] = SPAN, **changes: Function | None) -> Scene:
    """The pendulum as plain callables, some of them replaced, or left out by None."""
    like = pendulum(t_span=t_span)
    pull = np.array([0.0, -GRAVITY, 0.0])
    functions: dict[str, Any] = {
        "force": lambda t, q, v: MASS * pull,
        "mass_matrix": lambda t, q: MASS * np.eye(3),
        "constraint": lambda t, q: np.array([(q @ q - RADIUS**2) / 2, q[2]]),
        "constraint_jacobian": lambda t, q: np.stack([q, [0.0, 0.0, 1.0]]),
        "constraint_time_derivative": lambda t, q: np.zeros(2),
        "constraint_acceleration": lambda t, q, v: np.array([v @ v, 0.0]),
        "force_jacobians": lambda t, q, v: (np.zeros((3, 3)), np.zeros((3, 3))),
    }
    system = NumpySystem(**{**functions, **changes})
    return make_scene("callables", system, lambda t: like.exact(t)[:2], like.equations, like.levels, t_span)
