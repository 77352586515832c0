"""Fastest vibration and fastest decay of the equations linearised at the start, and how much of the motion is in them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hhtbench.lowering.equations import Equations
from hhtbench.protocol.arguments import Vector

POWER_STEPS = 10  # steps of each power iteration: they give the fastest rates to some percent
PERTURBATION = 1e-6  # increment of the state for a difference, relative to the scales
ALIGNED = 1e-3  # sine of the angle between two iterates below which they span one direction: less is roundoff


@dataclass(frozen=True, kw_only=True)
class Rates:
    """Fastest modes of v' = a(q, v) at the start; an overdamped spring has both a vibration and a faster decay."""

    vibration: float  #: circular frequency of the fastest vibration without its dampers [1/s]
    decay: float  #: rate of the fastest damper [1/s]
    share: float  #: velocity in the fastest vibrations over the scale of v: 0 in a motion that does not excite them


def fastest_rates(equations: Equations, at_start: Vector) -> Rates:
    """Find the fastest modes by two power iterations, with ``at_start`` (n,), the acceleration at the start.

    The derivative of the acceleration by q has the eigenvalues -w^2 of vibrations w, that by v those of the dampers; a
    complex one of the latter turns (a top's spin) and counts as a vibration.  Every derivative is a difference of two
    accelerations, every iteration takes ``POWER_STEPS``, the share two more.

    Raises
    ------
    Stop
        As :meth:`~hhtbench.lowering.equations.Equations.acceleration`.
    """
    problem = equations.problem
    t0, scale_q, scale_v = problem.t_span[0], _largest(problem.scales.q), _largest(problem.scales.v)

    def by_q(x: Vector) -> Vector:
        length = PERTURBATION * scale_q / max(_largest(x), 1e-300)
        return (equations.acceleration(t0, problem.q0 + length * x, problem.v0) - at_start) / length

    def by_v(x: Vector) -> Vector:
        length = PERTURBATION * scale_v / max(_largest(x), 1e-300)
        return (equations.acceleration(t0, problem.q0, problem.v0 + length * x) - at_start) / length

    stiffness, damping = (largest_eigenvalue(derivative, equations.n) for derivative in (by_q, by_v))
    # an unstable direction, with a positive eigenvalue, counts as a vibration of its rate
    vibration, turning = math.sqrt(abs(stiffness)), abs(damping.imag)
    derivative, size = (by_q, abs(stiffness)) if vibration >= turning else (by_v, abs(damping))
    fastest = max(vibration, turning)
    share = 0.0
    if fastest > 0.0:
        moving = [derivative(problem.v0) / size, derivative(at_start) / (size * fastest)]
        share = max(float(np.sqrt(np.mean((x / np.asarray(problem.scales.v)) ** 2))) for x in moving)
    return Rates(vibration=fastest, decay=abs(damping.real), share=share)


def largest_eigenvalue(derivative: Callable[[Vector], Vector], n: int) -> complex:
    """Eigenvalue of largest magnitude of a linear map of (n,) vectors, one of the two where they are a complex pair.

    A pair makes the iterates x rotate; the last three determine it: x'' = s x' - p x with s the sum and p the product of
    the pair (as of the two largest real ones).
    """
    now = np.random.default_rng(0).standard_normal(n)
    now /= np.linalg.norm(now)
    before, size = now, 0.0
    for _ in range(POWER_STEPS - 1):
        moved = derivative(now)
        size = float(np.linalg.norm(moved))
        if size == 0.0 or not math.isfinite(size):
            return 0.0
        before, now = now, moved / size
    last = derivative(now) / size
    if not np.isfinite(last).all():
        return 0.0
    (total, product), *_ = np.linalg.lstsq(np.stack([now, -before], axis=1), last, rcond=ALIGNED)
    roots = np.roots([1.0, -total, product])
    return complex(size * roots[np.argmax(np.abs(roots))])


def _largest(x: object) -> float:
    return float(np.max(np.abs(np.asarray(x))))
