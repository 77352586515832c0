"""Functions of a system with noise: calls with the same arguments differ, or those with nearly the same differ as much."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from hhtbench.arguments import Matrix, Vector
from hhtbench.counting import uncounted
from hhtbench.errors import BudgetSpent, NonFiniteValue
from hhtbench.lowering import Dynamics, route_of
from hhtbench.protocol import declared
from solvers._trust import as_arguments
from solvers.hht.control.tolerances import Tolerances
from solvers.hht.equations.formulas import EPS, TINY
from solvers.hht.run.engine import Engine
from solvers.hht.step.state import State

LARGEST = 1_000  # coordinates: full matrices of that size take a second
CALLS = 5  # of each function: two may differ by little
FEW = 9  # roundoffs
WIDER = 1024.0  # times: so much more do the values of a smooth function differ where its arguments do
ALIKE = 0.01  # of such differences: those of nearer arguments that are no larger are no noise
PRESCRIBED = 1e-9  # of the size of values: less is nothing to steps of a given length, and leaves differences a digit
SHARE = 0.1  # of a step's error: noise that makes so much of it decides how long steps are


class Noise(NamedTuple):
    """What calls differ by."""

    text: str  #: which functions, by how much
    decides: bool  #: whether it makes a good part of a step's error


class Called(NamedTuple):
    """What one call of every function gives."""

    values: dict[str, Any]  #: by name
    acceleration: Vector  #: (n,) by force and reactions
    position: Vector  #: (m,) g
    velocity: Vector  #: (m + p,) g_t + g_q v and k
    rows: Matrix  #: (m + p, n) [g_q; k_v]


def noise(engine: Engine, state: State, tolerances: Tolerances | None, h: float, error: float) -> Noise | None:
    """That of the system's functions at ``state``, and whether it makes the ``error`` of a step of ``h`` [s] from there.

    That of accelerations enters v with h and q with h^2: every noise has steps that are short enough, but they may be too
    many.  That of g is in q as it is, and in v over h: shorter steps have more of it.  None where it does not make the
    error and is below what the tolerances allow of a step; those of prescribed steps are None.
    """
    dynamics = engine.dynamics
    if route_of(dynamics) != "numpy" or engine.structure.n > LARGEST:  # others are traced once
        return None
    with suppress(BudgetSpent, NonFiniteValue, np.linalg.LinAlgError), uncounted():
        calls, arguments = [_called(dynamics, state) for _ in range(CALLS)], "the same arguments"
        apart = {name: _apart(name, calls, state).max() for name in calls[0].values}
        if not any(apart.values()):
            calls, wider = ([_called(dynamics, _beside(state, size, k)) for k in range(CALLS)] for size in (1.0, WIDER))
            apart = {name: _unlike(_apart(name, calls, state), _apart(name, wider, state)) for name in apart}
            arguments = "arguments some roundoffs apart"
        noisy = {name: most for name, most in apart.items() if most > 0.0 and declared(dynamics.system, name) is not None}
        most, names = max(noisy.values(), default=0.0), " and of ".join(noisy)
        decides, least = False, PRESCRIBED
        if tolerances is not None:
            least = tolerances.finest**1.5
            decides = bool(noisy) and tolerances.size(state, state, _moved(calls, abs(h))) > SHARE * error
        if decides or most > least:
            text = f"noise: two calls of {names} with {arguments} differ by {most:.2g} of their size"
            return Noise(f"{text}; make it a function of t, q and v alone", decides)
    return None


def _beside(state: State, size: float, number: int) -> State:
    """``state`` with every entry some roundoffs, times ``size``, further from zero; for every ``number`` by others."""
    draw = np.random.default_rng(number)
    arrays = {name: getattr(state, name) for name in ("q", "v", "lam", "mu")}
    return replace(state, **{name: x * (1.0 + size * EPS * draw.integers(0, FEW, x.size)) for name, x in arrays.items()})


def _unlike(near: Vector, wider: Vector) -> float:
    """The largest of differences ``near``, where they are noise; else 0.

    Those of a smooth function shrink with those of its arguments, and a jump gives two values, most pairs of them the same.
    """
    return float(near.max()) if np.quantile(near, 0.25) > ALIKE * wider.max() else 0.0


def _called(dynamics: Dynamics, state: State) -> Called:
    """Every function once, at ``state``."""
    s, (t, q, v) = dynamics.structure, as_arguments(dynamics, state.t, state.q, state.v)
    values: dict[str, Any] = {"force": dynamics.force(t, q, v), "mass_matrix": dynamics.mass(t, q)}
    rows, position, velocity = [np.zeros((0, s.n))], np.zeros(0), [np.zeros(0)]
    if s.m:
        position, jacobian = dynamics.constraint(t, q), dynamics.constraint_jacobian(t, q)
        values |= {"constraint": position, "constraint_jacobian": jacobian}
        values["reaction"] = dynamics.reaction(t, q, v, state.lam)
        rows, velocity = [jacobian], [dynamics.constraint_velocity(t, q, v)]
    if s.p:
        k, jacobian = dynamics.velocity_constraint(t, q, v), dynamics.velocity_constraint_jacobian(t, q, v)
        values |= {"velocity_constraint": k, "velocity_constraint_jacobian": jacobian}
        values["velocity_reaction"] = dynamics.velocity_reaction(t, q, v, state.mu)
        rows, velocity = [*rows, jacobian], [*velocity, k]
    forces = sum(values[name] for name in ("force", "reaction", "velocity_reaction") if name in values)
    acceleration = np.linalg.solve(values["mass_matrix"], forces)
    return Called(values, acceleration, position, np.concatenate(velocity), np.concatenate(rows))


def _apart(name: str, calls: list[Called], state: State) -> Vector:
    """The differences of any two values over their size: that of constraints is what their rows sum up."""
    values, rows, m = [x.values[name] for x in calls], np.abs(calls[0].rows), calls[0].position.size
    summed = {"constraint": rows[:m] @ np.abs(state.q), "velocity_constraint": rows[m:] @ np.abs(state.v)}
    size = float(np.abs(summed.get(name, values[0])).max(initial=0.0)) or 1.0
    return np.array([np.abs(x - y).max(initial=0.0) for x, y in combinations(values, 2)]) / size


def _moved(calls: list[Called], h: float) -> Vector:
    """What the differences of calls move q and v (2n,) by in a step of ``h`` [s]."""
    first, *others = calls
    rows, m = np.abs(first.rows), first.position.size
    along = rows / np.maximum((rows**2).sum(axis=1, keepdims=True), TINY)  # the shortest way by which a row changes by 1

    def most(name: str) -> Any:
        return np.max([np.abs(getattr(x, name) - getattr(first, name)) for x in others], axis=0)

    in_q = (most("position")[:, None] * along[:m]).max(axis=0, initial=0.0)
    in_v = (most("velocity")[:, None] * along).max(axis=0, initial=0.0)
    return np.concatenate([in_q + h * h * most("acceleration"), in_q / h + in_v + h * most("acceleration")])
