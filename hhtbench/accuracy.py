"""The error that was asked for: runs of one solver, finer and finer, until what is left of its error is seen to be small.

A tolerance bounds the local error, or what a solver takes for it; what is left at the end is 1 to 200 times as much, by
problem.  Two runs whose settings differ by a fixed factor differ by the error of the coarser one; a third shows whether that
contracts.  Only where it does is anything said.  `hhtbench verify accuracy` checks the estimate.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise

import numpy as np

from hhtbench.arguments import Vector, real_number
from hhtbench.errors import ProblemError
from hhtbench.protocol import NumpySystem, Problem, Solver
from hhtbench.request import Request
from hhtbench.result import Counters, DenseOutput, ErrorEstimate, Solution, Status

Once = Callable[[Request], Solution]

ROWS = 101  # equal distances, where no output times are asked for
LEAST = 1e-13  # of an error that can be asked for: states carry roundoff of 1e-16 over thousands of steps
FINER = {"rtol": 4.0, "steps": 2.0}  # between the two runs of a pair: both make a second-order error four times smaller
COARSEST = {"rtol": 1e-2, "steps": 1 / 25}
FINEST = {"rtol": 1e-14, "steps": 1e-8}
CONTRACTS = 0.7  # largest ratio of one difference to that before it from which an error is estimated
SAFETY = 1.5  # times the estimate: one and a half of what a geometric series leaves
AGREEMENT = 5.0  # of the largest of two differences that do not contract, for the error
SMALL = 0.1  # of the range of the motion: a difference below it should contract
STALLS = 2  # so many that do not are noise
LEAST_SHARE = 1 / 3  # of the last difference, of solvers whose error is smooth: less is not believed, however fast it falls
LEAST_SHARE_ELSE = 2 / 3  # of others, whose error falls with a power of the tolerance below one, and by leaps
ORDER = {"rtol": 1.0, "steps": 2.0}  # of the error in the setting: of most solvers, and the least of those of steps
ROUNDOFF = 1e-13  # scaled differences that are none
AIM = 0.35  # of the error asked for that the finer run of the next pair aims at
MOST_FINER = 1e4  # at once, of a tolerance
MOST_RUNS = 12
BUDGETS = (Status.deadline, Status.evaluation_budget)
PLAIN = Problem(name="plain", system=NumpySystem(force=lambda t, q, v: -q), t_span=(0.0, 1.0), q0=[1.0], v0=[0.0])
TOLERATED = 3  # runs in a row that fail: some libraries start at tight tolerances only


def solve_to(problem: Problem, solver: Solver, accuracy: float, request: Request, once: Once) -> Solution:
    """The solution whose error in q and v, scaled by the problem's scales, is below ``accuracy`` at every output time.

    Parameters
    ----------
    accuracy
        Largest scaled error of q and v over the output times.
    request
        Output times (101 equally far apart where it has none), and budgets of all runs together; no tolerances, no steps.
    once
        One run of the solver on the problem.

    Returns
    -------
    Solution
        Of the finest run, with :attr:`~hhtbench.result.Solution.error`; its counters are those of all runs.  Its status is
        ``accuracy_not_shown`` where no estimate below ``accuracy`` can be trusted, and the message says what is known.

    Raises
    ------
    ProblemError
        ``accuracy`` is below what roundoff allows or above a half, or comes with tolerances or steps.
    """
    accuracy = real_number("accuracy", accuracy)
    if not LEAST <= accuracy <= 0.5:
        raise ProblemError(
            f"accuracy must lie between {LEAST:g} (roundoff) and 0.5, of the problem's scales; got {accuracy:g}."
        )
    if request.fixed or request.rtol is not None or request.atol is not None:
        raise ProblemError("accuracy excludes rtol, atol, step and steps: it finds them. Give one or the other.")
    if request.t_eval is None:
        request = replace(request, t_eval=np.linspace(*problem.t_span, ROWS))
    kind, reason = _what_is_refined(problem, solver, request)
    if kind is None:
        n, none = problem.q0.size, np.empty((0, 0))
        empty = np.empty((0, n))
        return Solution(t=np.empty(0), q=empty, v=empty, lam=none, mu=none, status=Status.declined, message=reason)
    found = _Search(problem, accuracy, request, once, kind)
    found.smooth = kind == "steps" or getattr(solver, "smooth_error", False)
    found.known = getattr(solver, "judges_itself", False)
    return found.run()


def _what_is_refined(problem: Problem, solver: Solver, request: Request) -> tuple[str | None, str]:
    """Tolerances if the solver takes them, else the number of equal steps; None and the reason where it takes neither."""
    asked = {"rtol": replace(request, rtol=COARSEST["rtol"]), "steps": replace(request, steps=round(1 / COARSEST["steps"]))}
    reasons = {kind: solver.accepts(problem, one) for kind, one in asked.items()}
    for kind, reason in reasons.items():
        if reason is None:
            return kind, ""
    usual = next((kind for kind, one in asked.items() if solver.accepts(PLAIN, one) is None), "rtol")
    return None, reasons[usual] or ""


@dataclass(frozen=True)
class _Run:
    setting: float  #: tolerance, or one over the number of steps
    solution: Solution


class _Search:
    """The runs so far, and what follows from them."""

    def __init__(self, problem: Problem, accuracy: float, request: Request, once: Once, kind: str) -> None:
        self.problem, self.accuracy, self.request, self.once, self.kind = problem, accuracy, request, once, kind
        self.smooth = False  #: errors are a smooth function of the setting
        self.known = False  #: a solver of which it is known that it heeds its tolerances
        self.last: Solution | None = None  #: of a run that failed
        self.finer, self.order = FINER[kind], ORDER[kind]
        self.runs: list[_Run] = []
        self.differences: list[float] = []  #: between neighbouring runs
        self.spent: list[Counters] = []
        self.ends = math.inf if request.max_seconds is None else time.perf_counter() + request.max_seconds

    @property
    def least_share(self) -> float:
        """Of the last difference: what is believed to be left at least."""
        return LEAST_SHARE if self.smooth else LEAST_SHARE_ELSE

    def run(self) -> Solution:
        """Runs until the error is shown to be small enough, or cannot be."""
        setting, failed = min(COARSEST[self.kind], self.accuracy if self.kind == "rtol" else math.inf), 0
        while True:
            found = self._solved(setting)
            if found.status is Status.success:
                self._keep(_Run(setting, found))
                failed = 0
                bound = self._bound()
                known = self._agreement() if bound is None else bound
                if known is not None and known <= self.accuracy:
                    return self._finished(known)
                setting = self._next(bound)
            elif found.status is Status.event:
                text = (
                    f"An error of {self.accuracy:g} is not shown: a terminal event ended the run at {self._told(setting)}; "
                )
                text += "runs that end at times of their own are not compared."
                return replace(found, status=Status.accuracy_not_shown, message=text, counters=_summed(self.spent))
            else:
                failed, self.last = failed + 1, found
                if self.runs or failed == TOLERATED or found.status in BUDGETS:
                    ended = f"{found.status.label}: {found.message.rstrip('.')}"
                    return self._unknown(f"a run at {self._told(setting)} ended with {ended}", found)
                setting /= self.finer
            if self._stalls() >= STALLS:
                return self._unknown("finer runs do not come nearer to one another")
            if setting < FINEST[self.kind]:
                return self._unknown(
                    f"a setting below {self._told(FINEST[self.kind])} would be needed, which roundoff decides"
                )
            if len(self.spent) == MOST_RUNS:
                return self._unknown(f"{MOST_RUNS} runs do not show it")

    def _solved(self, setting: float) -> Solution:
        left = self.ends - time.perf_counter()
        asked = {"rtol": setting} if self.kind == "rtol" else {"steps": round(1 / setting)}
        budget = None if left == math.inf else max(left, 1e-3)
        evaluations = self.request.max_evaluations
        if evaluations is not None:
            evaluations = max(evaluations - sum(c.residual_evaluations or 0 for c in self.spent), 1)
        request = replace(self.request, max_seconds=budget, max_evaluations=evaluations, **asked)
        found = self.once(request)
        self.spent.append(found.counters)
        return found

    def _keep(self, run: _Run) -> None:
        if self.runs:
            self.differences.append(float(np.max(self._rows_apart(self.runs[-1], run))))
        self.runs.append(run)

    def _rows_apart(self, coarse: _Run, fine: _Run) -> Vector:
        """Scaled difference of q and v at every output time, (2, k)."""
        a, b, scales = coarse.solution, fine.solution, self.problem.scales
        return np.array([_apart(a.q, b.q, scales.q), _apart(a.v, b.v, scales.v)])

    def _is_pair(self, last: int = 1) -> bool:
        """Whether the settings of a run, counted from the last, and of that before it differ by no more than a pair's."""
        if len(self.runs) <= last:
            return False
        return self.runs[-last - 1].setting / self.runs[-last].setting <= 1.01 * self.finer

    def _bound(self) -> float | None:
        """Of the last run's error, with SAFETY; None where the differences do not tell."""
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
        return SAFETY * max(last * max(self.least_share, contraction / (1 - contraction)), proportional)

    def _agreement(self) -> float | None:
        """Of the last run's error, where three runs are so near to one another that it matters little how they contract."""
        if len(self.differences) < 2 or not self._is_pair():
            return None
        return AGREEMENT * max(self.differences[-2:]) if self._differ_in_work() else None

    def _ratios(self) -> list[float]:
        """Of every difference to that before it."""
        return [b / a if a > 0.0 else math.inf for a, b in pairwise(self.differences)]

    def _stalls(self) -> int:
        """How often a difference did not contract that was small beside the motion: coarse runs may be anywhere."""
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
        """Whether the last runs took different steps: else they are one run, which tells nothing."""
        if self.known:
            return True
        return len({run.solution.counters.steps_accepted for run in self.runs[-3:]}) == len(self.runs[-3:])

    def _next(self, bound: float | None) -> float:
        """The next setting: the other run of a pair, or the first of a pair whose finer run should reach the accuracy."""
        last = self.runs[-1].setting
        if not self._is_pair():
            return last / self.finer
        error = SAFETY * self.least_share * self.differences[-1] if bound is None else bound
        share = 1.0 if error == 0.0 else max(AIM * self.accuracy / error, 1 / MOST_FINER)
        wanted = last * self.finer * share ** (1 / self.order)
        return wanted if wanted < last / self.finer**1.5 else last / self.finer

    def _finished(self, bound: float) -> Solution:
        who = "" if self.known else ", if the solver solves this problem"
        text = (
            f"The scaled error of q and v is at most {bound:.2g}, as {len(self.spent)} runs up to {self._told()} show{who}."
        )
        return self._solution(Status.success, f"{self.runs[-1].solution.message} {text}{self._scales()}", bound)

    def _unknown(self, why: str, failed: Solution | None = None) -> Solution:
        """What is known, where that is not enough."""
        seen = ""
        if self.differences:
            pair = " and ".join(self._told(run.setting) for run in self.runs[-2:])
            seen = f" Runs at {pair} differ by {self.differences[-1]:.2g} of the scales."
        failed = failed or self.last
        if not self.runs and failed is not None:
            return replace(failed, counters=_summed(self.spent))
        text = f"An error of {self.accuracy:g} is not shown: {why}.{seen}{self._scales()}"
        status = failed.status if failed is not None and failed.status in BUDGETS else Status.accuracy_not_shown
        return self._solution(status, text, None)

    def _scales(self) -> str:
        return f" {self.problem.note_on_scales}".rstrip()

    def _told(self, setting: float | None = None) -> str:
        setting = self.runs[-1].setting if setting is None else setting
        return f"rtol {setting:.2g}" if self.kind == "rtol" else f"{round(1 / setting)} steps"

    def _solution(self, status: Status, message: str, bound: float | None) -> Solution:
        finest = self.runs[-1]
        error = None
        if len(self.runs) > 1:
            share = SAFETY * self.least_share if not self.differences[-1] else (bound or math.nan) / self.differences[-1]
            apart = self._rows_apart(self.runs[-2], finest)
            rows = apart * share if bound is not None else np.full_like(apart, np.nan)
            lam = _apart(self.runs[-2].solution.lam, finest.solution.lam, self.problem.scales.lam) * share
            error = ErrorEstimate(
                asked=self.accuracy,
                bound=bound,
                q=rows[0],
                v=rows[1],
                lam=lam if bound is not None else np.full_like(lam, np.nan),
                differences=tuple(self.differences),
                settings=tuple(run.setting if self.kind == "rtol" else round(1 / run.setting) for run in self.runs),
            )
        counters = _summed(self.spent)
        return replace(
            finest.solution,
            status=status,
            message=message,
            error=error,
            counters=counters,
            extrapolated=self._extrapolated(bound),
        )

    def _extrapolated(self, bound: float | None) -> DenseOutput | None:
        """The limit of the last two runs, on the constraints, where errors fall by four, as those of three runs show.

        Offered without events, of solvers whose error is a smooth function of step or tolerance (``smooth_error``).
        """
        if bound is None or not (self.smooth and self._is_pair() and self._is_pair(2)):
            return None
        before, last = self.differences[-2:]
        if not 0.8 * before < 4 * last < 1.25 * before or any(map(np.size, self.runs[-1].solution.t_events)):
            return None
        fine, coarse = self.runs[-1].solution, self.runs[-2].solution
        limit = DenseOutput(fine.q + (fine.q - coarse.q) / 3, fine.v + (fine.v - coarse.v) / 3)
        return limit if fine.projection is None else fine.projection(fine.t, limit)


def _apart(a: Vector, b: Vector, scale: float | Vector) -> Vector:
    """Largest scaled difference in every row, (k,)."""
    return np.max(np.abs(a - b) / np.asarray(scale), axis=1, initial=0.0)


def _summed(spent: Sequence[Counters]) -> Counters:
    """Of all runs; what one does not report is not reported."""
    values: dict[str, int | None] = {}
    for name in (f.name for f in fields(Counters) if f.name != "provenance"):
        counts = [getattr(counters, name) for counters in spent]
        values[name] = None if None in counts else sum(counts)
    return Counters(**values, provenance=f"sum of {len(spent)} runs; {spent[-1].provenance}")
