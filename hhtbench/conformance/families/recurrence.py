"""The implemented step on an oscillator against its closed form.

All methods of prescribed steps here are Chung and Hulbert's family on a system without constraints (J. Chung, G. M. Hulbert,
J. Appl. Mech. 60 (1993) 371-375), for steps of one second and the frequency O = h omega::

    y1 = y0 + v0 + (1/2 - beta) a0 + beta a1,    v1 = v0 + (1 - gamma) a0 + gamma a1,
    (1 - am) a1 + am a0 = -O^2 ((1 - af) y1 + af y0).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from hhtbench.conformance.cell import Cell, Expected, family
from hhtbench.conformance.scenes.circles import oscillator
from hhtbench.protocol.arguments import Matrix
from hhtbench.protocol.system import Problem
from hhtbench.solution.result import Solution

COUNT = 24  # steps
SAME = 1e-9  # of the rows, over the largest
ROUNDED = 2 * float(np.finfo(np.float64).eps)  # over O^2: the roundoff of y, held beside v, in the forces of the next step


@dataclass(frozen=True)
class Weights:
    """Of one method."""

    beta: float
    gamma: float
    am: float = 0.0
    af: float = 0.0

    def matrix(self, frequency: float) -> Matrix:
        """(3, 3) map of (y, v, a) made by a step of 1 s."""
        left = np.array([[1.0, 0.0, -self.beta], [0.0, 1.0, -self.gamma], [0.0, 0.0, 1.0 - self.am]])
        left[2, 0] = frequency**2 * (1.0 - self.af)
        right = np.array([[1.0, 1.0, 0.5 - self.beta], [0.0, 1.0, 1.0 - self.gamma], [0.0, 0.0, -self.am]])
        right[2, 0] = -(frequency**2) * self.af
        return np.linalg.solve(left, right)


def of_alpha(alpha: float) -> Weights:
    """Hilber, Hughes and Taylor's, second order and most damping."""
    return Weights(beta=(1 - alpha) ** 2 / 4, gamma=0.5 - alpha, af=-alpha)


def of_rho(rho: float) -> Weights:
    """Generalised-alpha that leaves ``rho`` of the fastest vibrations."""
    am, af = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    return Weights(beta=(1 - am + af) ** 2 / 4, gamma=0.5 - am + af, am=am, af=af)


LEAPFROG = Weights(beta=0.0, gamma=0.5)
METHODS: tuple[tuple[str, tuple[str, ...], dict[str, Any], Weights], ...] = (
    *((f"alpha = {x:g}", ("hht", "hht_i3"), {"alpha": x}, of_alpha(x)) for x in (0.0, -0.05, -0.15, -0.3)),
    *((f"rho = {x:g}", ("generalised_alpha",), {"rho_inf": x, "start": "f0"}, of_rho(x)) for x in (0.0, 0.5, 0.8, 1.0)),
    ("leapfrog", ("rattle",), {}, LEAPFROG),
)


@family("amplification", "frequency times step")
def amplification(seed: int) -> Iterator[Cell]:
    """Steps on an oscillator: rows, and so radius, damping ratio and period, against the method's closed recurrence."""
    for power in range(-2, 7):
        frequency = 10.0**power
        for line, families, options, weights in METHODS:
            yield Cell(
                x=frequency,
                line=line,
                make=partial(oscillator, frequency, COUNT),
                request={"steps": COUNT},
                expected=_expected(weights, frequency),
                options=options,
                families=families,
                small=power == -1 and weights in (METHODS[1][-1], METHODS[5][-1], LEAPFROG),
            )


def _expected(weights: Weights, frequency: float) -> Mapping[str, Expected]:
    """Leapfrog's rows overflow beyond its bound of 2, as its radius says: they must do so in the same way."""
    return {"rows": Expected(error=partial(_off_rows, weights, frequency), most=SAME + ROUNDED * frequency**2)}


def closed_rows(weights: Weights, frequency: float, count: int = COUNT) -> Matrix:
    """(count + 1, 2) y and v from (0, 1), where f is zero."""
    matrix, state = weights.matrix(frequency), np.array([0.0, 1.0, 0.0])
    rows = [state]
    for _ in range(count):
        rows.append(matrix @ rows[-1])
    return np.array(rows)[:, :2]


def _off_rows(weights: Weights, frequency: float, problem: Problem, found: Solution) -> float:
    """Largest relative difference, each row over the largest one so far."""
    known = closed_rows(weights, frequency, found.t.size - 1)
    rows = np.column_stack([found.q, found.v])
    sizes = np.maximum.accumulate(np.abs(known))
    return float(np.max(np.abs(rows - known)[1:] / np.maximum(sizes[1:], np.finfo(np.float64).tiny)))
