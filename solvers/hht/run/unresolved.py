"""Steps that do not resolve a motion: too long for what forces do in one, too short for positions, or beside roundoff."""

from __future__ import annotations

import math
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import uncounted
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.result import Status
from solvers._start import Failure, of_dynamics
from solvers.hht.equations.formulas import EPS, TINY
from solvers.hht.loops import memory as mem
from solvers.hht.run.engine import Engine, not_extrapolated
from solvers.hht.step.state import State

LOOKS, QUICK = 12, 64  # how often along a run, at most; coordinates up to which a look takes little
UNSEEN = 1e-9  # of q: forces that move it by less in a step are those of rest
SUSPECT = 0.25  # of what a coordinate's velocity is, changes of forces are worth a look
STEEP = 0.5  # of what v is along them: (h w)^2 of what throws it about, by which a step errs
BEFORE, AFTER = 2, 2  # rows beside a step in which v has a size
HELD = 0.5  # of what forces change v by in a step, at most, that it turns by where constraints hold against them
SLIPS = 0.05  # of the way of q: by more than velocities tell it is moved by what velocity constraints hold of forces
MOVED_BY_ROUNDOFF = "roundoff moves q or v by"  # how the message of a failure by it goes on
TOLD = 1e-6  # of q or v: less is below any tolerance that is usual
FEW = 16.0  # roundoffs of v, which a step may err by
SHARE = 0.1  # of what accelerations change v by in a step: a friction that errs by more is another one


def is_resolved(h: Matrix, v: Matrix, a: Matrix) -> bool:
    """Whether accelerations a (k, n) change v, by coordinate, by less than its mean size in steps ``h`` (k, 1)."""
    most, longest = np.maximum(a.max(axis=0), -a.min(axis=0)), float(max(h.max(), -h.min()))
    with np.errstate(all="ignore"):
        return bool((most * longest <= np.abs(v).mean(axis=0)).all())


def steep_forces(engine: Engine, t: Matrix, h: Matrix, q: Matrix, v: Matrix, a: Matrix, *, prescribed: bool) -> str:
    """That forces change v by about its size within one of the steps ``h`` (k, 1) to t, q, v and a (k, n), or none.

    In words.  What counts is the part that constraints leave free, beside what v is along it near that step.  Forces that
    constraints hold against have such a part where these turn: extrapolated multipliers follow it, (H55).  What begins and
    ends between two looks at the forces, as contact does, throws the motion anywhere.
    """
    with np.errstate(all="ignore"):
        changes, speeds = np.abs(np.diff(a, axis=0)) * np.abs(h[1:]), np.abs(v)
        near = np.maximum(speeds[:-1], speeds[1:])
        steep = changes > SUSPECT * near
        if not steep.any():
            return ""
        ratios = np.where(steep, changes / np.fmax(near, TOLD * changes), 0.0).max(axis=1)
        sudden = np.where(steep, changes / np.fmax(changes.mean(axis=0), TOLD * changes), 0.0).max(axis=1)
        order, count = np.argsort(-ratios)[: np.count_nonzero(ratios)], max(LOOKS * QUICK // max(v.shape[1], QUICK), 1)
        first = np.argsort(-sudden)[: min(count, order.size)]  # loads that constraints hold change all the time
        looked = np.unique([*order[:count], *first, *order[:: -(-order.size // count)]])
        found = [x for i in looked.tolist() if (x := _steep(engine, i, t, h, q, v, a))]
    found = [x for x in found if prescribed or x.held]  # error control finds what throws the motion
    if not found:
        return ""
    worst, others = max(found, key=lambda x: x.moved / max(x.speed, TOLD * x.moved)), ["with a tighter tolerance"]
    if prescribed:
        others = ["with shorter ones", "with error control"]
    extrapolates = engine.method.extrapolated or not_extrapolated(engine.dynamics.system)
    if worst.held and engine.structure.m and engine.structure.mass != "sparse" and not extrapolates:
        others.append("with extrapolate_reaction=True, which follows those that constraints hold against")
    name = f"v[{worst.at}]"
    return (
        f"In the step to t = {worst.t:.10g} forces change by what moves {name} by {worst.moved:.2g}, and {name} is "
        f"{worst.speed:.2g} at most near it: steps do not resolve such forces; compare {' or '.join(others)}."
    )


class Steep(NamedTuple):
    """A step in which forces change v by about its size."""

    t: float  #: its end [s]
    at: int  #: the coordinate that they move most
    moved: float  #: what they change its velocity by
    speed: float  #: the largest along the same way in the steps near it
    held: bool  #: whether constraints hold most of it, and v does not follow


def _steep(engine: Engine, i: int, t: Matrix, h: Matrix, q: Matrix, v: Matrix, a: Matrix) -> Steep | None:
    """Of the step from row ``i``; None where forces change v by less, or move q by next to nothing."""
    change, length = (a[i + 1] - a[i]) * h[i + 1], abs(float(h[i + 1, 0]))
    if not np.isfinite(change).all():
        return None
    with uncounted(), suppress(BudgetSpent, NonFiniteValue):
        m, p, place = engine.structure.m, engine.structure.p, (float(t[i, 0]), q[i].copy(), v[i].copy())
        free = engine.acceleration.left_free(*place, change, m)
        if free is None:
            return None
        along, mass = free
        index, moved = int(np.abs(along).argmax()), float(np.abs(along).max())
        way, size = float(np.ptp(q, axis=0).max()), float(np.abs(q[:, index]).max())
        seen = moved > TOLD * np.abs(change).max() and moved * length > max(UNSEEN * way, FEW * EPS * size)
        if not (seen and math.isfinite(moved)):
            return None
        both = engine.acceleration.left_free(*place, change, m + p) if p else free
        if both is not None and np.abs(both[0]).max() < HELD * moved and not _slips(h, q, v, index):
            return None  # velocity constraints hold it
        weighted = mass @ along / moved  # squares of what is large are no numbers
        size = float(along @ weighted) / moved
        near = slice(max(i - BEFORE, 0), i + 2 + AFTER)
        speeds = (v[near] @ weighted) / size
        turns = np.diff(speeds[max(i - near.start - 1, 0) :][:4], n=2)
        speed = float(np.abs(speeds).max())
        if moved > STEEP * speed:
            ignored = float(np.abs(turns).max(initial=0.0)) < HELD * moved
            held = ignored and _is_held(engine, place, a[i] / np.abs(a[i]).max())
            return Steep(float(t[i + 1, 0]), index, moved, speed, held)
    return None


def _slips(h: Matrix, q: Matrix, v: Matrix, index: int) -> bool:
    """Whether q[index] goes visibly where its velocity does not lead, in steps ``h`` (k, 1) to q, v (k, n)."""
    led = 0.5 * h[1:, 0] * (v[1:, index] + v[:-1, index])
    return float(np.abs(q[1:, index] - q[0, index] - np.cumsum(led)).max()) > SLIPS * float(np.ptp(q, axis=0).max())


def _is_held(engine: Engine, place: tuple[float, Vector, Vector], a: Vector) -> bool:
    """Whether constraints hold most of what forces accelerate by at ``place``, t, q and v, along ``a`` (n,)."""
    free = engine.acceleration.left_free(*place, a, engine.structure.m)
    return free is not None and float(free[0] @ (free[1] @ free[0])) < HELD * float(a @ (free[1] @ a))


def moved_by_roundoff(engine: Engine, t: Matrix, h: Matrix, q: Matrix, v: Matrix) -> str:
    """That roundoff of positions has moved v in steps ``h`` (k, 1) to t, q, v (k, n), in words; or none.

    g(q1) = 0 holds to eps |q|, which the multipliers at a step's start feel as eps |q| / h^2.  Those at its end take that
    back for the velocities, (H5), where the reaction is linear in both; friction, say, by their sizes adds up.  It tells
    where steps are too short for positions to see an acceleration: there v1 - v0 = h (v0' + v1')/2 up to roundoff.
    """
    if engine.structure.linear_reaction or not engine.structure.m:
        return ""
    fastest, elapsed = float(np.abs(v).max()), abs(float(t[-1, 0] - t[0, 0]))
    if not fastest * elapsed > FEW * EPS * float(np.abs(q).max()):  # nothing moves
        return ""
    led = np.flatnonzero(h[1:, 0]) + 1
    errors, changes, shortest = [0.0], [0.0], 0.0
    with uncounted(), suppress(BudgetSpent, NonFiniteValue):
        for i in led[np.unique(np.linspace(0, led.size - 1, min(LOOKS, led.size)).astype(int))].tolist():
            a0, a1 = (engine.acceleration.solve(float(t[j, 0]), q[j], v[j]).vdot for j in (i - 1, i))
            seen = math.sqrt(EPS * float(np.abs(q[i]).max()) / max(float(np.abs(a0).max()), EPS))
            if abs(h[i, 0]) < seen:
                change = h[i, 0] * (a0 + a1) / 2.0
                error = float(np.abs(v[i] - v[i - 1] - change).max())
                errors.append(max(error - FEW * EPS * float(np.abs(v[i]).max()), 0.0))
                changes.append(float(np.abs(change).max()))
                shortest = max(shortest, seen)
    error, moved = float(np.mean(errors)), float(np.mean(changes))
    if not error > max(SHARE * moved, UNSEEN * fastest / led.size):
        return ""
    longest = float(np.abs(h[led, 0]).max())
    return (
        f"roundoff: steps of {longest:.2g} s are so short that roundoff of positions makes their multipliers, and the "
        f"reaction, not linear in these, moves v by {error:.2g} in a step besides the {moved:.2g} of accelerations; take "
        f"steps longer than {shortest:.2g} s{_or_midpoint(engine)}"
    )


def off_constraints(engine: Engine, t: Matrix, h: Matrix, q: Matrix, v: Matrix, a: Matrix) -> str:
    """That roundoff of accelerations that cancel one another has moved rows off the constraints, in words; or none.

    Of steps ``h`` (k, 1) to t, q, v and a (k, n).  Accelerations A round q1 to eps h^2 A, and what holds the place beside it
    turns by that over |q|: v1 is off by h A as much.  The iteration sees its own q1 and v1, which round otherwise.  A v
    that roundoff has made is no size to measure by: that is the speed of the first row, or |q| over the time, if more.
    """
    largest, longest, size = float(np.abs(a).max()), float(np.abs(h).max()), float(np.abs(q).max())
    speed = max(float(np.abs(v[0]).max()), size / (abs(float(t[-1, 0] - t[0, 0])) or math.inf))
    most, moved = engine.functions.newton.coarse, longest * largest
    if not _turns_with_roundoff(engine, longest, largest, speed * size):
        return ""
    if not size > FEW * EPS * longest * moved:  # held in the origin: q is roundoff itself
        return ""
    least = max(most * speed, TOLD * float(np.abs(v).max())) / speed
    jumps = np.argsort(np.abs(np.diff(v, axis=0)).max(axis=1))[-LOOKS:] + 1  # it throws v about
    spread = np.linspace(0, len(t) - 1, min(LOOKS, len(t))).astype(int)
    with uncounted(), suppress(BudgetSpent, NonFiniteValue):
        levels = of_dynamics(engine.dynamics).levels
        for i in np.unique(np.concatenate([spread, jumps])).tolist():
            at = levels.at(float(t[i, 0]), q[i], v[i])
            in_q, in_v = at.scaled_position(size).max(initial=0.0), at.scaled_velocity(speed).max(initial=0.0)
            if in_q > most or in_v > least:
                return (
                    f"roundoff: at t = {t[i, 0]:.10g} q is off the constraints by {in_q:.2g} of its size, v by {in_v:.2g}, "
                    f"since accelerations of {largest:.2g} cancel one another; take smaller steps"
                )
    return ""


def _turns_with_roundoff(engine: Engine, h: float, largest: float, action: float) -> bool:
    """Whether roundoff of accelerations up to ``largest`` turns them visibly in a step of h; ``action`` is |q| |v|."""
    moved = h * largest
    return engine.structure.constrained and EPS * h * moved * moved > engine.functions.newton.coarse * action


def lost_by_roundoff(engine: Engine, t: Matrix, q: Matrix, v: Matrix, a: Matrix) -> str:
    """That the step after t, q, v, a (k, n) could be anywhere for the roundoff of accelerations that cancel; or none."""
    h, largest = abs(float(engine.loops.section(mem.ATTEMPT)[mem.H_TRIED])), float(np.abs(a[-1]).max())
    size = float(np.abs(q[-1]).max())
    speed = max(float(np.abs(v[0]).max()), size / (h + abs(float(t[-1, 0] - t[0, 0])) or math.inf))
    if not _turns_with_roundoff(engine, h, largest, size * speed):
        return ""
    return (
        f"roundoff: accelerations of {largest:.2g} that cancel one another leave the place open in a step of {h:.2g} s, "
        "and the constraints have lost rank there; take smaller steps"
    )


def left_by_roundoff(engine: Engine, q: Matrix, rtol: float) -> str:
    """What share of q or v roundoff has left unknown in a step, in words; or none where it is little, or below ``rtol``.

    None where q (k, n) rests: a share of v is nothing then.
    """
    share = float(engine.loops.section(mem.ATTEMPT)[mem.LEFT])
    if not share > max(TOLD, rtol) or (np.ptp(q, axis=0) <= UNSEEN * np.abs(q).max(axis=0)).all():
        return ""
    return (
        f"Roundoff leaves up to {share:.2g} of q or v unknown in a step: reactions that cancel one another are large, "
        "rows of the constraints nearly depend on others, or steps are too short for positions to see them."
    )


def swept(engine: Engine) -> str:
    """That a coordinate went, in a step, a way of which its velocities tell nothing, in words; or none."""
    numbers = engine.loops.section(mem.ATTEMPT)
    if not numbers[mem.SWEPT]:
        return ""
    at, name = f"In the step to t = {numbers[mem.SWEPT_AT]:.10g}", f"q[{int(numbers[mem.SWEPT]) - 1}]"
    return (
        f"{at} constraints move {name} a way of which v at both ends tells nothing: steps do not resolve what moves it; "
        "compare with shorter ones or with error control."
    )


def by_positions(engine: Engine, state: State, h: float) -> float:
    """What share of v roundoff of positions leaves open in a step of ``h`` [s] from ``state``; 0 where it is little.

    Where they alone are held, and increments have been left to roundoff.
    """
    if engine.method.coefficients.both_levels:
        return 0.0
    speed = max(float(np.abs(state.v).max()), abs(h) * float(np.abs(state.f).max()), TINY)
    here, left = FEW * EPS * state.size_q / (abs(h) * speed), float(engine.loops.section(mem.ATTEMPT)[mem.LEFT])
    return left if min(here, left) > TOLD else 0.0


def coarse_roundoff(engine: Engine, state: State, h: float, share: float, where: str, *, prescribed: bool) -> Failure:
    """Of a step of ``h`` [s] from ``state`` in which roundoff left increments of a ``share`` of q or v.

    Accelerations A that cancel one another leave eps h^2 A in q, multipliers eps |q| / h^2 to a reaction not linear in them,
    and positions, where they alone are held, eps |q| / h in v.
    """
    told = f"{MOVED_BY_ROUNDOFF} {share:.2g} of their sizes"
    is_short = h * h * float(np.abs(state.f).max()) < state.size_q
    if is_short and not engine.method.coefficients.both_levels:
        text = f"{told}: positions alone are held, and leave eps |q| / h of v open in so short a step"
        return Failure(Status.time_resolution, f"{text}, {where}; take a larger step, or hht, which holds velocities too")
    if engine.structure.linear_reaction or not is_short:
        remedy = "take a smaller step" if prescribed else "leave out what only strains the mechanism"
        text = f"{told}: forces and reactions that cancel one another are too large, {where}; {remedy}"
        return Failure(Status.newton_failed, f"Newton's iteration did not converge: {text}")
    text = f"{told} by the multipliers of so short a step, which the reaction is not linear in"
    return Failure(Status.time_resolution, f"{text}, {where}; take a larger step{_or_midpoint(engine)}")


def _or_midpoint(engine: Engine) -> str:
    """The reactions that do not feel the roundoff of positions, as another remedy; none where other options forbid it."""
    method = engine.method
    if method.reaction == "midpoint" or method.coefficients.b != 0.0:
        return ""
    return ', or reaction="midpoint", which does not feel it'
