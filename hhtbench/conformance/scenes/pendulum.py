"""Position constraints: a pendulum in a plane of space, traced, declared, and as plain functions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.special import ellipj, ellipk

from hhtbench.conformance.scenes.scene import SPAN, Equations, Levels, Scene, make_scene
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.scales import Scales
from hhtbench.protocol.system import NumpySystem, System, parameter


class Pendulum(System):
    """A mass on a rod in a plane of space; every unit, the frame and the constraints' scale are parameters."""

    mass: Any = parameter(2.0, doc="[kg]")
    radius: Any = parameter(1.2, doc="[m]")
    gravity: Any = parameter((0.0, -9.81, 0.0), doc="[m/s^2]")
    normal: Any = parameter((0.0, 0.0, 1.0), doc="of the plane")
    centre: Any = parameter((0.0, 0.0, 0.0), doc="[m]")
    scale: Any = parameter(1.0, doc="of the constraints")

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Mass matrix: constant."""
        return self.mass * jnp.eye(3)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: weight."""
        return self.mass * self.gravity

    def constraint(self, t: Any, q: Any) -> Any:
        """Position constraints: rod and plane."""
        d = q - self.centre
        return self.scale * jnp.stack([(d @ d - self.radius**2) / 2, self.normal @ d])

    def energy(self, t: Any, q: Any, v: Any) -> Any:
        """Kinetic and potential energy."""
        return self.mass * (v @ v / 2 - self.gravity @ (q - self.centre))


class DeclaredPendulum(Pendulum):
    """The pendulum with every derivative declared."""

    def force_jacobians(self, t: Any, q: Any, v: Any) -> Any:
        """Jacobians of the force, which are zero."""
        return jnp.zeros((3, 3)), jnp.zeros((3, 3))

    def constraint_jacobian(self, t: Any, q: Any) -> Any:
        """Constraint Jacobian: directions of rod and normal."""
        return self.scale * jnp.stack([q - self.centre, self.normal])

    def constraint_time_derivative(self, t: Any, q: Any) -> Any:
        """Time derivative of the constraints, which is zero."""
        return jnp.zeros(2)

    def constraint_acceleration(self, t: Any, q: Any, v: Any) -> Any:
        """Centripetal term of the constraints at the acceleration level."""
        return self.scale * jnp.stack([v @ v, 0.0])

    def reaction(self, t: Any, q: Any, lam: Any) -> Any:
        """Reaction force: along rod and normal."""
        return -self.constraint_jacobian(t, q).T @ lam

    def reaction_jacobians(self, t: Any, q: Any, lam: Any) -> Any:
        """Jacobians of the reaction by q and lam."""
        return -self.scale * lam[0] * jnp.eye(3), -self.constraint_jacobian(t, q).T


class HeavyingPendulum(Pendulum):
    """Pendulum whose mass depends on time and place, which changes its multipliers but not its motion."""

    def mass_matrix(self, t: Any, q: Any) -> Any:
        """Mass matrix: grows."""
        return (self.mass + q[0] + t) * jnp.eye(3)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        """Applied force: weight."""
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
        """Return ``x`` (3,) in the new axes."""
        return x if self.axes is None else self.axes @ x


AMPLITUDE = 1.1  # of the pendulum [rad]
RADIUS, MASS, GRAVITY = 1.2, 2.0, 9.81


def swing(t: float) -> tuple[float, float]:
    """Angle from below [rad] and its rate of the pendulum released at rest: sin(angle/2) = k cd(omega t, k^2)."""
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


Function = Callable[..., Any]


def numpy_pendulum(t_span: tuple[float, float] = SPAN, **changes: Function | None) -> Scene:
    """The pendulum as plain callables; ``changes`` replace some of them, or leave them out (None)."""
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
