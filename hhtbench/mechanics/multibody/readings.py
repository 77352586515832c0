"""What a solution tells of joints, bodies and forces of a mechanism, by name."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.mechanics.forces import rates
from hhtbench.mechanics.multibody.drives import coordinates
from hhtbench.mechanics.multibody.motion import SLIDING, TURNING, moves
from hhtbench.mechanics.multibody.parts import GROUND, Joint
from hhtbench.mechanics.multibody.rows import Rows
from hhtbench.protocol.errors import ProblemError

RANK = 1e-9  # singular values below this part of the largest are zero


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
def _accelerations(system: Any, t: Any, q: Any, v: Any, Q: Any, signals: Any) -> Any:
    """Accelerations (k, n) under the reactions ``Q`` (k, n), with ``signals``: states and inputs."""

    def one(t: Any, q: Any, v: Any, Q: Any, x: Any, u: Any) -> Any:
        total, mass = system.force(t, q, v, x, u) + Q, system.mass_matrix
        return jnp.linalg.solve(mass(t, q), total) if callable(mass) else total / mass

    return jax.vmap(one)(t, q, v, Q, *signals)


@eqx.filter_jit
def _jacobians(system: Any, t: Any, q: Any, v: Any) -> Any:
    """Jacobians (k, m + p, n) of the position rows by q and of the velocity rows by v at k times."""
    found = [] if system.constraint is None else [jax.vmap(jax.jacfwd(system.constraint, 1))(t, q)]
    if system.velocity_constraint is not None:
        found.append(jax.vmap(jax.jacfwd(system.velocity_constraint, 2))(t, q, v))
    return jnp.concatenate(found, axis=1)


@eqx.filter_jit
def _coordinate(frame: Any, kind: str, rows: Rows, q: Any, v: Any) -> Any:
    """Coordinates (k, 1) and their rates at k times."""
    return jax.vmap(lambda q, v: rates(lambda y: coordinates(frame.placed(y), rows, (kind,)), q, v))(q, v)


@eqx.filter_jit
def _measured(system: Any, kind: str, q: Any, v: Any) -> Any:
    """Measures, their rates and tensions (k, j) of all elements of a kind at k times."""

    return jax.vmap(lambda q, v: system.measured(kind, q, v))(q, v)


@eqx.filter_jit
def _along_surface(system: Any, kind: str, function: str, q: Any, v: Any) -> Any:
    """Values (k, j, ...) of ``function`` of all contacts of a kind at k times: their friction or slip."""
    return jax.vmap(lambda q, v: getattr(system.elements[kind], function)(system.frame, q, v))(q, v)


def _cross(lever: Any, force: Any) -> Any:
    """Moments of forces, (..., 3) or in the plane (...)."""
    if lever.shape[-1] == 3:
        return np.cross(lever, force)
    return lever[..., 0] * force[..., 1] - lever[..., 1] * force[..., 0]


@eqx.filter_jit
def _along(function: str, frame: Any, q: Any, *v: Any) -> Any:
    return jax.vmap(getattr(frame, function))(q, *v)


def along(function: str, frame: Any, q: Any, *v: Any) -> Any:
    """Values (k, ...) of ``function`` of (q, v) at k times, in NumPy: JAX would compile every index."""
    return jax.tree.map(np.asarray, _along(function, frame, q, *v))


def coordinate_of(m: Any, kind: str, row: Any, q: Any, v: Any) -> tuple[Any, Any]:
    """Coordinate (k,) that ``row`` measures and its rate at states ``q, v`` (k, n)."""
    value, rate = _coordinate(m.frame, kind, m.arrays([row]), np.asarray(q, float), np.asarray(v, float))
    return np.asarray(value)[:, 0], np.asarray(rate)[:, 0]


class Reading:
    """Values at the times of a solution, (k, ...)."""

    def __init__(self, m: Any, solution: Any, what: str) -> None:
        self._what = what  #: kind and name, for messages
        self._m, self._solution, self.t = m, solution, np.asarray(solution.t)
        if not self.t.size:
            raise ProblemError(f"the solution has no rows to read: {solution.status.label}: {solution.message}")
        self._system = m.made or m.system()
        some, columns = self._of_own_phases(solution)
        self.t = self.t[some]
        rows = [sum(map(len, found.values())) for found in (m.rows_by_joint(), m.velocity_rows_by_joint())]
        sizes = {"q": m.frame.size * len(m.bodies), "lam": rows[0] + (0 if m.plane else len(m.bodies)), "mu": rows[1]}
        end = None if solution.layout is None else solution.layout.n
        given = {"q": solution.q[:, :end], "lam": solution.lam, "mu": solution.mu}
        found = {name: rows[some][:, : sizes[name] if columns else None] for name, rows in given.items()}
        if any(found[name].shape[1] != size for name, size in sizes.items()):
            raise ProblemError("the mechanism has other bodies or joints than the solution; read it before they are added.")
        found |= {"t": self.t, "v": solution.v[some][:, :end]}
        self._signals = solution.x[some], solution.u[some]
        self._state = tuple(np.asarray(found[name], float) for name in ("t", "q", "v", "lam", "mu"))

    def _of_own_phases(self, solution: Any) -> tuple[Any, bool]:
        """Rows of the phases in which the system is this mechanism's; whether the solution has columns of others, too."""
        if not solution.phases:
            return slice(None), False
        own = [
            np.arange(len(solution.t))[phase.rows]
            for phase in solution.phases
            if getattr(phase.system, "inner", phase.system) is self._m.made
        ]
        if not own:
            raise ProblemError("the solution has no phase of this mechanism's system: begin one by m.problem(...).system.")
        return np.concatenate(own), True

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        readings = ", ".join(one for one in dir(type(self)) if not one.startswith("_"))
        raise AttributeError(f"{self._what} has no {name}; it has {readings}.")

    @cached_property
    def _multipliers(self) -> tuple[Any, Any]:
        """Multipliers of the position and the velocity rows, of least norm where rows are redundant."""
        t, q, v, lam, mu = self._state
        if not self._m.mobility().redundant:
            return lam, mu
        left, sizes, _ = np.linalg.svd(np.asarray(_jacobians(self._system, t, q, v)), full_matrices=False)
        kept = left * (sizes > RANK * sizes[:, :1])[:, None]
        both = np.einsum("kij,klj,kl->ki", kept, kept, np.concatenate([lam, mu], axis=1))
        return both[:, : lam.shape[1]], both[:, lam.shape[1] :]

    def _all_reactions(self) -> Any:
        t, q, v, *_ = self._state
        return _generalised(self._system, t, q, v, *self._multipliers)[0]

    @cached_property
    def _placed(self) -> Any:
        return along("placed", self._m.frame, self._state[1])

    def _in(self, vector: Any, frame: str) -> Any:
        """Components of ``vector`` (k, d) in the frame of a body, or in space."""
        if frame in ("space", GROUND) or np.ndim(vector) == 1:
            return np.asarray(vector)
        if frame not in self._m.bodies:
            raise ProblemError(f"frame must be 'space' or a body: {', '.join(self._m.bodies)}; got {frame!r}.")
        return np.einsum("kab,ka->kb", self._placed.R[:, self._m.number(frame)], vector)


class JointReading(Reading):
    """Reaction, angle, travel and power of a joint or motor.

    Force and torque act on the second body, by the first, at the joint's point of the second.  Redundant joints: the least
    norm of all multipliers; ``shares_with`` names the joints among which the load could be shared otherwise.
    """

    def __init__(self, m: Any, solution: Any, joint: Joint) -> None:
        super().__init__(m, solution, f"{joint.kind} {joint.name!r}")
        self._joint = joint

    @cached_property
    def _reaction(self) -> tuple[Any, Any, Any]:
        """Forces at the centres of all bodies and of the ground and torques on them, (k, j + 1, d) each, and power (k,)."""
        m, joint = self._m, self._joint
        t, q, v, _, _ = self._state
        lam, mu = self._multipliers
        mine, moving = np.zeros(lam.shape[1]), np.zeros(mu.shape[1])
        mine[m.rows_by_joint()[joint.name]] = 1.0
        moving[m.velocity_rows_by_joint()[joint.name]] = 1.0
        Q, power = _generalised(self._system, t, q, v, lam * mine, mu * moving)
        force, torque = along("forces_of", m.frame, q, Q)
        return np.asarray(force), np.asarray(torque), power

    def _wrench(self, on: str | None) -> tuple[Any, Any]:
        """Force and torque on a body about the joint's point, (k, d) each."""
        m, x, joint = self._m, np.asarray(self._placed.x), self._joint
        force, torque, _ = self._reaction
        second = m.number(joint.second)
        point = x[:, second] + np.asarray(self._placed.R)[:, second] @ joint.points[1]
        lever = x[:, :-1] - point[:, None]
        torque = torque + _cross(lever, force)
        on = joint.second if on is None else on
        if on not in (partners := self._partners()):
            raise ProblemError(f"{self._what} acts on {' and '.join(partners)}; got on={on!r}.")
        if on == GROUND:  # it holds what the bodies do not balance
            return -np.sum(force, axis=1), -np.sum(torque, axis=1)
        return force[:, m.number(on)], torque[:, m.number(on)]

    def _partners(self) -> list[str]:
        """Names of the bodies that the joint's rows act on."""
        rows = [
            self._m.rows[name][i]
            for family, i in self._joint.rows
            for name in (family, f"{family} other")
            if name in self._m.rows
        ]
        return list(dict.fromkeys(body for row in rows for body in row.bodies))

    @property
    def shares_with(self) -> tuple[str, ...]:
        """Joints among which this joint's load could be shared otherwise; empty if its reaction is unique."""
        return next((names for names in self._m.mobility().sharing if self._joint.name in names), ())

    def force(self, frame: str = "space", *, on: str | None = None) -> Any:
        """Force (k, d) [N] on the second body, or on the body ``on``; in space or in the frame of a body."""
        return self._in(self._wrench(on)[0], frame)

    def torque(self, frame: str = "space", *, on: str | None = None) -> Any:
        """Torque (k, 3), in the plane (k,), [N m] on that body about the joint's point of the second."""
        return self._in(self._wrench(on)[1], frame)

    def power(self) -> Any:
        """Power (k,) [W] that a motor gives; 0 of other joints."""
        return np.asarray(self._reaction[2])

    @cached_property
    def _motion(self) -> Any:
        """Angles in (-pi, pi] in space, travels and rates of both (4, k)."""
        number = list(self._m.joints).index(self._joint.name)
        return [np.asarray(x[:, number]) for x in moves(self._m, *self._state[1:3])]

    def _expect(self, what: str, *kinds: str) -> None:
        if self._joint.base not in kinds:
            raise ProblemError(f"joint {self._joint.name!r} is {self._joint.base}: it has no {what}.")

    def angle(self) -> Any:
        """Angle (k,) [rad] from the drawn pose, with its turns: at the start by ``assemble``, between rows by the rates."""
        self._expect("angle", *TURNING)
        found, _, rate, _ = self._motion
        if self._m.plane:
            return found
        found = found + 2 * np.pi * np.asarray(self._system.turns)[list(self._m.joints).index(self._joint.name)]
        expected = np.diff(self.t) * (rate[1:] + rate[:-1]) / 2
        turns = np.round((expected - np.diff(found)) / (2 * np.pi))
        return found + np.concatenate([[0.0], 2 * np.pi * np.cumsum(turns)])

    def rate(self) -> Any:
        """Rate (k,) of the angle [rad/s] or, without an angle, of the travel [m/s]."""
        self._expect("rate", *TURNING, *SLIDING)
        return self._motion[2 if self._joint.base in TURNING else 3]

    def travel(self) -> Any:
        """Travel (k,) [m] along the axis."""
        self._expect("travel", *SLIDING)
        return self._motion[1]


class CoordinateReading(JointReading):
    """Angle or travel of one joint of a composite, whose reaction is that of the composite."""

    @cached_property
    def _motion(self) -> Any:
        kind, row = self._joint.measured
        value, rate = coordinate_of(self._m, kind, row, *self._state[1:3])
        return [value, value, rate, rate]

    def _expect(self, what: str, *kinds: str) -> None:
        kind = self._joint.measured[0]
        if (what == "travel") != (kind == "travel") and what != "rate":
            raise ProblemError(f"joint {self._joint.name!r} is a {self._joint.kind}: it has no {what}.")

    def _wrench(self, on: str | None) -> tuple[Any, Any]:
        raise ProblemError(f"joint {self._joint.name!r} is one of a composite; read the force of that.")


class BodyReading(Reading):
    """Pose, velocities, accelerations and energy of a body."""

    def __init__(self, m: Any, solution: Any, name: str) -> None:
        super().__init__(m, solution, f"body {name!r}")
        self._name, self._number = name, m.number(name)

    def position(self, local: Any = None) -> Any:
        """Centre of mass (k, d) [m], or the body's point ``local`` (d,) in its frame."""
        centre = self._placed.x[:, self._number]
        return np.asarray(centre if local is None else centre + self._placed.R[:, self._number] @ np.asarray(local))

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
        return _accelerations(self._system, t, q, v, self._all_reactions(), self._signals)

    def _part(self, v: Any) -> Any:
        return np.asarray(v).reshape(len(v), -1, self._m.frame.size)[:, self._number, : self._m.dimension]

    def _turning(self, v: Any, frame: str) -> Any:
        return self._in(along("rates", self._m.frame, self._state[1], v)[:, self._number], frame)


class SignalReading(Reading):
    """A state or a sampled input."""

    def __init__(self, m: Any, solution: Any, name: str) -> None:
        super().__init__(m, solution, f"{'state' if m.signals[name].every is None else 'input'} {name!r}")
        self._name = name

    def value(self) -> Any:
        """Its values (k, ...); an input at a sample is the new one."""
        x, u = self._signals
        return np.asarray(self._system.names.given(None, None, None, x.T, u.T)[self._name]).T


class ElementReading(Reading):
    """Measure, its rate and tension of a spring, torsion spring, bushing or contact."""

    def __init__(self, m: Any, solution: Any, element: Any) -> None:
        super().__init__(m, solution, f"{element.kind} {element.name!r}")
        self._element = element

    @cached_property
    def _found(self) -> tuple[Any, Any, Any]:
        kind, number = self._element.kind, self._element.number
        count = len(self._system.elements[kind].rows)
        value, rate, tension = (np.asarray(x) for x in _measured(self._system, kind, *self._state[1:3]))
        own = [x.reshape(len(x), count, -1)[:, number] for x in (value, rate, tension)]
        return tuple(x[:, 0] if x.shape[1] == 1 else x for x in own)  # type: ignore[return-value]

    def measure(self) -> Any:
        """Length, angle or gap (k,) [m, rad]; offsets of a bushing (k, 6), in the plane (k, 3)."""
        return self._found[0]

    def rate(self) -> Any:
        """Rate of the measure."""
        return self._found[1]

    def tension(self) -> Any:
        """Tension [N, N m]: above 0 it pulls; of a contact or tyre below 0."""
        return self._found[2]

    def friction(self) -> Any:
        """Force (k, d) [N] along the surface on the first body of a contact, or on the wheel of a tyre."""
        return self._along_surface("rubbing", "friction")

    def slip(self) -> Any:
        """Slip (k, 2) of a tyre along and across its rolling direction, in the plane (k,), see ``tyres.slip_force``."""
        return self._along_surface("slip", "slip")

    def _along_surface(self, function: str, what: str) -> Any:
        kind, elements = self._element.kind, self._system.elements[self._element.kind]
        if not hasattr(elements, function):
            raise ProblemError(f"{self._what} has no {what}.")
        return np.asarray(_along_surface(self._system, kind, function, *self._state[1:3]))[:, self._element.number]
