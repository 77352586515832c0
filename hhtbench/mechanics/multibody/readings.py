"""What a solution tells of joints, bodies and forces of a mechanism, by name."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.mechanics import forces
from hhtbench.mechanics.multibody.parts import GROUND, Joint
from hhtbench.mechanics.multibody.rows import Rows, angles, travels, turning
from hhtbench.protocol.errors import ProblemError

RANK = 1e-9  # singular values below this part of the largest are zero


def _rows(m: Any, joint: Joint) -> Rows:
    """The joint's angle and travel as one row, in the frames of its bodies."""
    none = np.zeros((1, m.dimension))
    x, y, w = none, none, none
    if not m.plane:
        x, y = joint.frames[0].T[:2, None]
        w = joint.frames[1].T[:1]
    bodies = (m.number(joint.first),), (m.number(joint.second),)
    points = {"a": joint.points[0][None], "b": joint.points[1][None]}
    return Rows(first=bodies[0], second=bodies[1], laws=(None,), **points, u=x, w=w, y=y, value=[joint.drawn])


def angles_now(m: Any, joint: Joint, at: Any) -> Any:
    """Angle of a joint [rad] from the drawn pose; in space in (-pi, pi]."""
    return angles(at, _rows(m, joint))[0]


def travels_now(m: Any, joint: Joint, at: Any) -> Any:
    """Travel of a joint [m] along its axis, from its point of the first body to that of the second."""
    rows = _rows(m, joint)
    return travels(at, eqx.tree_at(lambda one: one.u, rows, jnp.asarray(joint.frames[0][:, -1][None])))[0]


def _rate_now(m: Any, joint: Joint, q: Any, v: Any) -> Any:
    """Rate of a joint [rad/s] about its axis."""
    rows = _rows(m, joint)
    axis = jnp.asarray(joint.frames[1][:, -1][None])
    return turning(m.frame, eqx.tree_at(lambda one: one.b, rows, axis), q, v)[0]


@eqx.filter_jit
def _generalised(system: Any, t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
    """Generalised reaction forces (k, n) of multipliers at k times, and their power (k,)."""

    def one(t: Any, q: Any, v: Any, lam: Any, mu: Any) -> Any:
        Q = jnp.zeros_like(q)
        if system.constraint is not None:
            Q = Q - jax.vjp(lambda y: system.constraint(t, y), q)[1](lam)[0]
        if system.velocity_constraint is not None:
            Q = Q - jax.vjp(lambda y: system.velocity_constraint(t, q, y), v)[1](mu)[0]
        return Q, Q @ v

    return jax.vmap(one)(t, q, v, lam, mu)


@eqx.filter_jit
def _accelerations(system: Any, t: Any, q: Any, v: Any, Q: Any) -> Any:
    """Accelerations (k, n) under the reactions ``Q`` (k, n)."""

    def one(t: Any, q: Any, v: Any, Q: Any) -> Any:
        total, mass = system.force(t, q, v) + Q, system.mass_matrix
        return jnp.linalg.solve(mass(t, q), total) if callable(mass) else total / mass

    return jax.vmap(one)(t, q, v, Q)


@eqx.filter_jit
def _jacobians(system: Any, t: Any, q: Any) -> Any:
    """Jacobians (k, m, n) of the position rows at k times."""
    return jax.vmap(jax.jacfwd(system.constraint, 1))(t, q)


@eqx.filter_jit
def _along(function: Any, frame: Any, q: Any, *v: Any) -> Any:
    """Values (k, ...) of ``function`` of (q, v) at k times."""
    return jax.vmap(getattr(frame, function))(q, *v)


class Reading:
    """Values at the times of a solution, (k, ...)."""

    def __init__(self, m: Any, solution: Any) -> None:
        self._m, self._solution, self.t = m, solution, np.asarray(solution.t)
        system = getattr(getattr(solution, "problem", None), "system", None)
        self._system = m.system() if system is None else system
        self._state = tuple(jnp.asarray(getattr(solution, name)) for name in ("t", "q", "v", "lam", "mu"))

    @cached_property
    def _multipliers(self) -> tuple[Any, Any]:
        """Multipliers of the position and the velocity rows, of least norm where rows are redundant."""
        t, q, _, lam, mu = self._state
        if not lam.shape[1] or not self._m.mobility().redundant:
            return lam, mu
        G = np.asarray(_jacobians(self._system, t, q))
        left, sizes, _ = np.linalg.svd(G, full_matrices=False)
        kept = left * (sizes > RANK * sizes[:, :1])[:, None]
        return jnp.einsum("kij,klj,kl->ki", kept, kept, lam), mu

    def _all_reactions(self) -> Any:
        t, q, v, *_ = self._state
        return _generalised(self._system, t, q, v, *self._multipliers)[0]

    @cached_property
    def _placed(self) -> Any:
        return _along("placed", self._m.frame, self._state[1])

    def _in(self, vector: Any, frame: str) -> Any:
        """Components of ``vector`` (k, d) in the frame of a body, or in space."""
        if frame in ("space", GROUND) or np.ndim(vector) == 1:
            return np.asarray(vector)
        if frame not in self._m.bodies:
            raise ProblemError(f"frame must be 'space' or a body: {', '.join(self._m.bodies)}; got {frame!r}.")
        return np.asarray(jnp.einsum("kab,ka->kb", self._placed.R[:, self._m.number(frame)], vector))


class JointReading(Reading):
    """Reaction, angle, travel and power of a joint or motor.

    Force and torque act on the second body, by the first, at the joint's point of the second.  Redundant joints: the least
    norm of all multipliers; ``shares_with`` names the joints among which the load could be shared otherwise.
    """

    def __init__(self, m: Any, solution: Any, joint: Joint) -> None:
        super().__init__(m, solution)
        self._joint = joint

    @cached_property
    def _reaction(self) -> tuple[Any, Any, Any]:
        """Force and torque on the second body about its point, (k, d) each, and power (k,)."""
        m, joint = self._m, self._joint
        t, q, v, _, _ = self._state
        lam, mu = self._multipliers
        mine, moving = np.zeros(lam.shape[1]), np.zeros(mu.shape[1])
        mine[m.rows_by_joint()[joint.name]] = 1.0
        moving[m.velocity_rows_by_joint()[joint.name]] = 1.0
        Q, power = _generalised(self._system, t, q, v, lam * mine, mu * moving)
        ground = joint.second == GROUND
        body, sign = m.number(joint.first if ground else joint.second), -1.0 if ground else 1.0
        force, torque = (x[:, body] * sign for x in _along("forces_of", m.frame, q, Q))
        at = self._placed
        point = at.x[:, m.number(joint.second)] + at.R[:, m.number(joint.second)] @ joint.points[1]
        lever = point - at.x[:, body]
        cross = jnp.cross(lever, force)
        return force, torque - cross, power

    @property
    def shares_with(self) -> tuple[str, ...]:
        """Joints among which this joint's load could be shared otherwise; empty if its reaction is unique."""
        return next((names for names in self._m.mobility().sharing if self._joint.name in names), ())

    def force(self, frame: str = "space") -> Any:
        """Force (k, d) [N] on the second body, in space or in the frame of a body."""
        return self._in(self._reaction[0], frame)

    def torque(self, frame: str = "space") -> Any:
        """Torque (k, 3), in the plane (k,), [N m] on the second body about the joint's point."""
        return self._in(self._reaction[1], frame)

    def power(self) -> Any:
        """Power (k,) [W] that a motor gives; 0 of other joints."""
        return np.asarray(self._reaction[2])

    def angle(self) -> Any:
        """Angle (k,) [rad] from the drawn pose; turns are counted, between rows by the rates."""
        found = np.asarray(jax.vmap(lambda at: angles_now(self._m, self._joint, at))(self._placed))
        if self._m.plane or found.size < 2:
            return found
        rate = self.rate()
        expected = np.diff(self.t) * (rate[1:] + rate[:-1]) / 2
        steps = np.diff(found)
        turns = np.round((expected - steps) / (2 * np.pi))
        return found + np.concatenate([[0.0], 2 * np.pi * np.cumsum(turns)])

    def rate(self) -> Any:
        """Rate (k,) [rad/s] of the second body about the axis."""
        _, q, v, _, _ = self._state
        return np.asarray(jax.vmap(lambda q, v: _rate_now(self._m, self._joint, q, v))(q, v))

    def travel(self) -> Any:
        """Travel (k,) [m] along the axis."""
        return np.asarray(jax.vmap(lambda at: travels_now(self._m, self._joint, at))(self._placed))


class BodyReading(Reading):
    """Pose, velocities, accelerations and energy of a body."""

    def __init__(self, m: Any, solution: Any, name: str) -> None:
        super().__init__(m, solution)
        self._name, self._number = name, m.number(name)

    def position(self, local: Any = None) -> Any:
        """Centre of mass (k, d) [m], or the body's point ``local`` (d,) in its frame."""
        centre = self._placed.x[:, self._number]
        return np.asarray(centre if local is None else centre + self._placed.R[:, self._number] @ jnp.asarray(local))

    def rotation(self) -> Any:
        """Rotation matrices (k, 3, 3); in the plane angles (k,) [rad]."""
        return np.asarray(self._placed.angle[:, self._number] if self._m.plane else self._placed.R[:, self._number])

    def velocity(self) -> Any:
        """Velocity of the centre (k, d) [m/s]."""
        return self._part(self._state[2])

    def rate(self, frame: str = "space") -> Any:
        """Angular velocity (k, 3), in the plane (k,), [rad/s]."""
        return self._turning(self._state[2], frame)

    def acceleration(self) -> Any:
        """Acceleration of the centre (k, d) [m/s^2], from the forces and reactions on it."""
        return self._part(self._accelerations)

    def angular_acceleration(self, frame: str = "space") -> Any:
        """Angular acceleration (k, 3), in the plane (k,), [rad/s^2]."""
        return self._turning(self._accelerations, frame)

    def kinetic_energy(self) -> Any:
        """Kinetic energy (k,) [J]."""
        body, v, w = self._m.bodies[self._name], self.velocity(), self.rate(self._name)
        turning = body.inertia * w**2 if self._m.plane else np.einsum("ka,ab,kb->k", w, body.inertia, w)
        return (body.mass * np.sum(v**2, axis=1) + turning) / 2

    @cached_property
    def _accelerations(self) -> Any:
        t, q, v, *_ = self._state
        return _accelerations(self._system, t, q, v, self._all_reactions())

    def _part(self, v: Any) -> Any:
        return np.asarray(v).reshape(len(v), -1, self._m.frame.size)[:, self._number, : self._m.dimension]

    def _turning(self, v: Any, frame: str) -> Any:
        return self._in(_along("rates", self._m.frame, self._state[1], v)[:, self._number], frame)


class ElementReading(Reading):
    """Measure, its rate and tension of a spring, torsion spring, bushing or contact."""

    def __init__(self, m: Any, solution: Any, element: Any) -> None:
        super().__init__(m, solution)
        self._element = element

    @cached_property
    def _found(self) -> tuple[Any, Any, Any]:
        kind, number = self._element.kind, self._element.number
        law, measure = self._system.elements[kind].law, self._system._measure(kind)

        def one(q: Any, v: Any) -> Any:
            value, rate = forces.rates(measure, q, v)
            return value, rate, law(value, rate)

        count = len(self._system.elements[kind].rows)
        value, rate, tension = (np.asarray(x) for x in jax.jit(jax.vmap(one))(*self._state[1:3]))
        own = [x.reshape(len(x), count, -1)[:, number] for x in (value, rate, tension)]
        return tuple(x[:, 0] if x.shape[1] == 1 else x for x in own)  # type: ignore[return-value]

    def measure(self) -> Any:
        """Length, angle or gap (k,) [m, rad]; offsets of a bushing (k, 6), in the plane (k, 3)."""
        return self._found[0]

    def rate(self) -> Any:
        """Rate of the measure."""
        return self._found[1]

    def tension(self) -> Any:
        """Tension [N, N m]: above 0 it pulls; of a contact below 0."""
        return self._found[2]


def tabulated(m: Any, solution: Any) -> dict[str, Any]:
    """Columns by name: centres of bodies; angles or travels, forces and torques of joints."""
    found: dict[str, Any] = {"t": np.asarray(solution.t)}

    def add(name: str, values: Any) -> None:
        if values.ndim == 1:
            found[name] = values
        else:
            found.update({f"{name}.{axis}": column for axis, column in zip("xyz", values.T, strict=False)})

    for name in m.bodies:
        add(name, BodyReading(m, solution, name).position())
    for name, joint in m.joints.items():
        reading = JointReading(m, solution, joint)
        if joint.kind in ("revolute", "cylindrical", "motor"):
            add(f"{name}.angle", reading.angle())
        if joint.kind in ("prismatic", "cylindrical"):
            add(f"{name}.travel", reading.travel())
        add(f"{name}.force", reading.force())
        add(f"{name}.torque", reading.torque())
    return found
