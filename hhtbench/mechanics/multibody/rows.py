"""Residuals of joints between bodies, one vectorised family for each kind of row.

Every joint is made of a few of these families, so that any number of joints compiles like a handful.  Points and
directions are in the frames of their bodies: ``a, u, x, y`` of the first, ``b, w`` of the second.
Source: P. E. Nikravesh, Computer-Aided Analysis of Mechanical Systems, Prentice Hall 1988, chapters 4 and 7.
"""

from __future__ import annotations

import functools
import inspect
import operator
from collections.abc import Callable
from numbers import Integral
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax import Array

from hhtbench.mechanics import space
from hhtbench.mechanics.forces import distances
from hhtbench.mechanics.multibody.frames import Placed
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.system import parameter

Law = Callable[[Any], Any]  # a function of time


class OfTime(eqx.Module):
    """A function of time or of values by name, whose ``numbers`` are parameters: new values reuse the compiled code."""

    function: Callable[..., Any] = eqx.field(static=True)  #: of the arguments, then time
    numbers: tuple[Any, ...] = ()
    integers: tuple[int | None, ...] = eqx.field(static=True, default=())  #: arguments; None stands for the next number
    takes: tuple[str, ...] = eqx.field(static=True, default=("t",))  #: names of the arguments behind these

    def __call__(self, given: Any) -> Any:
        """Value at a time [s], or at what is ``given`` by name."""
        numbers = iter(self.numbers)
        at = [given[name] for name in self.takes] if isinstance(given, dict) else [given]
        return self.function(*(next(numbers) if x is None else x for x in self.integers), *at)


def of_time(law: Law | None, names: tuple[str, ...] = (), *, strict: bool = False) -> OfTime | None:
    """``law`` as an object whose parameters are the numbers of a ``functools.partial``; None without a law.

    Integers, which may count or index, stay what they are: a new one compiles anew.  ``names`` are those of the arguments
    that it may take instead of time.  A single argument of another name is time, unless ``strict``.
    """
    takes = _taken(law, names, strict)
    if isinstance(law, functools.partial) and not law.keywords and all(np.asarray(x).dtype.kind in "iuf" for x in law.args):
        integers = tuple(operator.index(x) if isinstance(x, Integral) else None for x in law.args)
        numbers = (jnp.asarray(x, dtype=float) for x, integer in zip(law.args, integers, strict=True) if integer is None)
        return OfTime(law.func, tuple(numbers), integers, takes)
    return law if law is None else OfTime(law, takes=takes)


def _taken(law: Law | None, names: tuple[str, ...], strict: bool) -> tuple[str, ...]:
    """Names of the arguments of ``law``; "t" for one of another name."""
    try:
        parameters = () if law is None else inspect.signature(law).parameters.values()
    except ValueError:  # a function of C
        parameters = ()
    found = tuple(one.name for one in parameters if one.kind <= one.POSITIONAL_OR_KEYWORD and one.default is one.empty)
    if found and all(name in names for name in found):
        return found
    if len(found) > 1 or (found and strict):
        known = f"or any of {', '.join(names)}" if names else "and nothing else"
        raise ProblemError(f"a law takes time, {known}; got the arguments {', '.join(found)}.")
    return ("t",)


class Rows(eqx.Module):
    """j rows of one family; arrays that the family does not use are zero."""

    first: tuple[int, ...] = eqx.field(static=True)  #: bodies, the ground is the last
    second: tuple[int, ...] = eqx.field(static=True)
    laws: tuple[OfTime | None, ...]  #: prescribed values, None for a constant
    a: Any = parameter(doc="points of the first bodies (j, d) [m]")
    b: Any = parameter(doc="points of the second bodies (j, d) [m]")
    u: Any = parameter(doc="directions of the first (j, d)")
    w: Any = parameter(doc="directions of the second (j, d)")
    y: Any = parameter(doc="further directions of the first (j, d)")
    value: Any = parameter(doc="constants (j,)")

    def __len__(self) -> int:
        return len(self.first)

    def part(self, chosen: Any) -> Rows:
        """The rows numbered ``chosen`` (i,)."""
        pairs = [tuple(bodies[i] for i in chosen) for bodies in (self.first, self.second, self.laws)]
        values = {name: jnp.asarray(getattr(self, name))[chosen] for name in ("a", "b", "u", "w", "y", "value")}
        return Rows(first=pairs[0], second=pairs[1], laws=pairs[2], **values)

    def points(self, at: Placed) -> tuple[Array, Array]:
        """Points (j, d) of the first and of the second bodies in space."""
        return at.point(self.first, self.a), at.point(self.second, self.b)

    def driven(self, t: Any, found: Array) -> Array:
        """``found`` (j,) less the prescribed values at time ``t``."""
        for i, law in enumerate(self.laws):
            found = found if law is None else found.at[i].add(-law(t))
        return found


def point(at: Placed, rows: Rows, t: Any) -> Array:
    """Points of the first less points of the second, (d j,) [m]."""
    first, second = rows.points(at)
    return (first - second).ravel()


def dot(at: Placed, rows: Rows, t: Any) -> Array:
    """Scalar products of directions ``u`` and ``w`` less ``value``, (j,)."""
    return jnp.sum(at.along(rows.first, rows.u) * at.along(rows.second, rows.w), axis=1) - rows.value


def slide(at: Placed, rows: Rows, t: Any) -> Array:
    """Travels of points ``b`` from points ``a`` along ``u``, less prescribed ones, (j,) [m]."""
    return rows.driven(t, travels(at, rows) - rows.value)


def travels(at: Placed, rows: Rows) -> Array:
    """Travels (j,) [m] of points ``b`` from points ``a`` along ``u``."""
    first, second = rows.points(at)
    return jnp.sum(at.along(rows.first, rows.u) * (second - first), axis=1)


def distance(at: Placed, rows: Rows, t: Any) -> Array:
    """Squares of distances less those of ``value``, over twice ``value``: near that the change of distance, (j,) [m]."""
    first, second = rows.points(at)
    return (jnp.sum((first - second) ** 2, axis=1) - rows.value**2) / (2 * rows.value)


def turn(at: Placed, rows: Rows, t: Any) -> Array:
    """Angles of the second about the first less prescribed ones, (j,) [rad]; in space their sines, for any number of turns.

    In space ``sin(angle - law) = s cos(law) - c sin(law)`` of the cosine c = u.w and the sine s = y.w.
    """
    if at.angle is not None:
        return rows.driven(t, angles(at, rows))
    cosine, sine = _cosine_and_sine(at, rows)
    for i, law in enumerate(rows.laws):
        if law is not None:
            sine = sine.at[i].set(sine[i] * jnp.cos(law(t)) - cosine[i] * jnp.sin(law(t)))
    return sine


def angles(at: Placed, rows: Rows) -> Array:
    """Angles (j,) [rad] of the second about the first from the drawn pose; in space within half a turn of ``value``."""
    if at.angle is not None:
        return at.angle[jnp.array(rows.second)] - at.angle[jnp.array(rows.first)] - rows.value
    cosine, sine = _cosine_and_sine(at, rows)
    return jnp.arctan2(sine, cosine) + rows.value


def counted(at: Placed, rows: Rows, near: Any) -> Array:
    """Angles (j,) [rad] of the second about the first; in space within one turn of ``value`` in either direction.

    A quaternion holds half the angle, so it shows two turns.  ``near`` (j, 2, 4): the quaternions of the second bodies in
    the first at the angles ``value``, and their derivatives by half the angle.
    """
    if at.p is None:
        return angles(at, rows)
    one, other = at.p[np.array(rows.first)], at.p[np.array(rows.second)]
    vector = jnp.einsum("jik,jk->ji", space.body_rate_matrix(one), other)
    relative = jnp.concatenate([jnp.sum(one * other, axis=1, keepdims=True), vector], axis=1)
    cosine, sine = jnp.einsum("jik,jk->ij", jnp.asarray(near), relative)
    return rows.value + 2 * jnp.arctan2(sine, cosine)


def _cosine_and_sine(at: Placed, rows: Rows) -> tuple[Array, Array]:
    w = at.along(rows.second, rows.w)
    return jnp.sum(at.along(rows.first, rows.u) * w, axis=1), jnp.sum(at.along(rows.first, rows.y) * w, axis=1)


def lengths(at: Placed, rows: Rows) -> Array:
    """Distances (j,) [m] of points ``a`` and ``b``."""
    return distances(*rows.points(at))


class Gears(eqx.Module):
    """Angles that teeth couple to other angles, or threads to travels: ``angle + ratio other = 0``."""

    angle: Rows
    other: Rows  #: angles of gears; travels of screws
    ratio: Any = parameter(doc="turns of the first per unit of the other (j,)")
    teeth: Any = parameter(doc="of the first (j,)")
    counted: bool = eqx.field(static=True, default=False)  #: whether the turns of the angles are known


def gear(at: Placed, gears: Gears, t: Any) -> Array:
    """Angles of the first gears plus ``ratio`` times those of the others, (j,) [rad].

    In space, where angles are known up to whole turns, ``sin(teeth phase) / teeth``: whole teeth change nothing.
    """
    return _phase(at, gears, angles(at, gears.angle) + gears.ratio * angles(at, gears.other))


def screw(at: Placed, screws: Gears, t: Any) -> Array:
    """Angles plus ``ratio`` times travels, (j,) [rad]; in space their sines."""
    return _phase(at, screws, angles(at, screws.angle) + screws.ratio * travels(at, screws.other))


def _phase(at: Placed, gears: Gears, phase: Array) -> Array:
    return phase if at.angle is not None or gears.counted else jnp.sin(gears.teeth * phase) / gears.teeth


class Rolling(eqx.Module):
    """Discs and balls on planes of second bodies."""

    rows: Rows  #: ``a`` the centre, ``u`` the disc's unit axis (0 for a ball), ``b`` and ``w`` point and normal of the plane
    radius: Any = parameter(doc="(j,) [m]")
    across: Any = parameter(doc="directions (j, d - 1, d) of the plane, in the second body")

    def lowest(self, at: Placed) -> Array:
        """Points (j, d) of the discs that are the nearest to the plane."""
        normal, axis = at.along(self.rows.second, self.rows.w), at.along(self.rows.first, self.rows.u)
        down = normal - jnp.sum(normal * axis, axis=1, keepdims=True) * axis
        return at.point(self.rows.first, self.rows.a) - self.radius[:, None] * down / jnp.linalg.norm(down, axis=1)[:, None]


def height(at: Placed, rolling: Rolling, t: Any) -> Array:
    """Heights (j,) [m] of the lowest points above the plane."""
    above = rolling.lowest(at) - at.point(rolling.rows.second, rolling.rows.b)
    return jnp.sum(at.along(rolling.rows.second, rolling.rows.w) * above, axis=1)


def slip(frame: Any, rolling: Rolling, q: Array, v: Array) -> Array:
    """Velocities ((d - 1) j,) [m/s] of the points of contact along the plane: zero without slip."""
    at, pairs = frame.placed(q), (rolling.rows.first, rolling.rows.second)
    lowest = rolling.lowest(at)
    one, other = (frame.velocity_at(q, v, bodies, lowest - at.x[np.array(bodies)]) for bodies in pairs)
    across = [at.along(pairs[1], rolling.across[:, i]) for i in range(rolling.across.shape[1])]
    parts = [jnp.sum(direction * (one - other), axis=1) for direction in across]
    return jnp.concatenate(parts)


def turning(frame: Any, rows: Rows, q: Array, v: Array) -> Array:
    """Rates (j,) [rad/s] of the second bodies about the first, about their axes ``b``."""
    w = frame.rates(q, v)
    apart = w[jnp.array(rows.second)] - w[jnp.array(rows.first)]
    return apart if apart.ndim == 1 else jnp.sum(apart * frame.placed(q).along(rows.second, rows.b), axis=1)


class Curves(eqx.Module):
    """Points of second bodies on curves of first ones."""

    rows: Rows
    functions: tuple[Callable[[Any], Any], ...] = eqx.field(static=True)  #: zero on the curve, of a point (d,)


def curve(at: Placed, curves: Curves, t: Any) -> Array:
    """Values of the curves' functions at the points ``b`` in the frames of the first bodies."""
    local = at.local(curves.rows.first, at.point(curves.rows.second, curves.rows.b))
    found = [jnp.ravel(function(x)) for function, x in zip(curves.functions, local, strict=True)]
    return jnp.concatenate(found)


FAMILIES: dict[str, Callable[[Placed, Any, Any], Array]] = {
    "point": point,
    "dot": dot,
    "slide": slide,
    "distance": distance,
    "turn": turn,
    "gear": gear,
    "screw": screw,
    "curve": curve,
    "rolling": height,
}
