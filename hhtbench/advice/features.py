"""Features of a problem before any solve: sizes, kinds of constraints, fastest vibration and decay, pace of the motion."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, fields

import numpy as np

from hhtbench.lowering import derive
from hhtbench.lowering.equations import Equations
from hhtbench.lowering.rates import fastest_rates
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.errors import ProblemError, Stop
from hhtbench.protocol.problem import Problem

MOMENTS = (0.1, 0.4)  # shares of the interval: later times at which forces are evaluated in the state of the start
MIN_TURNS = 1e-3  # smallest number of turns in the interval; slower motions count as this
MIN_SHARE = 1e-4  # smallest share of the fastest vibrations: below it they pass unseen at the errors engineers ask for


@dataclass(frozen=True, kw_only=True)
class Features:
    """Numbers by which problems are compared; decimal logarithms where sizes range widely."""

    size: float  #: log of n
    position: float  #: m / n
    velocity: float  #: p / n
    redundant: float  #: 1 where rows of the constraints depend on others at the start
    variable_mass: float  #: 1 where the mass depends on t or q
    vibration: float  #: log of the turns of the fastest vibration in the interval; at least ``pace``
    decay: float  #: log of the times, over 2 pi, that the fastest damper halts a motion in the interval; at least ``pace``
    pace: float  #: log of the turns of the motion itself, from its rate at the start
    share: float  #: log of the velocity in the fastest vibrations over the scale of v; 0 where the motion is as fast

    @property
    def vector(self) -> Vector:
        """The features in the order of :data:`NAMES`, (features,)."""
        return np.array([getattr(self, name) for name in NAMES])

    @property
    def stiffness(self) -> float:
        """Ratio of the fastest rate, of vibration or decay, to that of the motion."""
        return 10.0 ** (max(self.vibration, self.decay) - self.pace)

    def __str__(self) -> str:
        kinds = [f"m/n = {self.position:.2g}"] * (self.position > 0) + [f"p/n = {self.velocity:.2g}"] * (self.velocity > 0)
        kinds += ["redundant rows"] * (self.redundant > 0) + ["variable mass"] * (self.variable_mass > 0)
        text = f"n = {10**self.size:.0f}, {', '.join(kinds) or 'no constraints'}"
        share = f" (with {10**self.share:.1g} of the speed)" * (self.vibration > self.pace)
        decay = f", fastest decay {2 * math.pi * 10**self.decay:.2g} times" * (self.decay > self.pace)
        motion = f"of the motion {10**self.pace:.2g}"
        return f"{text}, fastest vibration {10**self.vibration:.2g} turns{share}, {motion}{decay}"


NAMES = tuple(field.name for field in fields(Features))


@dataclass(frozen=True, kw_only=True)
class Probe:
    """Features of a problem and the cost of computing them."""

    features: Features
    evaluations: int  #: number of evaluations of the acceleration
    seconds: float  #: time of these evaluations, compiled before [s]


def probe(problem: Problem) -> Probe:
    """Compute the features of ``problem`` at its start, by 2 :data:`~hhtbench.lowering.rates.POWER_STEPS` + 5 accelerations.

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
        rates = fastest_rates(equations, at_start)
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
        vibration=(vibration := max(_turns(rates.vibration, span), pace)),
        decay=max(_turns(rates.decay, span), pace),
        pace=pace,
        share=math.log10(min(max(rates.share, MIN_SHARE), 1.0)) if vibration > pace else 0.0,
    )
    return Probe(features=found, evaluations=equations.work.tally["residual_evaluations"], seconds=seconds)


def _turns(rate: float, span: float) -> float:
    """Decimal logarithm of ``rate`` [1/s] times ``span`` [s] over 2 pi, at least that of ``MIN_TURNS``."""
    return math.log10(max(rate * span / (2 * math.pi), MIN_TURNS))


def _pace(problem: Problem, acceleration: Vector) -> float:
    """Rate of the motion at the start [1/s], from its velocities and from the accelerations, both by the scale of q."""
    scale = np.broadcast_to(np.asarray(problem.scales.q, dtype=np.float64), problem.q0.shape)
    return max(float(np.max(np.abs(problem.v0) / scale)), math.sqrt(float(np.max(np.abs(acceleration) / scale))))
