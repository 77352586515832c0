"""Joints that follow one another without bodies between them, and what acts on the coordinates of joints."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from hhtbench.mechanics.multibody.forces import Element, Forces
from hhtbench.mechanics.multibody.parts import RIGHT, Joint, frame_along, unit
from hhtbench.mechanics.multibody.rows import Law
from hhtbench.protocol.errors import ProblemError

TURNING, SLIDING = ("revolute", "cylindrical", "hinge"), ("prismatic", "slide")
LARGEST_TEETH = 1000  # of slopes that are fractions


class Composites(Forces):
    """Bodies, joints, forces and coordinates."""

    def composite(self, name: str, first: str, second: str, at: Any, joints: dict[str, tuple[str, Any]]) -> str:
        """Slides and hinges one after the other without bodies between them, from the first body to the second.

        ``joints`` maps names to ``("slide", axis)``, ``("hinge", axis)`` or ``("ball", None)``.  Hinges turn about axes
        through ``at``; slides are before all hinges or behind them.  Reactions are read by ``name``, coordinates by the
        names of the joints.  Of two hinges the axes must not be parallel; of three, the second must be at right angles to
        the others for their coordinates to be known, and its angle stays within a quarter of a turn.
        """
        steps = [
            (key, kind, None if axis is None else unit(f"axis of joint {key!r}", axis, 3))
            for key, (kind, axis) in joints.items()
        ]
        slides, hinges, behind = self._ordered(name, steps)
        there = self._vector(f"at of joint {name!r}", at)
        A, B = (second, first) if behind else (first, second)
        self._joint("composite", name, A, B, there)
        joint = self.joints[name]
        if behind:  # readings are on the second body
            joint.first, joint.second = first, second
            joint.points, joint.frames = joint.points[::-1], joint.frames[::-1]
        axes = np.array([axis for _, axis in slides]).reshape(-1, 3)
        if np.linalg.matrix_rank(axes, RIGHT) < len(axes):
            raise ProblemError(f"joint {name!r}: its slides are along dependent axes.")
        joint.rows = self._rows_across(A, B, there, axes) + self._rows_about(name, first, second, hinges)
        sign = -1.0 if behind else 1.0
        for (key, _), along in zip(slides, np.linalg.pinv(axes).T, strict=True):
            self._coordinate_joint(key, "slide", joint, "travel", A, B, a=there, b=there, u=sign * along)
        self._angles(joint, hinges)
        return name

    def _ordered(self, name: str, steps: list[Any]) -> tuple[list[Any], list[Any], bool]:
        """Slides, hinges, and whether the slides are behind the hinges."""
        slides = [(key, axis) for key, kind, axis in steps if kind == "slide"]
        hinges = [(key, axis) for key, kind, axis in steps if kind != "slide"]
        if len(slides) > 3 or len(hinges) > 3:
            raise ProblemError(f"joint {name!r}: at most three slides and three hinges have rows.")
        turned: list[Any] = []
        early = late = True
        for k, (_, kind, axis) in enumerate(steps):
            if kind != "slide":
                turned.append(axis)
                continue
            after = [x for _, other, x in steps[k:] if other != "slide"]
            early = early and all(_parallel(axis, x) for x in turned)
            late = late and all(_parallel(axis, x) for x in after)
        if not early and not late:
            raise ProblemError(
                f"joint {name!r}: slides both before and behind hinges across them have no rows; put a body between them."
            )
        return slides, hinges, not early

    def _rows_across(self, A: str, B: str, there: Any, axes: Any) -> list[Any]:
        """Rows of a point of B in the span of ``axes`` in A."""
        if not len(axes):
            return [self.row("point", A, B, a=there, b=there)]
        across = np.linalg.svd(axes)[2][len(axes) :]
        return [self.row("slide", A, B, a=there, b=there, u=u) for u in across]

    def _rows_about(self, name: str, first: str, second: str, hinges: list[Any]) -> list[Any]:
        """Rows of the rotation."""
        axes = [axis for _, axis in hinges]
        if any(axis is None for axis in axes) or len(axes) == 3:
            if len(axes) == 3 and np.linalg.matrix_rank(np.array(axes), RIGHT) < 3:
                raise ProblemError(f"joint {name!r}: its three hinges have dependent axes.")
            return []
        if len(axes) == 2:
            if _parallel(*axes):
                raise ProblemError(f"joint {name!r}: its hinges have parallel axes; put a body between them.")
            return [self.row("dot", first, second, u=axes[0], w=axes[1], value=axes[0] @ axes[1])]
        e = np.eye(3) if not axes else frame_along(axes[0])
        rows = [self.row("dot", first, second, u=e[:, i], w=e[:, 2]) for i in (0, 1)]
        return rows if axes else [*rows, self.row("turn", first, second, u=e[:, 0], y=e[:, 1], w=e[:, 0])]

    def _angles(self, joint: Joint, hinges: list[Any]) -> None:
        """Coordinates of hinges: the outer ones by the direction of the other's axis, seen along their own."""
        names, axes = [key for key, _ in hinges], [axis for _, axis in hinges]
        P, C = joint.first, joint.second
        if not axes or axes[0] is None:
            return
        if len(axes) == 1:
            e = frame_along(axes[0])
            self._coordinate_joint(names[0], "hinge", joint, "angle", P, C, u=e[:, 0], y=e[:, 1], w=e[:, 0])
            return
        one, last = axes[0], axes[-1]
        if len(axes) == 3:
            sharp = one @ last
            if abs(axes[1] @ one) > RIGHT or abs(axes[1] @ last) > RIGHT or abs(sharp) > 1 - RIGHT:
                return  # a ball joint, whose angles are not known
            sign = np.sign(np.cross(one, last) @ axes[1])
            start = np.arccos(sharp if sign > 0 else -sharp)
            self._coordinate_joint(names[1], "tilt", joint, "tilt", P, C, u=one, w=sign * last, value=start)
        for key, axis, other, pair, sign in ((names[0], one, last, (P, C), 1.0), (names[-1], last, one, (C, P), -1.0)):
            u = unit("axis", other - axis * (axis @ other), 3)
            self._coordinate_joint(key, "hinge", joint, "angle", *pair, u=u, y=sign * np.cross(axis, u), w=other)

    def _coordinate_joint(
        self, name: str, kind: str, owner: Joint, measure: str, first: str, second: str, **given: Any
    ) -> None:
        self._expect_new(name)
        self.row("coordinate", first, second, **given)
        made = Joint(**vars(owner) | {"name": name, "kind": kind, "base": kind, "rows": []})
        made.measured = measure, self.rows.pop("coordinate")[0]
        self.joints[name] = made

    def _measured(self, joint: str, family: str, travel: bool = False) -> str:
        """Add to ``family`` a row that measures the coordinate of ``joint``; its kind."""
        one = self._find(joint, *TURNING, *SLIDING, "tilt")
        if one.measured is not None:
            kind, row = one.measured
            made = type(row)(**vars(row) | {"more": {}})
            self.rows.setdefault(family, []).append(made)
        elif one.kind == "prismatic" or travel:
            kind = "travel"
            self._travel(one, None, family)
        else:
            kind = "angle"
            self._turn(one, None, family)
        return kind

    def actuator(
        self,
        name: str,
        joint: str,
        effort: Law | float | None = None,
        *,
        stiffness: float = 0.0,
        damping: float = 0.0,
        free: float = 0.0,
        armature: float = 0.0,
        axis: Any = None,
    ) -> str:
        """Motor, spring, damper and rotor on the coordinate of a joint, an angle or a travel from the drawn pose.

        Parameters
        ----------
        effort
            Force [N] or torque [N m] along the coordinate: a number or a function of time in ``jax.numpy``.
        stiffness, damping, free
            Of a spring [N/m, N m/rad] and damper, without force at the coordinate ``free``.  In space the quaternions do not
            count turns: 2.89 rad from ``free`` the spring's moment is not a number, which ends a run.
        armature
            Inertia [kg, kg m^2] of the rotor about the coordinate.
        axis
            Of the torque of a motor on a ball joint, which turns with the second body.
        """
        self._expect_new(name)
        self._expect_numbers(name, stiffness=stiffness, damping=damping, free=free, armature=armature)
        law = self._law(f"actuator {name!r}", effort)
        kind = "drive"
        if joint in self.joints and self.joints[joint].kind == "spherical":
            one, kind = self.joints[joint], "swivel"
            if stiffness:
                raise ProblemError(f"actuator {name!r}: a ball joint has no spring of one coordinate; type m.bushing(...).")
            self.row(kind, one.first, one.second, w=axis)
            more: dict[str, Any] = {"damping": damping, "inertia": armature}
        else:
            more = {"kind": self._measured(joint, kind)}
            more |= {"stiffness": stiffness, "damping": damping, "free": free, "inertia": armature}
        row = self.rows[kind][-1]
        row.more, row.law = more, law
        self.forces[name] = Element(name=name, kind=kind, number=len(self.rows[kind]) - 1)
        return name

    def couple(self, name: str, joint: str, other: str | None, polynomial: Any) -> str:
        """Coordinate of ``joint`` as a polynomial (5,) of that of ``other``, the constant first; both from the drawn pose.

        Angles in space are within half a turn at the start; later they have any number of turns if the polynomial is a
        slope that is a fraction.
        """
        self._expect_new(name)
        c = np.zeros(5)
        c[: np.size(polynomial)] = polynomial
        self._expect_numbers(name, polynomial=c)
        kinds = self._measured(joint, "couple"), self._measured(other or joint, "couple other")
        c = c if other else c * (np.arange(5) == 0)
        slope = Fraction(float(c[1])).limit_denominator(LARGEST_TEETH)
        whole = "angle" in kinds[1] and not c[2:].any() and abs(float(slope) - c[1]) < 1e-12 * max(1.0, abs(c[1]))
        self.rows["couple"][-1].more |= {"kinds": kinds, "polynomial": c, "teeth": slope.denominator if whole else 1}
        owner = self.joints[joint]
        self.joints[name] = self._on(owner, name, "couple", [("couple", len(self.rows["couple"]) - 1)])
        self.joints[name].measured = None
        return name


def _parallel(a: Any, b: Any) -> bool:
    return a is not None and b is not None and bool(np.linalg.norm(np.cross(a, b)) <= RIGHT)
