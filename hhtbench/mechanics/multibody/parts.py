"""Bodies and joints of a mechanism as they are described, and the rows that its joints are made of."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np

from hhtbench.mechanics import space
from hhtbench.mechanics.multibody.frames import Plane, Space
from hhtbench.mechanics.multibody.rows import Law, Rows, of_time
from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError, did_you_mean

GROUND = "ground"
RIGHT = 1e-6  # largest scalar product of directions that are at right angles
MOMENTS = 1e-9  # by which moments of inertia may break the triangle inequality


@dataclass(kw_only=True)
class Body:
    """One body at its present pose; rotation ``R`` (d, d), in the plane also its ``angle``."""

    mass: float
    inertia: Any  #: (3, 3) in space, a number in the plane [kg m^2]
    x: Any
    R: Any
    velocity: Any
    rate: Any
    angle: float = 0.0
    p: Any = None  #: unit quaternion that was given, which is that of ``R`` until the body is moved


@dataclass(kw_only=True)
class Joint:
    """A joint, motor or gear: its rows and its frame in both bodies."""

    name: str
    kind: str
    first: str
    second: str
    rows: list[tuple[str, int]]  #: family and number in it
    points: tuple[Any, Any]  #: in the frames of first and second
    frames: tuple[Any, Any]  #: columns x, y, z = axis, likewise
    base: str  #: kind of the joint itself, or of the joint that a motor, gear or screw acts on
    drawn: float = 0.0  #: angle of the second less that of the first where it was drawn, in the plane
    measured: Any = None  #: measure and row of the coordinate of one joint of a composite
    turns: int = 0  #: whole turns of the present pose, which poses in space do not show


@dataclass
class Row:
    """One row of a family, in the frames of its bodies."""

    bodies: tuple[str, str]
    points: tuple[Any, ...]  #: a, b of ``Rows``
    directions: tuple[Any, ...]  #: u, w, y
    value: float = 0.0
    law: Law | None = None
    more: dict[str, Any] = field(default_factory=dict)


class Parts:
    """Bodies by name, and rows by family; ``plane`` tells where they are."""

    def __init__(self, *, plane: bool) -> None:
        self.plane = plane
        self.bodies: dict[str, Body] = {}
        self.joints: dict[str, Joint] = {}
        self.forces: dict[str, Any] = {}
        self.signals: dict[str, Any] = {}  #: states and inputs
        self.rows: dict[str, list[Row]] = {}

    @property
    def dimension(self) -> int:
        """Number of dimensions."""
        return 2 if self.plane else 3

    @property
    def frame(self) -> Any:
        """Plane or Space."""
        return Plane if self.plane else Space

    def body(
        self,
        name: str,
        mass: float,
        inertia: Any,
        at: Any = None,
        *,
        turned: Any = None,
        velocity: Any = None,
        rate: Any = None,
    ) -> str:
        """Add a body.

        Parameters
        ----------
        mass
            [kg], above 0.
        inertia
            About the centre of mass in the body's frame [kg m^2]: principal moments (3,) or a tensor (3, 3); in the plane a
            number.
        at
            Centre of mass (d,) [m], the origin if it is not given.
        turned
            Rotation of the body's frame: matrix (3, 3) or unit quaternion (4,), scalar first, which begins with its sign;
            in the plane an angle [rad].
        velocity, rate
            Of the centre (d,) [m/s], and angular velocity in space (3,) or in the plane [rad/s] at the start.

        Raises
        ------
        ProblemError
            The name is taken, the mass is not positive, or no body has such moments of inertia.
        """
        d = self.dimension
        self._expect_new(name)
        if not (np.isfinite(mass) and mass > 0.0):
            raise ProblemError(f"body {name!r}: mass must be above 0 kg; got {mass}.")
        R, angle = self._rotation(f"turned of body {name!r}", turned)
        zero, given = np.zeros(d), np.asarray(turned, float) if np.shape(turned) == (4,) else None
        self.bodies[name] = Body(
            mass=float(mass),
            inertia=self._inertia(name, inertia),
            x=self._vector(f"at of body {name!r}", zero if at is None else at),
            R=R,
            angle=angle,
            p=None if given is None else given / np.linalg.norm(given),
            velocity=self._vector(f"velocity of body {name!r}", zero if velocity is None else velocity),
            rate=(0.0 if rate is None else float(rate))
            if self.plane
            else self._vector(f"rate of body {name!r}", zero if rate is None else rate),
        )
        return name

    def _rotation(self, name: str, turned: Any) -> tuple[Any, float]:
        if self.plane:
            angle = 0.0 if turned is None else real_number(name, turned, unit=" [rad]")
            return np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]), angle
        R = np.eye(3) if turned is None else np.asarray(turned, dtype=float)
        if R.shape == (4,):
            R = np.asarray(space.rotation(jnp.asarray(R / np.linalg.norm(R))))
        if R.shape != (3, 3) or not abs(R.T @ R - np.eye(3)).max() <= RIGHT or np.linalg.det(R) < 0:
            raise ProblemError(f"{name} must be a rotation matrix (3, 3) or a quaternion (4,); got {turned}.")
        return R, 0.0

    def _inertia(self, name: str, inertia: Any) -> Any:
        J = np.asarray(inertia, dtype=float)
        if self.plane:
            if J.shape or not J > 0.0:
                raise ProblemError(f"body {name!r}: inertia must be one number above 0 kg m^2 in the plane; got {inertia}.")
            return float(J)
        J = np.diag(J) if J.shape == (3,) else J
        if J.shape != (3, 3) or not np.allclose(J, J.T, rtol=0, atol=MOMENTS * abs(J).max()):
            raise ProblemError(f"body {name!r}: inertia must be moments (3,) or a symmetric tensor (3, 3); got {inertia}.")
        small, middle, large = np.linalg.eigvalsh(J)
        if small <= 0.0 or large > (small + middle) * (1 + MOMENTS):
            raise ProblemError(
                f"body {name!r}: no body has the principal moments {small:.6g}, {middle:.6g}, {large:.6g} kg m^2: each is "
                "above 0 and at most the sum of the others."
            )
        return J

    def _vector(self, name: str, value: Any) -> Any:
        found = np.asarray(value, dtype=float)
        if found.shape != (self.dimension,) or not np.isfinite(found).all():
            raise ProblemError(f"{name} must be {self.dimension} numbers; got {value!r}.")
        return found

    def _expect_numbers(self, name: str, above: float = -math.inf, **given: Any) -> None:
        """Raise if one of the numbers ``given`` by name is not finite or not above ``above``."""
        for what, value in given.items():
            if not np.all(np.isfinite(value) & (np.asarray(value) > above)):
                wanted = "finite" if above == -math.inf else f"above {above:g}"
                raise ProblemError(f"{name!r}: {what} must be {wanted}; got {value}.")

    def _expect_new(self, name: str) -> None:
        if name in (GROUND, *self.bodies, *self.joints, *self.forces, *self.signals):
            raise ProblemError(f"{name!r} is there already; give another name.")

    def pose(self, name: str) -> tuple[Any, Any, float]:
        """Centre, rotation and angle of a body or of the ground."""
        if name == GROUND:
            return np.zeros(self.dimension), np.eye(self.dimension), 0.0
        if name not in self.bodies:
            raise ProblemError(f"there is no body {name!r}.{did_you_mean(name, [*self.bodies, GROUND])}")
        body = self.bodies[name]
        return body.x, body.R, body.angle

    def number(self, name: str) -> int:
        """Number of a body in ``q``; the ground is behind the last."""
        return len(self.bodies) if name == GROUND else list(self.bodies).index(name)

    def row(
        self,
        family: str,
        first: str,
        second: str,
        *,
        a: Any = None,
        b: Any = None,
        u: Any = None,
        w: Any = None,
        y: Any = None,
        value: float = 0.0,
        law: Law | None = None,
        **more: Any,
    ) -> tuple[str, int]:
        """Add a row: points ``a, b`` and directions ``u, y`` of the first and ``w`` of the second, in space as drawn."""
        (x1, R1, _), (x2, R2, _) = self.pose(first), self.pose(second)
        none = np.zeros(self.dimension)
        points = (none if x is None else tidy(R.T @ (x - origin)) for x, origin, R in ((a, x1, R1), (b, x2, R2)))
        turned = (none if x is None else tidy(R.T @ x) for x, R in ((u, R1), (w, R2), (y, R1)))
        made = Row((first, second), (*points,), (*turned,), value, law, more)
        self.rows.setdefault(family, []).append(made)
        return family, len(self.rows[family]) - 1

    def rows_of(self, family: str) -> Rows:
        """All rows of a family as arrays."""
        if family in ("load", "drive", "swivel"):
            return self.arrays(self.rows[family], ("t", "q", "v", *self.signals))
        for row in self.rows[family]:
            law = of_time(row.law, tuple(self.signals))
            if law is not None and law.takes != ("t",):
                raise ProblemError(f"the law of a prescribed motion takes time alone; got {', '.join(law.takes)}.")
        return self.arrays(self.rows[family])

    def arrays(self, rows: list[Row], names: tuple[str, ...] = ()) -> Rows:
        """Rows as arrays; ``names``: arguments that their laws may have."""
        first, second = (tuple(self.number(row.bodies[side]) for row in rows) for side in (0, 1))
        a, b = np.array([row.points for row in rows]).swapaxes(0, 1)
        u, w, y = np.array([row.directions for row in rows]).swapaxes(0, 1)
        laws = tuple(of_time(row.law, names, strict=bool(names and self.signals)) for row in rows)
        value = np.array([row.value for row in rows])
        return Rows(first=first, second=second, laws=laws, a=a, b=b, u=u, w=w, y=y, value=value)


def unit(name: str, value: Any, dimension: int) -> Any:
    """Unit vector (d,) along ``value``."""
    found = np.asarray(value, dtype=float)
    if found.shape != (dimension,) or not (np.isfinite(found).all() and np.linalg.norm(found) > 0.0):
        raise ProblemError(f"{name} must be {dimension} numbers, not all zero; got {value!r}.")
    return found / np.linalg.norm(found)


def tidy(x: Any) -> Any:
    """Round entries of ``x`` that are within 1e-14 of an integer, so that zeros stay zeros."""
    near = np.round(x)
    return np.where(abs(x - near) < 1e-14, near, x)


def frame_along(axis: Any, x: Any = None, name: str = "axis") -> Any:
    """Matrix (3, 3) of a frame with z along ``axis`` and x near ``x``, or near the axis of space furthest from z."""
    z = unit(name, axis, 3)
    x = np.eye(3)[np.argmin(abs(z))] if x is None else unit(name, x, 3)
    x = x - z * (x @ z)
    if not np.linalg.norm(x) > RIGHT:
        raise ProblemError(f"{name}: both axes are parallel, {axis}.")
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)
