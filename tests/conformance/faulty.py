"""Solvers that say success and are wrong, one way each, and the check that must find it."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import numpy as np

import hhtbench as hb


class Honest:
    """Hands every request to another solver; a fault tampers with what it returns."""

    name = "honest"

    def __init__(self, fault=None):
        self.of, self.fault, self.calls = hb.load_solver("projected"), fault, 0

    def accepts(self, problem, request):
        return self.of.accepts(problem, request)

    def solve(self, problem, request):
        self.calls += 1
        solution = self.of.solve(problem, request)
        return replace(solution, **self.fault(self, problem, solution)) if self.fault else solution


def share(problem, solution):
    """Of the interval, (k, 1)."""
    return ((solution.t - problem.t_span[0]) / (problem.t_span[1] - problem.t_span[0]))[:, None]


def straight_on(solver, problem, solution):
    since = (solution.t - problem.t_span[0])[:, None]
    return {"q": problem.q0 + since * problem.v0, "v": np.tile(problem.v0, (since.size, 1))}


def larger_by_three_percent(solver, problem, solution):
    grown = 1.0 + 0.03 * share(problem, solution)
    return {"q": grown * solution.q, "v": grown * solution.v}


def frozen(solver, problem, solution):
    count = solution.t.size
    return {"q": np.tile(problem.q0, (count, 1)), "v": np.tile(problem.v0, (count, 1))}


def half_of_the_rows(solver, problem, solution):
    half = max(1, solution.t.size // 2)
    return {name: getattr(solution, name)[:half] for name in ("t", "q", "v", "lam", "mu")}


def one_velocity_is_nan(solver, problem, solution):
    v = solution.v.copy()
    v[-1:, 0] = np.nan
    return {"v": v}


def reaction_of_the_other_sign(solver, problem, solution):
    return {"lam": -solution.lam, "mu": -solution.mu}


def a_dimension_lost(solver, problem, solution):
    return {"lam": solution.lam.ravel()}


def always_success(solver, problem, solution):
    return {"status": hb.Status.success}


def no_message(solver, problem, solution):
    return {"message": ""}


def half_of_the_work_counted(solver, problem, solution):
    counted = solution.counters.residual_evaluations
    return {"counters": replace(solution.counters, residual_evaluations=None if counted is None else counted // 2)}


def one_step_too_many_counted(solver, problem, solution):
    return {"counters": replace(solution.counters, steps_accepted=(solution.counters.steps_accepted or 0) + 1)}


def each_solve_beside_the_last(solver, problem, solution):
    return {"q": solution.q * (1 + 1e-13 * solver.calls)}


def start_written_into(solver, problem, solution):
    problem.q0.setflags(write=True)
    problem.q0[:] = solution.q[-1]
    return {}


def prints(solver, problem, solution):
    print("done")  # noqa: T201
    return {}


class Swallowing(Honest):
    """An exception of the system is a success."""

    def solve(self, problem, request):
        try:
            return super().solve(problem, request)
        except Exception as error:  # noqa: BLE001 - this is its fault
            return replace(error.partial_solution, status=hb.Status.success)


class Unhurried(Honest):
    """Budgets are not its business."""

    def solve(self, problem, request):
        return super().solve(problem, replace(request, max_seconds=None, max_num_steps=None, max_evaluations=None))


class Mute(Honest):
    """Declines without a reason."""

    def accepts(self, problem, request):
        reason = super().accepts(problem, request)
        return None if reason is None else ""


class Curious(Honest):
    """Calls the force before it has accepted."""

    def accepts(self, problem, request):
        with contextlib.suppress(TypeError):
            problem.system.force(0.0, problem.q0, problem.v0)
        return super().accepts(problem, request)


FAULTS = {
    straight_on: "position/tolerance",
    frozen: "position/tolerance",
    half_of_the_rows: "position/rows",
    one_velocity_is_nan: "position/rows",
    no_message: "position/rows",
    reaction_of_the_other_sign: "position/multipliers",
    a_dimension_lost: "position/rows",
    always_success: "nan/force",
    half_of_the_work_counted: "counters/evaluations",
    one_step_too_many_counted: "counters/sizes",
    each_solve_beside_the_last: "repeat/twice",
    start_written_into: "inputs/untouched",
    prints: "inputs/world",
    Swallowing: "exception/half_way",
    Unhurried: "budget/steps",
    Mute: "declines/says_why",
    Curious: "declines/without_calling",
}


def faulty(fault):
    """The solver with one of the faults."""
    return fault() if isinstance(fault, type) else Honest(fault)
