"""Causes of failed runs, searched after a failure or on request, and warnings about unresolved prescribed steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from itertools import combinations
from typing import Any

import numpy as np
from scipy import linalg

from hhtbench.lowering import route_of
from hhtbench.protocol.arguments import Matrix, Vector, all_finite
from hhtbench.protocol.errors import BudgetSpent, NonFiniteValue
from hhtbench.protocol.system import declared
from hhtbench.solution.counting import Work, uncounted
from hhtbench.solution.result import Status
from solvers._finite import as_arguments
from solvers._projection import Projection
from solvers._start import Failure, PhasePoint
from solvers.hht.run.engine import Engine, not_extrapolated
from solvers.hht.run.singular import dense
from solvers.hht.run.start import make_engine
from solvers.hht.step.state import State
from solvers.kernel.numbers import EPS, TINY

FAILED = Status.newton_failed, Status.step_too_small, Status.max_steps
SPENT = Status.evaluation_budget, Status.deadline  # budgets of the caller: a cause is searched on request only
MAX_COORDINATES = 300  # for full matrices in the search for a cause: a decomposition takes 10 ms
CALLS = 5  # calls of every function with equal arguments
ROUNDOFFS = 9  # largest difference of nearly equal arguments, in roundoffs
WIDER = 1024.0  # factor on these differences of arguments for comparison
SMOOTH = 0.01  # a smooth function's values differ less than this, relative to the differences with WIDER
FELT = 1e-3  # noise relative to the tolerance below which error control is unaffected
ITERATIONS = 30  # steps of the power iteration: the frequency is then accurate to some per cent, from below
DIFFERENCE = EPS ** (1 / 3)  # increment relative to q: balances truncation and roundoff of a central difference
BY_REACTIONS = 0.5  # share of constraint forces in omega^2 above which they carry the vibration
RESOLVED = 0.02  # h omega from which a vibration may determine the steps
FAST = 10.0  # ratio to the rate of the motion below which a vibration is the motion itself
STABLE = 2.0  # h omega up to which steps with b = 0 are stable, (H33)
FOLLOWS = 0.1  # change of v relative to that by forces alone below which damping or constraints balance them
UNRESOLVED = 0.5  # change of v in one step, relative to max|v|, from which forces are not resolved
ALTERNATIONS = 5  # consecutive changes of sign that make a vibration
VISIBLE = 1e-8  # displacement per step, relative to q, below which a speed is not reported
GROWTH = 1e5  # growth of an alternating vibration from which prescribed steps count as unstable
STEADY = 1e-2  # bound on median^2 over first * last size, 1 for a vibration growing by equal factors


def explained(engine: Engine, failure: Failure, state: State, h: float, finest: float) -> Failure:
    """The ``failure`` of a step of ``h`` [s] from ``state``, with a sentence on its cause if one is found.

    ``finest``: the smallest relative tolerance.
    """
    if failure.status not in FAILED:
        return failure
    cause = cause_at(engine, failure.status, state, h, finest=finest, rate=state.size_v / max(state.size_q, TINY))
    return replace(failure, message=f"{failure.message.removesuffix('.')}. {cause}.") if cause else failure


def cause_at(engine: Engine, status: Status, place: State | PhasePoint, h: float, *, finest: float, rate: float) -> str:
    """Sentence on the cause of a failed step of ``h`` [s] from ``place``; empty if none is found.

    ``finest``: smallest relative tolerance, 0 with prescribed steps; ``rate``: speed of the motion over its size [1/s].
    """
    if status not in (*FAILED, *SPENT):
        return ""
    with suppress(BudgetSpent, NonFiniteValue, ValueError, linalg.LinAlgError), uncounted(), np.errstate(all="ignore"):
        return noise(engine, place, finest) or vibration(engine, place, h, status, rate)
    return ""


def diagnosed(system: Any, options: Any, status: Status, place: PhasePoint, h: float, *, finest: float, rate: float) -> str:
    """Cause of the end with ``status`` of an HHT run at ``place``, for :meth:`~hhtbench.Solution.diagnose`."""
    engine = make_engine(system, options, place, Work(), controlled=finest > 0.0)
    return cause_at(engine, status, place, h, finest=finest, rate=rate)


def noise(engine: Engine, state: State | PhasePoint, finest: float) -> str:
    """Message naming functions of a NumPy system whose values differ between calls with (nearly) equal arguments, or "".

    Differences far below the tolerance ``finest`` are ignored.
    """
    if route_of(engine.dynamics) != "numpy" or engine.structure.n > MAX_COORDINATES:
        return ""
    near, wide = (_spread(engine, state, size) for size in (0.0, 1.0)), _spread(engine, state, WIDER)
    for differences, arguments in zip(near, ("the same arguments", "arguments some roundoffs apart"), strict=True):
        noisy = {name: x for name, x in differences.items() if x > SMOOTH * wide[name] and x > FELT * finest}
        if noisy:
            most = max(noisy.values())
            return (
                f"Calls of {' and of '.join(noisy)} with {arguments} differ by {most:.2g} of their size: error control "
                "cannot go below that; make it a smooth function of t, q and v alone, in double precision"
            )
    return ""


def _spread(engine: Engine, state: State | PhasePoint, size: float) -> dict[str, float]:
    """Relative differences of the values of declared functions between calls, at arguments ``size`` times roundoff apart."""
    dynamics, calls = engine.dynamics, []
    for number in range(CALLS):
        draw = np.random.default_rng(number)
        q, v = (x * (1.0 + size * EPS * draw.integers(0, ROUNDOFFS, x.size)) for x in (state.q, state.v))
        calls.append(_values(dynamics, as_arguments(dynamics, state.t, q, v)))
    found = {}
    scales = _scales(dynamics, state)
    for name, value in calls[0].items():
        apart = [float(np.abs(x[name] - y[name]).max(initial=0.0)) for x, y in combinations(calls, 2)]
        found[name] = float(np.quantile(apart, 0.25)) / (scales.get(name) or float(np.abs(value).max(initial=0.0)) or 1.0)
    return found


def _scales(dynamics: Any, state: State | PhasePoint) -> dict[str, float]:
    """Sizes of the terms that constraints sum up, since the values themselves vanish."""
    s, found, (t, q, v) = dynamics.structure, {}, as_arguments(dynamics, state.t, state.q, state.v)
    if s.m:
        rows = np.abs(dynamics.constraint_jacobian(t, q))
        found["constraint"] = float((rows @ np.abs(state.q)).max())
    if s.p:
        rows = np.abs(dynamics.velocity_constraint_jacobian(t, q, v))
        found["velocity_constraint"] = float((rows @ np.abs(state.v)).max())
    return found


def _values(dynamics: Any, arguments: list[Any]) -> dict[str, Any]:
    """The declared functions of (t, q, v), evaluated there."""
    t, q, v = arguments
    values = {"force": lambda: dynamics.force(t, q, v), "mass_matrix": lambda: dynamics.mass(t, q)}
    if dynamics.structure.m:
        values["constraint"] = lambda: dynamics.constraint(t, q)
    if dynamics.structure.p:
        values["velocity_constraint"] = lambda: dynamics.velocity_constraint(t, q, v)
    return {name: call() for name, call in values.items() if declared(dynamics.system, name) is not None}


def vibration(engine: Engine, state: State | PhasePoint, h: float, status: Status, rate: float) -> str:
    """Names the fastest vibration about ``state`` if steps of ``h`` [s] follow it or are unstable for it, (H33).

    ``rate``: speed of the motion over its size [1/s]; a vibration limits the steps only if it is much faster.
    """
    if engine.structure.n > MAX_COORDINATES or status is Status.step_too_small:
        return ""
    omega, share = fastest(engine, state)
    by_reactions, unstable = share > BY_REACTIONS, status is Status.newton_failed
    if not abs(h) * omega > (STABLE if unstable else RESOLVED) or not (unstable or omega > FAST * rate):
        return ""
    who = "Constraint forces" if by_reactions else "Forces"
    text = f"{who} carry a vibration of {omega:.3g} rad/s, and h omega is {abs(h) * omega:.2g}"
    options = remedies(engine) if by_reactions else []
    if unstable:
        return f"{text}; take {' or '.join(['shorter steps', *options])}"
    take = [f"take {option}" for option in options] or ["start in balance", "damp it"]
    return f"{text}: if the steps follow it, {', '.join(take)}, or loosen the tolerance"


def remedies(engine: Engine) -> list[str]:
    """Options that allow steps longer than a vibration carried by constraint forces."""
    method, found = engine.method, []
    if engine.structure.m and method.coefficients.b == 0.0 and not method.extrapolated:
        if method.coefficients.alpha < 0.0 and not not_extrapolated(engine.dynamics.system):
            found.append("extrapolate_reaction=True")
        found.append("b=1")
    return found


def fastest(engine: Engine, at: State | PhasePoint) -> tuple[float, float]:
    """omega [1/s] of the fastest small vibration about a state, and the share of reactions in omega^2.

    omega^2 is the largest eigenvalue of M^-1 d(C^T lam - F)/dq for changes of q tangent to the rows C = [g_q; k_v],
    by power iteration on central differences.
    """
    dynamics, n, (t, q, v) = engine.dynamics, engine.structure.n, (at.t, at.q, at.v)
    if any(declared(dynamics.system, name) is not None for name in ("reaction", "velocity_reaction")):
        return 0.0, 0.0
    projection = Projection(dynamics)
    mass, none = dense(projection.mass(t, q)), np.zeros((0, n))
    root = linalg.cholesky(mass, lower=True)
    constrained, multipliers = engine.structure.constrained, np.zeros(0)
    if constrained:
        found = engine.acceleration.solve(t, q, v)
        multipliers = np.concatenate([found.lam, found.mu])

    def rows_at(x: Vector) -> Matrix:
        return dense(projection.levels.at(t, x, v).rows) if constrained else none

    normal, _ = linalg.qr(linalg.solve_triangular(root, rows_at(q).T, lower=True), mode="economic")

    def stiffness(parts: tuple[bool, bool]) -> Callable[[Vector], Vector]:
        def apply(y: Vector) -> Vector:
            along = linalg.solve_triangular(root, y, lower=True, trans="T")
            step = DIFFERENCE * (float(np.abs(q).max()) or 1.0) / float(np.abs(along).max())
            there = [q + step * along, q - step * along]
            change = np.zeros(n)
            if parts[0] and constrained:
                change += (rows_at(there[0]) - rows_at(there[1])).T @ multipliers
            if parts[1]:
                applied = [mass @ engine.force(t, x, v)[0] for x in there]
                change -= applied[0] - applied[1]
            pulled = linalg.solve_triangular(root, change / (2.0 * step), lower=True)
            return np.asarray(pulled - normal @ (normal.T @ pulled))

        return apply

    start = np.random.default_rng(0).standard_normal(n)
    y = start - normal @ (normal.T @ start)
    whole, value = stiffness((True, True)), 0.0
    for _ in range(ITERATIONS):
        size = float(np.linalg.norm(y))
        if not 0.0 < size < math.inf:
            return 0.0, 0.0
        y = y / size
        image = whole(y)
        value, y = float(y @ image), image
    if not value > 0.0:
        return 0.0, 0.0
    y = y / float(np.linalg.norm(y))
    return math.sqrt(value), float(y @ stiffness((True, False))(y)) / value


def unresolved_forces(t: Vector, h: Vector, q: Matrix, v: Matrix, a: Matrix) -> str:
    """Warning if forces change v by about its size within one prescribed step; empty string otherwise.

    Takes ``t, h`` (k,), ``q, v, a`` (n, k).  Both the accelerations ``a`` of forces and the slope of ``v`` must change so,
    as forces balanced by constraints move nothing.  Speeds that move ``q`` by less than ``VISIBLE`` of its size in the
    longest step count as rest.
    """
    if t.size < 4:
        return ""
    with np.errstate(all="ignore"):
        largest = np.abs(v).max(axis=1, keepdims=True)
        changes = np.abs(np.diff(a[:, 1:]) * h[2:])
        moving = largest * float(np.abs(h).max()) > VISIBLE * float(np.abs(q).max())
        coarse = (changes > UNRESOLVED * largest) & moving
        if not np.count_nonzero(coarse):
            return ""
        bends = np.abs(np.diff(np.diff(v) / h[1:]) * h[2:])
        coarse &= (bends > np.maximum(UNRESOLVED * largest, FOLLOWS * changes)) & np.isfinite(bends)
    if not np.count_nonzero(coarse):
        return ""
    at, step = np.unravel_index(np.argmax(np.where(coarse, changes / np.maximum(largest, TINY), 0.0)), coarse.shape)
    return (
        f"Warning: in the step to t = {t[step + 2]:.10g} forces change v[{at}] by {changes[at, step]:.2g}, and it is "
        f"{largest[at, 0]:.2g} at most: the steps do not resolve the forces; compare with shorter steps."
    )


def alternating_vibration(h: Vector, q: Matrix, v: Matrix) -> tuple[str, bool]:
    """Message if an entry of v alternates from step to step, else ""; and True if the steps are unstable for it.

    They are where it has grown by more than ``GROWTH`` at a steady rate; otherwise the message is a warning. For prescribed
    steps ``h`` (k,) [s] with ``q, v`` (n, k) at their ends; too few steps give no message.
    """
    if h.size < 3 * ALTERNATIONS:
        return "", False
    with np.errstate(all="ignore"):
        changes, lengths = np.diff(v), np.abs(h[1:])
        bends = np.diff(changes / h[1:]) * np.minimum(lengths[:-1], lengths[1:])
        if not all_finite(bends):
            bends[~np.isfinite(bends)] = 0.0
        sizes, most = np.abs(bends), np.abs(changes).max(axis=1)
        least = VISIBLE * float(np.abs(q).max()) / float(lengths.max())
        found = ""
        for at in np.flatnonzero(sizes.max(axis=1) > np.maximum(UNRESOLVED / 2 * most, least)).tolist():
            end = int(sizes[at].argmax()) + 1
            roundoff = EPS * float(np.abs(v[at]).max())
            for lag in (1, 2):  # far beyond (H54) signs change with every second step
                first = max(end - lag, 0) - _alternations(bends[at, :end], lag)
                if end - lag - first < ALTERNATIONS:
                    continue
                grown = sizes[at, first:end]  # at a steady rate, which a kink behind roundoff is not
                if grown[-1] > GROWTH * max(grown[0], roundoff) and np.median(grown) ** 2 > STEADY * grown[0] * grown[-1]:
                    text = f"v[{at}] alternates with the steps, and this vibration has grown by more than {GROWTH:.0e}"
                    remedy = "take shorter steps of even length"
                    return f"{text}: the steps are unstable for it, (H33) and (H53); {remedy}", True
                if lag == 1 and not found:
                    text = f"Warning: v[{at}] alternates from step to step by {sizes[at, end - 1]:.2g}"
                    found = f"{text}: the steps do not resolve a stiff force; compare with shorter steps."
    return found, False


def _alternations(x: Vector, lag: int) -> int:
    """Number of last entries of ``x`` (k,) in a row whose sign differs from the entry ``lag`` before."""
    same = np.flatnonzero(x[lag:] * x[:-lag] >= 0.0)
    return max(x.size - lag, 0) - (int(same[-1]) + 1 if same.size else 0)
