"""Mechanisms of rigid bodies, described by names of bodies, joints and forces."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from importlib import import_module
from typing import Any

import equinox as eqx
import numpy as np

from hhtbench.mechanics.lines import chain
from hhtbench.mechanics.multibody import assembly, motion, starts
from hhtbench.mechanics.multibody.drives import Couples, Drives, Swivels
from hhtbench.mechanics.multibody.elements import Contacts, Loads, Springs, Tyres
from hhtbench.mechanics.multibody.forces import column
from hhtbench.mechanics.multibody.frames import quaternion
from hhtbench.mechanics.multibody.parts import GROUND
from hhtbench.mechanics.multibody.readings import BodyReading, CoordinateReading, ElementReading, JointReading, SignalReading
from hhtbench.mechanics.multibody.rows import Curves, Gears, Rolling, of_time
from hhtbench.mechanics.multibody.signals import OWN, Signals
from hhtbench.mechanics.multibody.system import ALL_FAMILIES, MEASURED, Multibody
from hhtbench.mechanics.multibody.table import tabulated
from hhtbench.protocol.errors import ProblemError, did_you_mean
from hhtbench.protocol.problem import Problem

APART = 1e8  # ratio of masses beyond which one of them is likely in another unit


class Mechanism(Signals):
    """Bodies, joints and forces by name, which become a :class:`~hhtbench.protocol.problem.Problem` for every solver.

    Coordinates are absolute: 7 of every body in space, 3 with ``plane=True``, where planar mechanisms belong: in space their
    joints have redundant rows.  Angles and travels of joints are zero in the drawn pose.  ``invariants`` maps names to
    functions of (system, q, v), defined in a module, that stay constant: their drift is measured.
    """

    def __init__(self, gravity: Any = None, *, plane: bool = False) -> None:
        """``gravity`` (d,) [m/s^2]; if not given 9.81 along the last axis, downward."""
        super().__init__(plane=plane)
        down = -9.81 * np.eye(self.dimension)[-1]
        self.made: Multibody | None = None  #: system of the latest problem, which solutions are read by
        self.gravity = down if gravity is None else self._vector("gravity", gravity)
        self.invariants: dict[str, Callable[[Multibody, Any, Any], Any]] = {}

    @classmethod
    def from_mjcf(
        cls, path: Any, *, drop: Any = (), controls: dict[str, Any] | None = None, key: str | None = None
    ) -> Mechanism:
        """Mechanism of an MJCF file: its bodies, joints, springs, dampers, armature, motors and equalities by their names.

        It is drawn at MuJoCo's ``qpos0``, from which angles and travels count: they are ``qpos`` less ``ref``.  Equalities
        connect, weld and joint hold exactly; ``solref`` and ``solimp`` are not used.  Bodies without joints are part of
        those that carry them.  A joint or actuator with the name of a body or joint gets its kind behind it, as
        ``"hip actuator"``.  Call :meth:`assemble` where equalities do not fit the pose.  MuJoCo reads the file:
        ``pip install 'hhtbench[mujoco]'``.

        Parameters
        ----------
        drop
            Kinds to leave out, such as ``["contacts", "limits"]``; True: every kind that is not modelled.
        controls
            Controls of actuators by name: numbers, or functions of time in ``jax.numpy``; 0 of those not named.
        key
            Name of the keyframe to start at; its controls are those that are not given.

        Raises
        ------
        ProblemError
            The file has an error, or what is not modelled; the text names it.
        """
        return cls._read(path, "mjcf", drop, controls, key)

    @classmethod
    def from_urdf(cls, path: Any, *, drop: Any = (), controls: dict[str, Any] | None = None) -> Mechanism:
        """Mechanism of a URDF file, see :meth:`from_mjcf`; the root link is fixed, as MuJoCo reads it."""
        return cls._read(path, "urdf", drop, controls, None)

    @classmethod
    def _read(cls, *given: Any) -> Mechanism:
        found: Mechanism = import_module("hhtbench.mechanics.multibody.files").read(cls(), *given)
        return found

    def system(self) -> Multibody:
        """Make the system of equations."""
        if not self.bodies:
            raise ProblemError("a mechanism needs a body: m.body(name, mass, inertia, at=...).")
        self._warn_of_units()
        bodies = self.bodies.values()
        J = np.array([body.inertia for body in bodies])
        j0 = J if self.plane else np.trace(J, axis1=1, axis2=2) / 3
        diagonal = not self.plane and not J[:, ~np.eye(3, dtype=bool)].any()
        given = {kind: rows for kind, rows in self.rows.items() if rows}
        return Multibody(
            m=[body.mass for body in bodies],
            J=np.diagonal(J, axis1=1, axis2=2) if diagonal else J,
            j0=j0,
            gravity=self.gravity,
            flat=self.plane,
            joints={name: self._family(name) for name in ALL_FAMILIES if name in given},
            elements={kind: self._elements(kind) for kind in MEASURED if kind in given},
            loads=self._loads() if "load" in given else None,
            swivels=self._swivels() if "swivel" in given else None,
            speeds=self.rows_of("speed") if "speed" in given else None,
            names=self._names(),
            states=self._state_rates(),
            turns=[joint.turns for joint in self.joints.values()],
            kept=tuple(self.invariants.items()),
            moves=any(row.law is not None for family in ("slide", "turn") for row in given.get(family, [])),
        )

    def _warn_of_units(self) -> None:
        light, heavy = (pick(self.bodies.items(), key=lambda item: item[1].mass) for pick in (min, max))
        if heavy[1].mass > APART * light[1].mass:
            warnings.warn(
                f"body {heavy[0]!r} has {heavy[1].mass:g} kg beside {light[1].mass:g} kg of {light[0]!r}: check the units.",
                stacklevel=4,
            )

    def _family(self, name: str) -> Any:
        rows, made = self.rows[name], self.rows_of(name)
        if name in ("gear", "screw"):
            return Gears(
                made,
                self.rows_of(f"{name} other"),
                ratio=column(rows, "ratio"),
                teeth=column(rows, "teeth"),
                counted=rows[0].more.get("counted", False),
            )
        if name == "curve":
            return Curves(made, tuple(row.more["function"] for row in rows))
        if name == "couple":
            values = {key: np.array([row.more[key] for row in rows], float) for key in ("polynomial", "teeth")}
            return Couples(made, self.rows_of("couple other"), kinds=tuple(row.more["kinds"] for row in rows), **values)
        if name == "rolling":
            return Rolling(made, radius=column(rows, "radius"), across=column(rows, "across"))
        return made

    def _elements(self, kind: str) -> Any:
        rows, made = self.rows[kind], self.rows_of(kind)
        if kind in ("contact", "ball", "tyre"):
            names = "radius", "other", "stiffness", "loss", "onset", "power", "rub"
            values = {name: column(rows, name) for name in names}
            made_of = Tyres if kind == "tyre" else Contacts
            ball, rubs = kind == "ball", bool(values["rub"][:, 0].any())
            return made_of(made, **values, balls=ball, cylinders=ball and bool(made.w.any()), rubs=rubs)
        if kind == "drive":
            numbers = {name: column(rows, name) for name in ("stiffness", "damping", "free", "inertia")}
            kinds = tuple(row.more["kind"] for row in rows)
            return Drives(made, kinds=kinds, rotors=bool(numbers["inertia"].any()), **numbers)
        springs = {name: column(rows, name).ravel() for name in ("stiffness", "damping", "free")}
        if kind == "bushing":
            return Springs(rows=made, axes=column(rows, "axes"), **springs)
        if kind == "torsion" and not self.plane:
            value, near = zip(*(motion.at_present(self, self.joints[row.more["joint"]]) for row in rows), strict=True)
            made = eqx.tree_at(lambda one: one.value, made, np.array(value))
            return Springs(rows=made, near=np.array(near), **springs)
        return Springs(rows=made, **springs)

    def _swivels(self) -> Swivels:
        rows = self.rows["swivel"]
        damping, inertia = column(rows, "damping"), column(rows, "inertia")
        return Swivels(self.rows_of("swivel"), damping=damping, inertia=inertia, rotors=bool(inertia.any()))

    def _loads(self) -> Loads:
        rows = self.rows["load"]
        torques = tuple(of_time(row.more["torques"], (*OWN, *self.signals), strict=bool(self.signals)) for row in rows)
        follows, made = tuple(row.more["follows"] for row in rows), self.rows_of("load")
        return Loads(made, column(rows, "force"), column(rows, "torque"), torques=torques, follows=follows)

    def start(self) -> tuple[Any, Any]:
        """Coordinates and velocities (n,) of the bodies at their present poses."""
        bodies = self.bodies.values()
        turned = [body.angle if self.plane else quaternion(body.R, body.p) for body in bodies]
        q = self.frame.coordinates([body.x for body in bodies], np.array(turned))
        return q, self.frame.velocities(q, [body.velocity for body in bodies], np.array([body.rate for body in bodies]))

    def problem(self, t_span: tuple[float, float], *, name: str = "mechanism", **options: Any) -> Problem:
        """Make the problem over ``t_span`` [s] from the present poses; ``options`` are those of ``hb.Problem``.

        Call :meth:`assemble` before if the bodies do not fit their joints yet.
        """
        self.made, (q0, v0) = self.system(), self.start()
        starts.expect_signs(self)
        starts.expect_motors(self, float(t_span[0]))
        options = {"sketch": self.sketch} | self._options(options)
        return Problem(name=name, system=self.made, t_span=t_span, q0=q0, v0=v0, **options)

    def assemble(
        self, at: dict[str, float] | None = None, *, rates: dict[str, float] | None = None, t: float = 0.0
    ) -> assembly.Mobility:
        """Move the bodies from their rough poses to where the joints hold, and change their velocities likewise.

        Of all such moves it is about the least one in the norm of the masses.

        Parameters
        ----------
        at
            Angles [rad] or travels [m] of joints by name, from the drawn pose.
        rates
            Rates [rad/s, m/s] of joints by name.
        t
            Time [s] at which motors are taken: the start of the problem.

        Returns
        -------
        Mobility
            Degrees of freedom, and the joints whose rows are redundant.

        Raises
        ------
        ProblemError
            The joints cannot be brought together; the text names those that stay open.
        """
        return assembly.assemble(self, at or {}, rates or {}, t)

    def mobility(self) -> assembly.Mobility:
        """Degrees of freedom at the present poses, and the joints whose rows are redundant there."""
        return assembly.mobility(self)

    def of(self, solution: Any, name: str) -> Any:
        """Readings of a joint, motor, body, spring, bushing, contact, tyre, state or input: forces, poses, energies ..."""
        if name in self.joints:
            joint = self.joints[name]
            return (JointReading if joint.measured is None else CoordinateReading)(self, solution, joint)
        if name in self.bodies:
            return BodyReading(self, solution, name)
        if name in self.forces and self.forces[name].kind not in ("load", "swivel"):
            return ElementReading(self, solution, self.forces[name])
        if name in self.forces:
            raise ProblemError(f"{self.forces[name].kind} {name!r} is given, not found: there is nothing to read of it.")
        if name in self.signals:
            return SignalReading(self, solution, name)
        known = [*self.joints, *self.bodies, *self.forces, *self.signals]
        hint = did_you_mean(name, known) or f" There are {', '.join(known)}."
        raise ProblemError(f"there is no joint, body or force {name!r}.{hint}")

    def measure(self, joint: str, *, travel: bool = False, rate: bool = False) -> Callable[[Any, Any, Any], Any]:
        """Function of (t, q, v) for events, changes and forces: angle [rad] or travel [m] of ``joint`` from the drawn pose.

        It is the angle of a revolute or cylindrical joint, with ``travel=True`` and of others the travel, with ``rate=True``
        their rate [rad/s, m/s].  In the plane turns are counted; in space angles are those within one turn of the present
        pose, so call ``assemble`` before.  JAX can trace it.
        """
        one = self._find(joint, *motion.TURNING, *motion.SLIDING)
        if travel and one.kind == "revolute":
            raise ProblemError(f"joint {joint!r} is revolute: it has no travel.")
        return motion.function_of(motion.measure_of(self, one, slides=travel or one.kind not in motion.TURNING), rate=rate)

    def table(self, solution: Any) -> dict[str, Any]:
        """Columns by name for a data frame: time; positions, velocities, rates of bodies; angles, travels, rates, forces,
        torques of joints; powers of motors; what ``of`` reads of springs, contacts and tyres.
        """
        return tabulated(self, solution)

    def sketch(self, q: Any) -> dict[str, Any]:
        """Drawing at ``q``: every body as lines from its centre to its joints."""
        at = self.frame.placed(np.asarray(q)[: self.frame.size * len(self.bodies)])
        points, lines = [], []
        for name in self.bodies:
            centre, R = np.asarray(at.x[self.number(name)]), np.asarray(at.R[self.number(name)])
            ends = [
                centre + R @ joint.points[side]
                for joint in self.joints.values()
                for side, body in enumerate((joint.first, joint.second))
                if body == name
            ]
            points += ends
            lines += [chain(np.array([centre, end])) for end in ends]
        centres = np.asarray(at.x[:-1])
        none = np.zeros((0, 2, self.dimension))
        return {
            "points": np.concatenate([centres, *np.array(points)[None]] if points else [centres]),
            "lines": np.concatenate([none, *lines]),
        }

    def velocity_rows_by_joint(self) -> dict[str, Any]:
        """Numbers of the rows of every joint among the velocity constraints: of rolling, then of prescribed rates."""
        count, each = len(self.rows.get("rolling", [])), self.dimension - 1
        found = {}
        for name, joint in self.joints.items():
            rolls = [i for family, i in joint.rows if family == "rolling"]
            speeds = [count * each + i for family, i in joint.rows if family == "speed"]
            found[name] = np.array([i + count * j for i in rolls for j in range(each)] + speeds, dtype=int)
        return found

    def rows_by_joint(self) -> dict[str, Any]:
        """Numbers of the rows of every joint among the position constraints."""
        start, sizes = 0 if self.plane else len(self.bodies), {}
        for family in ALL_FAMILIES:
            for i, row in enumerate(self.rows.get(family, [])):
                count = {"point": self.dimension, "curve": row.more.get("count", 1)}.get(family, 1)
                sizes[family, i] = np.arange(start, start + count)
                start += count
        none = np.zeros(0, dtype=int)
        return {
            name: np.concatenate([none, *(sizes[row] for row in joint.rows if row in sizes)]).astype(int)
            for name, joint in self.joints.items()
        }


__all__ = ["GROUND", "Mechanism"]
