"""Solvers that say success and are wrong, one way each."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import hhtbench as hb


class Honest:
    """Hands every request to another solver; the children tamper with what it returns."""

    name = "honest"

    def __init__(self, of="projected"):
        self.of = hb.load_solver(of)

    def accepts(self, problem, request):
        return self.of.accepts(problem, request)

    def solve(self, problem, request):
        return self.tampered(problem, self.of.solve(problem, request))

    def tampered(self, problem, solution):
        return solution


class Straight(Honest):
    """As if there were no forces."""

    def tampered(self, problem, solution):
        since = (solution.t - problem.t_span[0])[:, None]
        return replace(solution, q=problem.q0 + since * problem.v0, v=np.tile(problem.v0, (since.size, 1)))


class Larger(Honest):
    """A motion that becomes larger and larger than it is, by three in a hundred."""

    def tampered(self, problem, solution):
        share = (solution.t - problem.t_span[0]) / (problem.t_span[1] - problem.t_span[0])
        grown = 1.0 + 0.03 * share[:, None]
        return replace(solution, q=grown * solution.q, v=grown * solution.v)


class Frozen(Honest):
    """Nothing moves."""

    def tampered(self, problem, solution):
        count = solution.t.size
        return replace(solution, q=np.tile(problem.q0, (count, 1)), v=np.tile(problem.v0, (count, 1)))


class HalfWay(Honest):
    """The second half of the rows is missing."""

    def tampered(self, problem, solution):
        half = max(1, solution.t.size // 2)
        rows = {name: getattr(solution, name)[:half] for name in ("t", "q", "v", "lam", "mu")}
        return replace(solution, **rows)


class NotANumber(Honest):
    """One velocity is NaN."""

    def tampered(self, problem, solution):
        v = solution.v.copy()
        v[-1:, 0] = np.nan
        return replace(solution, v=v)


class OtherSign(Honest):
    """The reaction has the other sign."""

    def tampered(self, problem, solution):
        return replace(solution, lam=-solution.lam, mu=-solution.mu)


class Squeezed(Honest):
    """The arrays have lost a dimension where there is one coordinate too few to notice."""

    def tampered(self, problem, solution):
        return replace(solution, lam=solution.lam.ravel())


class Optimist(Honest):
    """Whatever happens is a success."""

    def tampered(self, problem, solution):
        return replace(solution, status=hb.Status.success)


class Slanderer(Honest):
    """Counts half of its work."""

    def tampered(self, problem, solution):
        counters = solution.counters
        if counters.residual_evaluations is None:
            return solution
        return replace(solution, counters=replace(counters, residual_evaluations=counters.residual_evaluations // 2))


class Remembering(Honest):
    """Every solve is a little beside the last."""

    calls = 0

    def tampered(self, problem, solution):
        self.calls += 1
        return replace(solution, q=solution.q * (1 + 1e-13 * self.calls))


class Writer(Honest):
    """Writes into the caller's start."""

    def solve(self, problem, request):
        solution = super().solve(problem, request)
        problem.q0.setflags(write=True)
        problem.q0[:] = solution.q[-1]
        return solution


class Swallower(Honest):
    """An exception of the system is a success."""

    def solve(self, problem, request):
        try:
            return super().solve(problem, request)
        except Exception as error:  # noqa: BLE001 - this is its lie
            return replace(error.partial_solution, status=hb.Status.success)


class Chatterer(Honest):
    """Prints."""

    def tampered(self, problem, solution):
        print("done")  # noqa: T201
        return solution


class Unhurried(Honest):
    """Budgets of time are not its business."""

    def solve(self, problem, request):
        return super().solve(problem, replace(request, max_seconds=None, max_num_steps=None, max_evaluations=None))


LIARS = {
    Straight: "position/tolerance",
    Frozen: "position/tolerance",
    HalfWay: "position/rows",
    NotANumber: "position/rows",
    OtherSign: "position/multipliers",
    Squeezed: "position/rows",
    Optimist: "nan/force",
    Slanderer: "counters/evaluations",
    Remembering: "repeat/twice",
    Writer: "inputs/untouched",
    Swallower: "exception/half_way",
    Chatterer: "inputs/world",
    Unhurried: "budget/steps",
}
