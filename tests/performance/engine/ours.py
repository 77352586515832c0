"""Steps of the library that are measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution
from solvers.hht import HHT


def constant_steps(problem: Problem, h: float, steps: int, **method: Any) -> Solution:
    """``steps`` steps of length ``h`` [s] from the problem's start; output at the end only.

    Raises
    ------
    RuntimeError
        They did not succeed.
    """
    end = problem.t_span[0] + h * steps
    guesses = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
    solution = HHT(problem.system, **method, engine="compiled").solve(
        (problem.t_span[0], end), problem.q0, problem.v0, steps=steps, t_eval=np.array([end]), **guesses
    )
    if not solution.success:
        raise RuntimeError(f"{problem.name}: {solution.message}")
    return solution
