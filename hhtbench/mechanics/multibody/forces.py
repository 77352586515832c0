"""Springs, bushings, contacts and loads of a mechanism."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from hhtbench.mechanics.multibody.joints import Joints
from hhtbench.mechanics.multibody.parts import GROUND, RIGHT, Row, tidy, unit
from hhtbench.mechanics.multibody.rows import Law
from hhtbench.protocol.errors import ProblemError


@dataclass(kw_only=True)
class Element:
    """A spring, bushing, contact or load: its kind and its number in it."""

    name: str
    kind: str
    number: int


class Forces(Joints):
    """Bodies, joints and forces."""

    def _element(self, kind: str, name: str, first: str, second: str, **given: Any) -> str:
        self._expect_new(name)
        self.forces[name] = Element(name=name, kind=kind, number=self.row(kind, first, second, **given)[1])
        return name

    def spring(
        self,
        name: str,
        first: str,
        second: str,
        at: Any,
        at_second: Any,
        stiffness: float,
        damping: float = 0.0,
        free: float | None = None,
    ) -> str:
        """Spring [N/m] and damper [N s/m] between points; ``free`` is the length [m] without force, else that drawn."""
        a, b = self._vector("at", at), self._vector("at_second", at_second)
        free = float(np.linalg.norm(a - b)) if free is None else free
        self._expect_numbers(name, stiffness=stiffness, damping=damping, free=free)
        return self._element("spring", name, first, second, a=a, b=b, stiffness=stiffness, damping=damping, free=free)

    def torsion(self, name: str, joint: str, stiffness: float, damping: float = 0.0, free: float = 0.0) -> str:
        """Spring [N m/rad] and damper [N m s/rad] about a revolute joint, without moment at the angle ``free`` [rad].

        The angle is zero in the drawn pose, ``free`` may be turns away.  In the plane turns are counted.  In space the
        quaternions show the angle up to one turn either way from the start of the problem: 5.78 rad from there the moment is
        not a number, which ends a run.
        """
        self._expect_new(name)
        self._expect_numbers(name, stiffness=stiffness, damping=damping, free=free)
        row = self._turn(self._find(joint, "revolute", "cylindrical"), None, "torsion")
        self.rows["torsion"][-1].more |= {"stiffness": stiffness, "damping": damping, "free": free, "joint": joint}
        self.forces[name] = Element(name=name, kind="torsion", number=row[1])
        return name

    def bushing(
        self,
        name: str,
        first: str,
        second: str,
        at: Any,
        stiffness: Any,
        damping: Any = 0.0,
        axes: Any = None,
        free: Any = 0.0,
    ) -> str:
        """Springs and dampers against all offsets of two frames that coincide as drawn.

        ``stiffness`` and ``damping`` (6,): three translations [N/m], three rotations [N m/rad]; in the plane (3,).
        ``free``: offsets without force, likewise [m, rad].
        ``axes`` (3, 3), columns, or (4,), a quaternion: the frames' rotation in space; along space if not given.  In the
        plane their angle [rad] from the x axis as drawn; that of the first body if not given.
        """
        size = 3 if self.plane else 6
        values: dict[str, Any] = {
            key: np.broadcast_to(np.asarray(value, float), (size,))
            for key, value in (("stiffness", stiffness), ("damping", damping), ("free", free))
        }
        there = self._vector("at", at)
        (_, R1, angle1), (_, R2, angle2) = self.pose(first), self.pose(second)
        self._expect_numbers(name, **values)
        frame = R1 if self.plane and axes is None else self._rotation(f"axes of bushing {name!r}", axes)[0]
        more = {"axes": np.array([tidy(R.T @ frame) for R in (R1, R2)])}
        return self._element("bushing", name, first, second, a=there, b=there, value=angle2 - angle1, **values, **more)

    def contact(
        self,
        name: str,
        first: str,
        second: str,
        at: Any,
        stiffness: float,
        *,
        radius: float = 0.0,
        point: Any = None,
        normal: Any = None,
        centre: Any = None,
        other: float = 0.0,
        axis: Any = None,
        loss: float = 0.0,
        onset: float,
        power: float = 1.5,
        friction: tuple[float, float] | None = None,
    ) -> str:
        """Contact of a ball (a circle in the plane) of the first with a plane, ball or long cylinder of the second body.

        Parameters
        ----------
        at, radius
            Centre (d,) and radius [m] of the first; 0: a point.
        point, normal
            Of the plane, (d,) [m] and outward; or
        centre, other
            centre (d,) and radius [m] of the other ball, below 0 for a hollow one around the first; with an ``axis`` (d,)
            through its centre it is a long cylinder, in the plane a strip.
        stiffness, power, loss, onset
            Of Hunt and Crossley's force [N/m^power], see ``contact.hunt_crossley`` [s/m, m].
        friction
            Coefficient and creep [m/s], see ``contact.friction``.
        """
        if (normal is None) == (centre is None):
            raise ProblemError(
                f"contact {name!r}: give either point= and normal= of a plane, or centre= and other= of a ball."
            )
        more: dict[str, Any] = {
            "radius": radius,
            "other": other,
            "stiffness": stiffness,
            "loss": loss,
            "onset": onset,
            "power": power,
        }
        more["rub"] = (0.0, 1.0) if friction is None else friction
        self._expect_numbers(name, **more)
        self._expect_numbers(name, 0.0, onset=onset)
        a = self._vector("at", at)
        if centre is not None:
            axis = None if axis is None else unit(f"axis of contact {name!r}", axis, self.dimension)
            return self._element("ball", name, first, second, a=a, b=self._vector("centre", centre), w=axis, **more)
        up = unit(f"normal of contact {name!r}", normal, self.dimension)
        return self._element("contact", name, first, second, a=a, b=self._vector("point", point), w=up, **more)

    def tyre(
        self,
        name: str,
        wheel: str,
        road: str,
        at: Any,
        radius: float,
        stiffness: float,
        *,
        axis: Any = None,
        point: Any,
        normal: Any,
        grip: tuple[float, float, float, float],
        loss: float = 0.0,
        onset: float,
        power: float = 1.0,
    ) -> str:
        """Tyre of a thin wheel on a plane of the road: a normal force, and forces by slip along and across.

        Parameters
        ----------
        at, radius, axis
            Centre (d,) and radius [m] of the wheel, in space its axle (3,); it rolls along ``axis x normal``.
        point, normal
            Of the road, (d,) [m] and outward.
        stiffness, power, loss, onset
            Of the normal force, as in :meth:`contact`.
        grip
            Coefficient of friction; stiffness along and across per unit of slip and of load; the speed [m/s] below which the
            wheel counts as standing: see ``tyres.slip_force``.
        """
        given: dict[str, Any] = {"radius": radius, "stiffness": stiffness, "onset": onset}
        if np.shape(grip) != (4,):
            raise ProblemError(f"grip of tyre {name!r} must be 4 numbers; got {grip}.")
        self._expect_numbers(name, 0.0, **given, grip=grip)
        self._expect_numbers(name, loss=loss, power=power)
        up, axle = unit(f"normal of tyre {name!r}", normal, self.dimension), None
        if not self.plane:
            axle = unit(f"axis of tyre {name!r}", axis, 3)
            if abs(axle @ up) > 1 - RIGHT:
                raise ProblemError(f"tyre {name!r}: axis is along normal, the wheel lies flat.")
        more = given | {"other": 0.0, "loss": loss, "power": power, "rub": np.asarray(grip, float)}
        a, b = self._vector("at", at), self._vector("point", point)
        return self._element("tyre", name, wheel, road, a=a, b=b, u=axle, w=up, **more)

    def load(
        self, name: str, body: str, at: Any = None, *, force: Any = None, torque: Any = None, follows: bool = False
    ) -> str:
        """Force (d,) [N] at the point ``at`` of a body, its centre if not given, and torque [N m]: constants or functions of
        time in ``jax.numpy``.  Components are in space, with ``follows=True`` in the body's frame.
        """
        zero = np.zeros(self.dimension), 0.0 if self.plane else np.zeros(3)
        laws: list[Law | None] = [x if callable(x) else None for x in (force, torque)]
        values = [
            none if x is None or callable(x) else np.asarray(x, float) for x, none in zip((force, torque), zero, strict=True)
        ]
        for what, value, none in zip(("force", "torque"), values, zero, strict=True):
            if np.shape(value) != np.shape(none) or not np.isfinite(value).all():
                raise ProblemError(
                    f"load {name!r}: {what} must be {np.size(none)} numbers or a function of time; got {value}."
                )
        if body == GROUND:
            raise ProblemError(f"load {name!r} acts on the ground, which does not move; name a body.")
        there = self.pose(body)[0] if at is None else self._vector("at", at)
        more = {"force": values[0], "torque": values[1], "torques": laws[1], "follows": follows}
        return self._element("load", name, "ground", body, b=there, law=laws[0], **more)


def column(rows: list[Row], name: str) -> Any:
    """The values of ``name`` of ``rows``, (j, ...)."""
    return np.array([row.more[name] for row in rows], dtype=float)
