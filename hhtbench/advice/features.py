"""Features of a problem before any solve: sizes, kinds of constraints, its fastest mode, the time scale of its motion."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, fields

import numpy as np

from hhtbench.lowering import derive
from hhtbench.lowering.equations import Equations
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError, Stop
from hhtbench.protocol.system import Problem

MOMENTS = (0.1, 0.4)  # shares of the interval: later times at which forces are evaluated in the state of the start
MIN_TURNS = 1e-3  # smallest number of turns in the interval; slower motions count as this


@dataclass(frozen=True, kw_only=True)
class Features:
    """Numbers by which problems are compared; decimal logarithms where sizes range widely."""

    size: float  #: log of n
    position: float  #: m / n
    velocity: float  #: p / n
    redundant: float  #: 1 where rows of the constraints depend on others at the start
    variable_mass: float  #: 1 where the mass depends on t or q
    fastest: float  #: log of the turns (or times 2 pi, decays) of the fastest mode in the interval; at least ``pace``
    pace: float  #: log of the turns of the motion itself, from its rate at the start
    damping: float  #: damping ratio of the fastest mode, 0 (oscillation) to 1 (decay)

    @property
    def vector(self) -> Vector:
        """The features in the order of :data:`NAMES`, (features,)."""
        return np.array([getattr(self, name) for name in NAMES])

    @property
    def stiffness(self) -> float:
        """Ratio of the rate of the fastest mode to that of the motion."""
        return 10.0 ** (self.fastest - self.pace)

    def __str__(self) -> str:
        kinds = [f"m/n = {self.position:.2g}"] * (self.position > 0) + [f"p/n = {self.velocity:.2g}"] * (self.velocity > 0)
        kinds += ["redundant rows"] * (self.redundant > 0) + ["variable mass"] * (self.variable_mass > 0)
        text = f"n = {10**self.size:.0f}, {', '.join(kinds) or 'no constraints'}"
        return f"{text}, fastest mode {10**self.fastest:.2g} turns, {self.stiffness:.2g} times the motion's pace"


NAMES = tuple(field.name for field in fields(Features))


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Features of a problem and the cost of computing them."""

    features: Features
    evaluations: int  #: number of evaluations of the acceleration
    seconds: float  #: time of these evaluations, compiled before [s]


def probe(problem: Problem) -> Probe:
    """Compute the features of ``problem`` at its start, by :data:`~hhtbench.lowering.equations.POWERS` + 3 accelerations.

    Raises
    ------
    ProblemError
        The equations determine no finite accelerations at the start or beside it.
    """
    equations, (t0, t1) = Equations(problem), problem.t_span
    try:
        at_start = equations.acceleration(t0, problem.q0, problem.v0)
        began = time.process_time()
        later = [equations.acceleration(t0 + share * (t1 - t0), problem.q0, problem.v0) for share in MOMENTS]
        fastest, damping = equations.fastest_mode(at_start)
        seconds = time.process_time() - began
    except Stop as stop:
        raise ProblemError(f"{problem.name} has no features: {stop}.") from stop
    n, span = equations.n, abs(t1 - t0)
    structure = derive(problem.system, t0, problem.q0, problem.v0).structure
    pace = _turns(_pace(problem, np.max(np.abs([at_start, *later]), axis=0)), span)
    found = Features(
        size=math.log10(n),
        position=equations.m / n,
        velocity=equations.p / n,
        redundant=float(bool(equations.redundant)),
        variable_mass=float(structure.mass == "variable"),
        fastest=max(_turns(fastest, span), pace),
        pace=pace,
        damping=damping,
    )
    return Probe(features=found, evaluations=equations.work.tally["residual_evaluations"], seconds=seconds)


def _turns(rate: float, span: float) -> float:
    """Decimal logarithm of ``rate`` [1/s] times ``span`` [s] over 2 pi, at least that of ``MIN_TURNS``."""
    return math.log10(max(rate * span / (2 * math.pi), MIN_TURNS))


def _pace(problem: Problem, acceleration: Vector) -> float:
    """Rate of the motion at the start [1/s], from its velocities and from the accelerations, both by the scale of q."""
    scale = np.broadcast_to(np.asarray(problem.scales.q, dtype=np.float64), problem.q0.shape)
    return max(float(np.max(np.abs(problem.v0) / scale)), math.sqrt(float(np.max(np.abs(acceleration) / scale))))
