"""Global error control: repeat a solver with finer settings until its differences show that the error is small enough.

A tolerance bounds an estimate of the local error; the global error at the end is 1 to 200 times as large, depending on the
problem.  Two runs whose settings differ by a fixed factor differ by the error of the coarser one; a third shows whether
that contracts.  An estimate is given only if it does.  `hhtbench verify accuracy` checks the estimate.

Runs that step over the same short force agree too.  So where they agree far better than was asked, in few steps, the
equations of motion are checked between the rows (:mod:`hhtbench.checks.result.between`).  An objection is resolved by runs
with shorter steps, if the solver takes ``max_step``, or the error stays unshown.  A force pulse shorter than 1/200 of the
interval may lie between the places that are checked, and one during a motion that needs more steps than that is not
searched for.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import fields, replace

import numpy as np

from hhtbench.checks.finer_runs import FinerRuns, Run, taken_by
from hhtbench.checks.result.between import PLACES, SteppedOver, stepped_over
from hhtbench.protocol.arguments import real_number
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.protocol.system import NumpySystem
from hhtbench.solution.request import Request
from hhtbench.solution.result import Counters, Solution, Status

Once = Callable[[Request], Solution]

ROWS = 101  # equal distances, where no output times are asked for
MIN_ACCURACY = 1e-13  # smallest error that can be asked for: states carry roundoff of 1e-16 over thousands of steps
COARSEST = {"rtol": 1e-2, "steps": 1 / 25}
FIRST = 1e-6  # tightest tolerance of the first run: beyond, one of low order may end at roundoff and show nothing
FINEST = {"rtol": 1e-14, "steps": 1e-8}
STALLS = 2  # differences that do not contract, after which the search ends (roundoff)
TOO_GOOD = 0.05  # differences below this share of the error asked for may come from a force that no run has met
#: steps, and how many times as many in the last run as two before: so few are checked however they agree
FEW_STEPS, ALIKE = 25, 1.2
OFF = 3.0  # times the bound: largest distance of the integrated motion from the next row
LEAST_OFF = 1e-11  # which the integration there does not see
SHORTER = (1 / (4 * PLACES), 1 / (32 * PLACES))  # longest steps over the interval where longer ones step over something
PLAIN = Problem(name="plain", system=NumpySystem(force=lambda t, q, v: -q), t_span=(0.0, 1.0), q0=np.ones(1), v0=np.zeros(1))
MOST_RUNS = 12
BUDGETS = (Status.deadline, Status.evaluation_budget)
TOLERATED = 3  # runs in a row that fail: some libraries start at tight tolerances only


def solve_to(problem: Problem, solver: Solver, accuracy: float, request: Request, once: Once) -> Solution:
    """Return a solution whose error in q and v, scaled by the problem's scales, is below ``accuracy`` at every output time.

    Parameters
    ----------
    accuracy
        Largest scaled error of q and v over the output times.
    request
        Output times (101 equally spaced ones if it has none), and budgets of all runs together; no tolerances, no steps.
    once
        Function that runs the solver once on the problem.

    Returns
    -------
    Solution
        That of the finest run, with :attr:`~hhtbench.Solution.error`; its counters are those of all runs.  Its status is
        ``accuracy_not_shown`` if no estimate below ``accuracy`` can be trusted, and the message says what is known.

    Raises
    ------
    ProblemError
        ``accuracy`` is below what roundoff allows or above a half, or comes with tolerances or steps.
    """
    accuracy = real_number("accuracy", accuracy)
    if not MIN_ACCURACY <= accuracy <= 0.5:
        raise ProblemError(
            f"accuracy must lie between {MIN_ACCURACY:g} (roundoff) and 0.5, of the problem's scales; got {accuracy:g}."
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
    return _Search(problem, solver, accuracy, request, once, kind).run()


def _what_is_refined(problem: Problem, solver: Solver, request: Request) -> tuple[str | None, str]:
    """Return "rtol" if the solver takes tolerances, else "steps"; None and the reason if it takes neither."""
    asked = {"rtol": replace(request, rtol=COARSEST["rtol"]), "steps": replace(request, steps=round(1 / COARSEST["steps"]))}
    reasons = {kind: solver.accepts(problem, one) for kind, one in asked.items()}
    for kind, reason in reasons.items():
        if reason is None:
            return kind, ""
    usual = next((kind for kind, one in asked.items() if solver.accepts(PLAIN, one) is None), "rtol")
    return None, reasons[usual] or ""


class _Search:
    """State of the search for a sufficiently accurate run."""

    def __init__(self, problem: Problem, solver: Solver, accuracy: float, request: Request, once: Once, kind: str) -> None:
        self.problem, self.solver, self.accuracy = problem, solver, accuracy
        self.request, self.once, self.kind = request, once, kind
        self.finer = FinerRuns(problem, kind)
        self.finer.smooth = kind == "steps" or getattr(solver, "smooth_error", False)
        self.finer.known = getattr(solver, "heeds_tolerances", False)
        self.last: Solution | None = None  #: solution of the last run that failed
        self.spent: list[Counters] = []
        self.looks = 0  #: evaluations between rows
        self.shorter = list(SHORTER)  #: longest steps that are left to be tried
        #: a solution that stepped over something, and what was seen there
        self.missed: tuple[Solution, SteppedOver] | None = None
        self.first = COARSEST[kind] if kind == "steps" else min(COARSEST[kind], max(accuracy, FIRST))
        self.ends = math.inf if request.max_seconds is None else time.perf_counter() + request.max_seconds

    def run(self) -> Solution:
        """Run with finer settings until the error is shown to be small enough, or cannot be."""
        setting, failed = self.first, 0
        while True:
            found = self._solved(setting)
            if found.status is Status.success:
                self.finer.keep(Run(setting, found))
                failed = 0
                bound = self.finer.bound()
                known = self.finer.agreement() if bound is None else bound
                if known is not None and known <= self.accuracy:
                    doubt = self._doubt(known)
                    if not doubt:
                        return self._finished(known)
                    if not self._shorten():
                        return self._unknown(doubt)
                    setting = self.first
                else:
                    setting = self.finer.next_setting(self.accuracy, bound)
            elif found.status is Status.event:
                text = f"An error of {self.accuracy:g} is not shown: a terminal event ended the run at {self._at(setting)}; "
                text += "runs that end at times of their own are not compared."
                return replace(found, status=Status.accuracy_not_shown, message=text, counters=self._work())
            else:
                failed, self.last = failed + 1, found
                if self.finer.runs or failed == TOLERATED or found.status in BUDGETS:
                    ended = f"{found.status.label}: {found.message.rstrip('.')}"
                    return self._unknown(f"a run at {self._at(setting)} ended with {ended}", found)
                setting /= self.finer.finer
            if self.finer.stalls() >= STALLS:
                return self._unknown("finer runs do not come nearer to one another")
            if setting < FINEST[self.kind]:
                return self._unknown(
                    f"a setting below {self._at(FINEST[self.kind])} would be needed, which roundoff decides"
                )
            if len(self.spent) == MOST_RUNS:
                return self._unknown(f"{MOST_RUNS} runs do not show it")

    def _solved(self, setting: float) -> Solution:
        left = self.ends - time.perf_counter()
        asked = {"rtol": setting} if self.kind == "rtol" else {"steps": round(1 / setting)}
        budget = None if left == math.inf else max(left, 1e-3)
        evaluations = self.request.max_evaluations
        if evaluations is not None:
            evaluations = max(evaluations - self.looks - sum(c.residual_evaluations or 0 for c in self.spent), 1)
        kept = self.request.keep_steps or (self.request.t_eval is not None and self.request.t_eval.size < ROWS)
        request = replace(self.request, max_seconds=budget, max_evaluations=evaluations, keep_steps=kept, **asked)
        found = self.once(request)
        self.spent.append(found.counters)
        return found

    def _doubt(self, bound: float) -> str:
        """Check the equations of motion between the rows if the runs may have missed a force; return the objection or ""."""
        last, taken = self.finer.runs[-1].solution, taken_by(self.finer.runs[-1])
        if self.missed is None:
            few = taken is not None and taken < FEW_STEPS and taken <= ALIKE * (taken_by(self.finer.runs[-3]) or 0)
            agree = min(bound, *self.finer.differences[-2:]) <= TOO_GOOD * self.accuracy
            if (taken is not None and taken >= PLACES) or not (few or agree):
                return ""
        elif np.max(self.finer.rows_apart(last, self.missed[0])) < self.missed[1].off / 2:
            return self.missed[1].text
        look = stepped_over(self.problem, last, max(OFF * bound, LEAST_OFF))
        self.looks += look.evaluations
        self.missed = (last, look) if look.text else self.missed
        return look.text

    def _shorten(self) -> bool:
        """Restart with a smaller ``max_step``; False if that was done already or the solver takes no such option."""
        if not self.shorter:
            return False
        longest = self.shorter.pop(0) * abs(self.problem.t_span[1] - self.problem.t_span[0])
        options = {**self.request.options, "first_step": None, "min_step": None, "max_step": longest}
        request = replace(self.request, options=options)
        if self.solver.accepts(self.problem, replace(request, rtol=self.first)) is not None:
            return False
        self.request = request
        self.finer.clear()
        self.finer.bounded = True
        return True

    def _finished(self, bound: float) -> Solution:
        who = "" if self.finer.known else ", if the solver solves this problem"
        text = f"The scaled error of q and v is at most {bound:.2g}, as {len(self.spent)} runs up to {self._at()} show{who}."
        return self._solution(Status.success, f"{self.finer.runs[-1].solution.message} {text}{self._scales()}", bound)

    def _unknown(self, why: str, failed: Solution | None = None) -> Solution:
        """Return the finest solution with a message on what is known although the accuracy is not shown."""
        seen = ""
        if self.finer.differences:
            pair = " and ".join(self._at(run.setting) for run in self.finer.runs[-2:])
            seen = f" Runs at {pair} differ by {self.finer.differences[-1]:.2g} of the scales."
        failed = failed or self.last
        if not self.finer.runs and failed is not None:
            return replace(failed, counters=self._work())
        text = f"An error of {self.accuracy:g} is not shown: {why}.{seen}{self._scales()}"
        status = failed.status if failed is not None and failed.status in BUDGETS else Status.accuracy_not_shown
        return self._solution(status, text, None)

    def _at(self, setting: float | None = None) -> str:
        setting = self.finer.runs[-1].setting if setting is None else setting
        return f"rtol {setting:.2g}" if self.kind == "rtol" else f"{round(1 / setting)} steps"

    def _scales(self) -> str:
        return f" {self.problem.note_on_scales}".rstrip()

    def _solution(self, status: Status, message: str, bound: float | None) -> Solution:
        finest = self.finer.runs[-1]
        return replace(
            finest.solution,
            status=status,
            message=message,
            error=self.finer.estimate(self.accuracy, bound),
            counters=self._work(),
            ends=finest.solution.ends if self.request.keep_steps else None,
            extrapolated=self.finer.extrapolated(bound),
        )

    def _work(self) -> Counters:
        """Sum the counters of all runs and of the checks between them; a counter that one run does not report is None."""
        values: dict[str, int | None] = {}
        for name in (f.name for f in fields(Counters) if f.name != "provenance"):
            counts = [getattr(counters, name) for counters in self.spent]
            values[name] = None if None in counts else sum(counts)
        if self.looks and values["residual_evaluations"] is not None:
            values["residual_evaluations"] += self.looks
        more = f" and of {self.looks} accelerations between their rows" if self.looks else ""
        return Counters(**values, provenance=f"sum of {len(self.spent)} runs{more}; {self.spent[-1].provenance}")
