"""Steps that do not resolve a motion: too long for what forces do in one, or too short for positions."""

from __future__ import annotations

import math
from contextlib import suppress

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import uncounted
from hhtbench.errors import BudgetSpent, NonFiniteValue
from solvers.hht.equations.formulas import EPS
from solvers.hht.run.engine import Engine

LOOKS = 12  # how often along a run
FEW = 16.0  # roundoffs of v, which a step may err by
SHARE = 0.1  # of what accelerations change v by in a step: a friction that errs by more is another one


def steep_forces(t: Vector, h: Vector, v: Matrix, a: Matrix) -> str:
    """That forces change v by more than its size within one of the steps ``h`` (k,) to t, v and a (k, n), in words; or none.

    What begins and ends between two looks at the forces, as contact does, throws the motion anywhere.
    """
    if not (a.max() - a.min()) * np.abs(h).max() > np.abs(v[-1]).max():  # most motions, in a tenth of the time
        return ""
    changes = np.abs(np.diff(a, axis=0)).max(axis=1, initial=0.0) * np.abs(h[1:])
    most, size = float(changes.max(initial=0.0)), float(np.abs(v).max())
    if not most > size:
        return ""
    end = t[1 + int(changes.argmax())]
    return (
        f"In the step to t = {end:.10g} forces change by what moves v by {most:.2g}, and v is {size:.2g} at most: steps do "
        "not resolve such forces; compare with shorter ones, or with error control."
    )


def moved_by_roundoff(engine: Engine, t: Matrix, h: Matrix, q: Matrix, v: Matrix) -> str:
    """That roundoff of positions has moved v in steps ``h`` (k, 1) to t, q, v (k, n), in words; or none.

    g(q1) = 0 holds to eps |q|, which the multipliers at a step's start feel as eps |q| / h^2.  Those at its end take that
    back for the velocities, (H5), where the reaction is linear in both; friction, say, by their sizes adds up.  It tells
    where steps are too short for positions to see an acceleration: there v1 - v0 = h (v0' + v1')/2 up to roundoff.
    """
    if engine.structure.linear_reaction or not engine.structure.m:
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
    if not error > SHARE * moved:
        return ""
    longest = float(np.abs(h[led, 0]).max())
    return (
        f"roundoff: steps of {longest:.2g} s are so short that roundoff of positions makes their multipliers, and the "
        f"reaction, not linear in these, moves v by {error:.2g} in a step besides the {moved:.2g} of accelerations; take "
        f'steps longer than {shortest:.2g} s, or reaction="midpoint", which does not feel it'
    )
