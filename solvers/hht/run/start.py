"""From a system and q0, v0 to an engine with its first state: derivation, projection, checks, multipliers and a0."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, NamedTuple

import numpy as np

from hhtbench.lowering.dynamics.augmented import AugmentedDynamics
from hhtbench.protocol.arguments import Vector, real_number, real_vector
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.events import Event
from hhtbench.protocol.system import NumpySystem, System
from hhtbench.solution.counting import Work
from solvers._initcond import consistent_start, start_acceleration
from solvers._projection import Projection, closest
from solvers._start import Failure, Guesses, PhasePoint, dynamics_for, tried_twice
from solvers.hht.options import HHTOptions
from solvers.hht.run import engine_pool
from solvers.hht.run.engine import SHIFTED, Engine
from solvers.hht.step.state import State

NOTHING = np.zeros(0)


class Started(NamedTuple):
    """An engine with its first state; ``note`` says how the start was changed."""

    purpose: Hashable  #: key of the engine in the pool
    engine: Engine
    state: State
    note: str
    applied: Vector  #: M^-1 F (n,) there under error control, for default tolerances; else (0,)


def start_values(t0: Any, q0: Any, v0: Any, lam_guess: Any, mu_guess: Any) -> tuple[PhasePoint, Guesses]:
    """Check the caller's start and copy it to arrays.

    Raises
    ------
    ProblemError, TypeError
        One is no finite number or vector, or their lengths differ.
    """
    t, q = real_number("t0", t0, unit=" [s]"), real_vector("q0", q0)
    if q.size == 0:
        raise ProblemError("q0 must hold at least one coordinate; got shape (0,).")
    v = real_vector("v0", v0, q.size)
    lam = None if lam_guess is None else real_vector("lam_guess", lam_guess)
    mu = None if mu_guess is None else real_vector("mu_guess", mu_guess)
    return PhasePoint(t, q, v), (lam, mu)


def begin(
    system: System | NumpySystem,
    options: HHTOptions,
    place: PhasePoint,
    guesses: Guesses,
    h: float,
    work: Work,
    *,
    controlled: bool = False,
    calc_initcond: bool = False,
    events: tuple[Event, ...] = (),
) -> Started | Failure:
    """Derive, project and check the start, and build the first state; retried once after a value that is not finite.

    ``h`` [s] is the first step, or the direction of time.  An engine left by an earlier run of the same system is
    reused, and returned to the pool if no motion begins.
    """

    purpose = engine_pool.purpose_of(system, options, place.q.size, controlled=controlled)
    ready = engine_pool.take(purpose)
    unseen = ready is not None and not ready.compared  # declared derivatives are checked before anything begins

    engine = ready

    def begun() -> Started | Failure:
        nonlocal engine
        of = system, options, place, work
        engine = ready.again(place, work) if ready and unseen else make_engine(*of, controlled=controlled, ready=ready)
        engine.watch(events)
        plain = None if calc_initcond else engine.started(place, guesses)
        if plain is not None:
            return Started(purpose, engine, plain, "", engine.applied(plain) if controlled else NOTHING)
        if unseen:
            engine = make_engine(*of, controlled=controlled, ready=ready)
            engine.watch(events)
        found = consistent_start(engine.dynamics, place, guesses, work, calc_initcond=calc_initcond)
        if isinstance(found, Failure):
            return found
        at, note = found
        state = first_state(engine, at, *guesses, h)
        if isinstance(state, Failure):
            return state
        if isinstance(engine.dynamics, AugmentedDynamics):
            note = f"The mass matrix is singular at the start; M + C^T R C is used (H19). {note}".strip()
        return Started(purpose, engine, state, note, engine.applied(state) if controlled else NOTHING)

    started: Started | Failure = tried_twice(begun, work, place.t)
    if isinstance(started, Failure) and engine is not None:
        engine_pool.put_back(purpose, engine)
    return started


def make_engine(
    system: System | NumpySystem,
    options: HHTOptions,
    place: PhasePoint,
    work: Work,
    *,
    controlled: bool = False,
    ready: Engine | None = None,
) -> Engine:
    """The engine for runs that begin at ``place``, without checking the start; ``ready`` if its dynamics are the same."""
    dynamics = dynamics_for(system, place, options.without)
    if ready is not None and ready.dynamics is dynamics:
        return ready.again(place, work)
    return Engine(dynamics, place, work, options, controlled=controlled)


def first_state(engine: Engine, place: PhasePoint, lam: Vector | None, mu: Vector | None, h: float) -> State | Failure:
    """The state before the first step of signed length ``h`` [s]; the start must be consistent.

    Without constraints neither multipliers nor KKT matrix are computed.
    """
    t, q, v = place.t, place.q, place.v
    found: Any = None
    if engine.structure.constrained:  # first: where the KKT matrix is singular there may be no f either
        found = start_acceleration(engine.dynamics, engine.work, place, (lam, mu))
        if isinstance(found, Failure):
            return found
    f0, inverse = engine.force(t, q, v)
    vdot = f0 if found is None else found.vdot
    near = vdot if engine.method.total else f0  # what a0 is near, and adapted around by (H11)
    a0, applied = near, found.lam if engine.layout.extrapolated else NOTHING  # (H55)
    if engine.method.start in SHIFTED:
        shift = engine.method.coefficients.alpha * h
        a0 = engine.near(t + shift, q + shift * v, v + shift * vdot, found)  # (H12), (H41)
    if engine.method.start == "corrected" and found is not None:
        v = corrected_velocity(engine, place, found, h)
    return State(
        t=t,
        q=q,
        v=v,
        a=a0,
        f=near,
        h=None,
        lam=NOTHING if found is None else found.lam,
        mu=NOTHING if found is None else found.mu,
        lam_applied=applied,
        lam_before=applied,
        vdot=vdot,
        inverse_mass=inverse,
        unknowns=None,
        earlier=None,
        lengths=None,
        factorised=None,
        memory=None,
        size_q=float(np.max(np.abs(q))),
        size_v=float(np.max(np.abs(v))),
    )


def corrected_velocity(engine: Engine, place: PhasePoint, found: Any, h: float) -> Vector:
    """v0 (n,) with the normal part that index-3 steps of length ``h`` [s] produce, (H44)."""
    t, q, v, c, projection = place.t, place.q, place.v, engine.method.coefficients, Projection(engine.dynamics)
    jerk = (engine.near(t + h, q + h * v, v + h * found.vdot, found) - found.vdot) / h
    rows = projection.levels.at(t, q, v).rows
    weight = (1.0 / 6.0 - 0.5 * c.alpha - c.beta) * h * h
    return v + closest(projection.mass(t, q), rows, np.zeros(v.size), -weight * (rows @ jerk))
