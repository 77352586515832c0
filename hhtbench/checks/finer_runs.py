"""Runs of one solver with finer and finer settings, and the error bound and extrapolation from their differences."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import DenseOutput, ErrorEstimate, Solution

FINER = {"rtol": 4.0, "steps": 2.0}  # between the two runs of a pair: both make a second-order error four times smaller
CONTRACTS = 0.7  # largest ratio of one difference to that before it from which an error is estimated
SAFETY = 1.5  # times the estimate: one and a half of what a geometric series leaves
AGREEMENT = 5.0  # error estimate over the larger of two differences that do not contract
SMALL = 0.1  # differences below this share of the motion's range should contract
LEAST_SHARE = 1 / 3  # smallest believed error over the last difference, for solvers whose error is smooth
LEAST_SHARE_ELSE = 2 / 3  # the same for other solvers, whose error falls irregularly with the tolerance
ORDER = {"rtol": 1.0, "steps": 2.0}  # order of the error in the setting, the lowest of most solvers
ROUNDOFF = 1e-13  # scaled differences up to this are roundoff
AIM = 0.35  # the finer run of the next pair aims at this share of the error asked for
MOST_FINER = 1e4  # largest refinement of a tolerance at once


@dataclass(frozen=True)
class Run:
    """A successful run with its setting."""

    setting: float  #: tolerance, or one over the number of steps
    solution: Solution


class FinerRuns:
    """Sequence of runs, each with a finer setting than the one before."""

    def __init__(self, problem: Problem, kind: str) -> None:
        """Start without runs of ``problem``; ``kind`` states what is refined, "rtol" or "steps"."""
        self.problem, self.kind = problem, kind
        self.smooth = False  #: errors are a smooth function of the setting
        self.known = False  #: a solver of which it is known that it heeds its tolerances
        self.bounded = False  #: by a longest step, so that runs may take the same steps
        self.finer, self.order = FINER[kind], ORDER[kind]
        self.runs: list[Run] = []
        self.differences: list[float] = []  #: between neighbouring runs

    @property
    def _least_share(self) -> float:
        """Smallest ratio of the error to the last difference that is believed."""
        return LEAST_SHARE if self.smooth else LEAST_SHARE_ELSE

    def keep(self, run: Run) -> None:
        """Append ``run``, finer than all before; if steps are bounded and it took the same steps, the earlier runs are
        dropped.
        """
        if self.bounded and self.runs and taken_by(self.runs[-1]) == taken_by(run):
            self.clear()
        if self.runs:
            self.differences.append(float(np.max(self.rows_apart(self.runs[-1].solution, run.solution))))
        self.runs.append(run)

    def clear(self) -> None:
        """Drop all runs."""
        self.runs.clear()
        self.differences.clear()

    def rows_apart(self, a: Solution, b: Solution) -> Vector:
        """Scaled difference of q and v at every output time, (2, k)."""
        scales = self.problem.scales
        return np.array([_scaled(a.q - b.q, scales.q), _scaled(a.v - b.v, scales.v)])

    def _is_pair(self, last: int = 1) -> bool:
        """True if the settings of a run, counted from the last, and of the one before differ by at most a pair's factor."""
        if len(self.runs) <= last:
            return False
        return self.runs[-last - 1].setting / self.runs[-last].setting <= 1.01 * self.finer

    def bound(self) -> float | None:
        """Return a bound of the last run's error with the factor SAFETY; None if the differences do not contract."""
        if len(self.differences) < 2 or not self._is_pair():
            return None
        before, last = self.differences[-2:]
        if max(before, last) <= ROUNDOFF and self._differ_in_work():
            return ROUNDOFF
        contraction, *others = self._ratios()[::-1]
        if not contraction < CONTRACTS or (max(others, default=0.0) >= CONTRACTS and not others[0] < CONTRACTS):
            return None  # where they did not contract once, chance may make one smaller: two in a row must be
        first, second, third = (run.setting**self.order for run in self.runs[-3:])
        proportional = before * third / (first - second)  # the last difference may be small by chance
        return SAFETY * max(last * max(self._least_share, contraction / (1 - contraction)), proportional)

    def agreement(self) -> float | None:
        """Return a bound from three runs that agree closely, without contraction; None if it does not apply."""
        if len(self.differences) < 2 or not self._is_pair():
            return None
        return AGREEMENT * max(self.differences[-2:]) if self._differ_in_work() else None

    def _ratios(self) -> list[float]:
        """Return the ratio of every difference to the one before."""
        return [b / a if a > 0.0 else math.inf for a, b in pairwise(self.differences)]

    def stalls(self) -> int:
        """Count the differences that are small compared with the motion but did not contract."""
        last = self.runs[-1].solution if self.runs else None
        if last is None:
            return 0
        ranges = [
            np.ptp(x, axis=0) / np.asarray(s) for x, s in ((last.q, self.problem.scales.q), (last.v, self.problem.scales.v))
        ]
        small = SMALL * float(np.max(np.concatenate(ranges)))
        return sum(
            ratio >= CONTRACTS and ROUNDOFF < d < small
            for ratio, d in zip(self._ratios(), self.differences[1:], strict=True)
        )

    def _differ_in_work(self) -> bool:
        """True if the last runs are independent evidence: they took different steps, or the solver controls its error.

        Otherwise they may be one run repeated, whose agreement shows nothing.
        """
        if self.known:
            return True
        return len(set(map(taken_by, self.runs[-3:]))) == len(self.runs[-3:])

    def next_setting(self, accuracy: float, bound: float | None) -> float:
        """Return the next setting: the finer one of a pair, or the first of a pair that should reach ``accuracy``."""
        last = self.runs[-1].setting
        if not self._is_pair():
            return last / self.finer
        error = SAFETY * self._least_share * self.differences[-1] if bound is None else bound
        share = 1.0 if error == 0.0 else max(AIM * accuracy / error, 1 / MOST_FINER)
        wanted = last * self.finer * share ** (1 / self.order)
        return wanted if wanted < last / self.finer**1.5 else last / self.finer

    def estimate(self, asked: float, bound: float | None) -> ErrorEstimate | None:
        """Return the error estimate of the last run by row, with ``bound`` as its maximum; None after one run."""
        if not self.differences:
            return None
        share = SAFETY * self._least_share if not self.differences[-1] else (bound or math.nan) / self.differences[-1]
        apart = self.rows_apart(*(run.solution for run in self.runs[-2:]))
        rows = apart * share if bound is not None else np.full_like(apart, np.nan)
        lam = _scaled(self.runs[-2].solution.lam - self.runs[-1].solution.lam, self.problem.scales.lam) * share
        return ErrorEstimate(
            asked=asked,
            bound=bound,
            q=rows[0],
            v=rows[1],
            lam=lam if bound is not None else np.full_like(lam, np.nan),
            differences=tuple(self.differences),
            settings=tuple(run.setting if self.kind == "rtol" else round(1 / run.setting) for run in self.runs),
        )

    def extrapolated(self, bound: float | None) -> DenseOutput | None:
        """Return the Richardson extrapolation of the last two runs, projected onto the constraints, or None.

        It is offered only if three runs show that errors fall by four, for solvers whose error is a smooth function of the
        step or of the tolerance (``smooth_error``), and for motions without events.
        """
        if bound is None or not (self.smooth and self._is_pair() and self._is_pair(2)):
            return None
        before, last = self.differences[-2:]
        coarse, fine = (run.solution for run in self.runs[-2:])
        if not 0.8 * before < 4 * last < 1.25 * before or any(np.size(t) for t in fine.t_events):
            return None
        limit = DenseOutput(fine.q + (fine.q - coarse.q) / 3, fine.v + (fine.v - coarse.v) / 3)
        return limit if fine.projection is None else fine.projection(fine.t, limit)


def taken_by(run: Run) -> int | None:
    """Return the number of steps that ``run`` took; None if not reported."""
    return run.solution.counters.steps_accepted


def _scaled(difference: Vector, scale: float | Vector) -> Vector:
    """Largest scaled component of every row, (k,)."""
    return np.max(np.abs(difference) / np.asarray(scale), axis=1, initial=0.0)
