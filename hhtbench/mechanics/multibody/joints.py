"""Joints of a mechanism, each made of a few families of rows."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from numbers import Real
from typing import Any

import numpy as np

from hhtbench.mechanics.multibody.parts import RIGHT, Joint, Parts, frame_along, unit
from hhtbench.mechanics.multibody.rows import Law
from hhtbench.protocol.errors import ProblemError, did_you_mean


def _constant(value: Any, t: Any) -> Any:
    """The law ``value`` at all times."""
    return value + 0.0 * t


class Joints(Parts):
    """Bodies and joints; points and axes are in space at the pose in which the bodies are when the joint is added.

    ``at_second`` is the point of the second body where the drawn bodies do not fit yet: ``assemble`` brings both together.
    """

    def _joint(
        self,
        kind: str,
        name: str,
        first: str,
        second: str,
        at: Any,
        at_second: Any = None,
        frame: Any = None,
        frame_second: Any = None,
        *,
        point: bool = False,
        dots: Sequence[tuple[int, int]] = (),
        slides: Sequence[int] = (),
        locked: bool = False,
    ) -> str:
        """Add rows: a common point, scalar products of frame columns (first, second), slides along columns of the first, no
        turn about the last column.
        """
        self._expect_new(name)
        if first == second:
            raise ProblemError(f"joint {name!r} joins {first!r} to itself.")
        a = self._vector(f"at of joint {name!r}", at)
        b = a if at_second is None else self._vector(f"at_second of joint {name!r}", at_second)
        e = np.eye(self.dimension) if frame is None else frame
        f = e if frame_second is None else frame_second
        rows = [self.row("point", first, second, a=a, b=b)] if point else []
        rows += [self.row("dot", first, second, u=e[:, i], w=f[:, j]) for i, j in dots]
        rows += [self.row("slide", first, second, a=a, b=b, u=e[:, i]) for i in slides]
        (x1, R1, angle1), (x2, R2, angle2) = self.pose(first), self.pose(second)
        self.joints[name] = Joint(
            name=name,
            kind=kind,
            base=kind,
            first=first,
            second=second,
            rows=rows,
            points=(R1.T @ (a - x1), R2.T @ (b - x2)),
            frames=(R1.T @ e, R2.T @ f),
            drawn=angle2 - angle1,
        )
        if locked:
            rows.append(self._turn(self.joints[name], None))
        return name

    def _turn(self, joint: Joint, law: Law | None, family: str = "turn", value: float = 0.0) -> tuple[str, int]:
        """Add a row of the angle of ``joint`` from ``value`` [rad]."""
        if self.plane:
            return self.row(family, joint.first, joint.second, value=joint.drawn + value, law=law)
        (_, R1, _), (_, R2, _) = self.pose(joint.first), self.pose(joint.second)
        x, y, _ = (R1 @ joint.frames[0]).T
        c, s = np.cos(value), np.sin(value)
        u, y, w = c * x + s * y, c * y - s * x, (R2 @ joint.frames[1])[:, 0]
        return self.row(family, joint.first, joint.second, u=u, y=y, w=w, law=law, value=value)

    def _travel(self, joint: Joint, law: Law | None, family: str = "slide", value: float = 0.0) -> tuple[str, int]:
        """Add a row of the travel of ``joint`` along its axis from ``value`` [m]."""
        (x1, R1, _), (x2, R2, _) = self.pose(joint.first), self.pose(joint.second)
        a, b = x1 + R1 @ joint.points[0], x2 + R2 @ joint.points[1]
        return self.row(family, joint.first, joint.second, a=a, b=b, u=R1 @ joint.frames[0][:, -1], value=value, law=law)

    def _expect_space(self, kind: str) -> None:
        if self.plane:
            raise ProblemError(f"a {kind} joint needs space; this mechanism is in the plane.")

    def revolute(self, name: str, first: str, second: str, at: Any, axis: Any = None, *, at_second: Any = None) -> str:
        """Hinge at ``at`` about ``axis``; in the plane a pin, without an axis."""
        if self.plane:
            return self._joint("revolute", name, first, second, at, at_second, point=True)
        frame = frame_along(axis, name=f"axis of joint {name!r}")
        return self._joint("revolute", name, first, second, at, at_second, frame, point=True, dots=((0, 2), (1, 2)))

    def prismatic(self, name: str, first: str, second: str, at: Any, axis: Any, *, at_second: Any = None) -> str:
        """Slider along ``axis`` through ``at``, without rotation."""
        if self.plane:
            along = unit(f"axis of joint {name!r}", axis, 2)
            frame = np.array([[along[1], along[0]], [-along[0], along[1]]])  # columns: across, along
            return self._joint("prismatic", name, first, second, at, at_second, frame, slides=(0,), locked=True)
        dots = (0, 2), (1, 2)
        frame = frame_along(axis, name=f"axis of joint {name!r}")
        return self._joint("prismatic", name, first, second, at, at_second, frame, dots=dots, slides=(0, 1), locked=True)

    def cylindrical(self, name: str, first: str, second: str, at: Any, axis: Any, *, at_second: Any = None) -> str:
        """Slider along ``axis`` that also turns about it."""
        self._expect_space("cylindrical")
        dots = (0, 2), (1, 2)
        return self._joint(
            "cylindrical",
            name,
            first,
            second,
            at,
            at_second,
            frame_along(axis, name=f"axis of joint {name!r}"),
            dots=dots,
            slides=(0, 1),
        )

    def spherical(self, name: str, first: str, second: str, at: Any, *, at_second: Any = None) -> str:
        """Ball joint at ``at``."""
        self._expect_space("spherical")
        return self._joint("spherical", name, first, second, at, at_second, point=True)

    def universal(
        self, name: str, first: str, second: str, at: Any, axis: Any, axis_second: Any, *, at_second: Any = None
    ) -> str:
        """Cardan joint: ``axis`` of the first body stays at right angles to ``axis_second`` of the second."""
        self._expect_space("universal")
        frame = frame_along(axis_second, axis, f"axis_second of joint {name!r}")
        if frame[:, 0] @ unit(f"axis of joint {name!r}", axis, 3) < 1 - RIGHT:
            raise ProblemError(
                f"joint {name!r}: axis and axis_second must be at right angles; got {axis} and {axis_second}."
            )
        return self._joint("universal", name, first, second, at, at_second, frame, point=True, dots=((0, 2),))

    def planar(self, name: str, first: str, second: str, at: Any, axis: Any, *, at_second: Any = None) -> str:
        """The second body moves in the plane of the first through ``at`` with normal ``axis``."""
        self._expect_space("planar")
        dots = (0, 2), (1, 2)
        return self._joint(
            "planar",
            name,
            first,
            second,
            at,
            at_second,
            frame_along(axis, name=f"axis of joint {name!r}"),
            dots=dots,
            slides=(2,),
        )

    def weld(
        self,
        name: str,
        first: str,
        second: str,
        at: Any,
        *,
        at_second: Any = None,
        axes: Any = None,
        axes_second: Any = None,
    ) -> str:
        """Rigid joint; frames ``axes`` and ``axes_second`` (3, 3), as columns in space, coincide if they are given."""
        dots = () if self.plane else ((0, 2), (1, 2))
        return self._joint("weld", name, first, second, at, at_second, axes, axes_second, point=True, dots=dots, locked=True)

    def distance(self, name: str, first: str, second: str, at: Any, at_second: Any, length: float | None = None) -> str:
        """Massless rod from ``at`` of the first to ``at_second`` of the second, of ``length`` [m] or as drawn."""
        a, b = np.asarray(at, float), np.asarray(at_second, float)
        value = float(np.linalg.norm(a - b) if length is None else length)
        if not (np.isfinite(value) and value > 0.0):
            raise ProblemError(f"joint {name!r}: length must be above 0 m; got {value}. A ball joint has no length.")
        self._joint("distance", name, first, second, at, at_second)
        self.joints[name].rows = [self.row("distance", first, second, a=a, b=b, value=value)]
        return name

    def on_line(self, name: str, first: str, second: str, at: Any, axis: Any, *, at_second: Any = None) -> str:
        """Point ``at`` of the second body on the line of the first through ``at`` along ``axis``."""
        if self.plane:
            along = unit(f"axis of joint {name!r}", axis, 2)
            frame = np.array([[along[1], along[0]], [-along[0], along[1]]])
            return self._joint("on_line", name, first, second, at, at_second, frame, slides=(0,))
        return self._joint(
            "on_line", name, first, second, at, at_second, frame_along(axis, name=f"axis of joint {name!r}"), slides=(0, 1)
        )

    def on_curve(self, name: str, first: str, second: str, at: Any, function: Callable[[Any], Any]) -> str:
        """Point ``at`` of the second body on a curve of the first.

        ``function(x)`` of a point (d,) in the frame of the first is zero on the curve: one value in the plane, two in space
        (one: a surface), in ``jax.numpy``.
        """
        there = self._vector("at", at)
        (x1, R1, _) = self.pose(first)
        count = np.size(function(R1.T @ (there - x1)))
        self._joint("on_curve", name, first, second, at)
        self.joints[name].rows = [self.row("curve", first, second, b=there, function=function, count=count)]
        return name

    def gear(self, name: str, joint: str, other: str, teeth: tuple[int, int]) -> str:
        """Couple the angles of two revolute joints: ``teeth[0] angle + teeth[1] other = 0``; a number below 0 for a ring."""
        one, two = self._find(joint, "revolute"), self._find(other, "revolute")
        if not all(float(z).is_integer() and z for z in teeth):
            raise ProblemError(f"gear {name!r}: teeth must be two whole numbers, not zero; got {teeth}.")
        self._expect_new(name)
        self._turn(two, None, "gear other")
        row = self._turn(one, None, "gear")
        self.rows["gear"][-1].more |= {"ratio": teeth[1] / teeth[0], "teeth": abs(teeth[0]), "joints": (one, two)}
        self.joints[name] = self._on(one, name, "gear", [row])
        return name

    def screw(self, name: str, joint: str, lead: float) -> str:
        """Couple angle and travel of a cylindrical joint: ``lead`` [m] of travel a turn."""
        one = self._find(joint, "cylindrical")
        if not (np.isfinite(lead) and lead):
            raise ProblemError(f"screw {name!r}: lead must be a length of a turn [m], not zero; got {lead}.")
        self._expect_new(name)
        self._travel(one, None, "screw other")
        row = self._turn(one, None, "screw")
        self.rows["screw"][-1].more |= {"ratio": -2 * np.pi / lead, "teeth": 1, "joints": (one, one)}
        self.joints[name] = self._on(one, name, "screw", [row])
        return name

    def rolling(
        self, name: str, body: str, radius: float, at: Any, *, axis: Any = None, on: str = "ground", point: Any, normal: Any
    ) -> str:
        """Disc about ``axis`` (a ball without one) with centre ``at`` rolls without slip on the plane of ``on`` through
        ``point`` with ``normal``.
        """
        up = unit(f"normal of joint {name!r}", normal, self.dimension)
        through = self._vector("point", point)
        self._expect_numbers(name, 0.0, radius=radius)
        across = np.array([[up[1], -up[0]]]) if self.plane else frame_along(up).T[:2]
        u = None if axis is None or self.plane else unit(f"axis of joint {name!r}", axis, 3)
        _, R, _ = self.pose(on)
        centre = self._vector("at", at)
        self._joint("rolling", name, on, body, at)
        row = self.row("rolling", body, on, a=centre, b=through, u=u, w=up, radius=radius, across=across @ R)
        self.joints[name].rows = [row]
        return name

    def motor(
        self,
        name: str,
        joint: str,
        law: Law | float | None = None,
        *,
        speed: Law | float | None = None,
        travel: bool = False,
    ) -> str:
        """Prescribe the angle [rad] or travel [m] of ``joint`` from the drawn pose, or its rate [rad/s], over time.

        It holds the angle of a revolute joint, the travel of a prismatic one; of a cylindrical one the angle, or with
        ``travel=True`` the travel.  Laws are numbers or functions of time in ``jax.numpy``; numbers, and those of a
        ``functools.partial`` except integers, are parameters, whose new values reuse the compiled code.  Call ``assemble``
        afterwards: it brings the bodies to the angle and the rate, and tells where a rate begins.  Read by its
        name, the motor's torque is that on the second body.
        """
        one = self._find(joint, "revolute", "prismatic", "cylindrical")
        self._expect_new(name)
        if (law is None) == (speed is None):
            raise ProblemError(f"motor {name!r}: give either a law of the position or speed=, a law of the rate.")
        law, speed = (self._law(f"motor {name!r}", x) for x in (law, speed))
        sliding = one.kind == "prismatic" or travel
        if speed is None:
            row = self._travel(one, law) if sliding else self._turn(one, law)
        elif sliding:
            raise ProblemError(f"motor {name!r}: speed= is for angles; give the travel of {joint!r} as a law of time.")
        else:
            _, R, _ = self.pose(one.second)
            axis = None if self.plane else (R @ one.frames[1])[:, 2]
            row = self.row(
                "speed", one.first, one.second, b=None if axis is None else self.pose(one.second)[0] + axis, law=speed
            )
        self.joints[name] = self._on(one, name, "motor", [row])
        return name

    def _law(self, owner: str, law: Any) -> Law | None:
        """A law of time; numbers are constant ones."""
        if law is None or callable(law):
            return law
        if isinstance(law, bool) or not isinstance(law, Real) or not np.isfinite(float(law)):
            raise ProblemError(f"{owner}: a law must be a number or a function of time; got {law!r}.")
        return functools.partial(_constant, float(law))

    def _on(self, joint: Joint, name: str, kind: str, rows: list[tuple[str, int]]) -> Joint:
        return Joint(**vars(joint) | {"name": name, "kind": kind, "rows": rows})

    def _find(self, name: str, *kinds: str) -> Joint:
        if name not in self.joints:
            raise ProblemError(f"there is no joint {name!r}.{did_you_mean(name, self.joints)}")
        if self.joints[name].kind not in kinds:
            raise ProblemError(f"joint {name!r} is {self.joints[name].kind}; expected {' or '.join(kinds)}.")
        return self.joints[name]
