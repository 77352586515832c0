"""Faulty solvers: each reports success, with rows that are no motion of the problem, or with numbers that cannot be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench import Problem, Request, Solution, Status
from hhtbench.lowering import ConstraintLevels, derive, reduce_redundant
from hhtbench.lowering.dynamics.kkt import AccelerationLevel

STEPS = 400  # rows where no times are asked for
FAR = 1e3  # of the size: beyond it what an integration without reactions gives is kept where it was

Rows = tuple[np.ndarray, np.ndarray]


def straight_line(problem: Problem, t: np.ndarray) -> Rows:
    """No force acts."""
    elapsed = (t - problem.t_span[0])[:, None]
    return problem.q0 + elapsed * problem.v0, np.repeat(problem.v0[None], t.size, axis=0)


def frozen(problem: Problem, t: np.ndarray) -> Rows:
    """The start, for ever."""
    return np.repeat(problem.q0[None], t.size, axis=0), np.repeat(problem.v0[None], t.size, axis=0)


def without_reaction(problem: Problem, t: np.ndarray) -> Rows:
    """The constraints do not act."""
    return _integrated(problem, t, reaction=False)


def other_force(problem: Problem, t: np.ndarray) -> Rows:
    """The motion of another parameter: all forces are a fifth larger."""
    return _integrated(problem, t, force=1.2)


def slow(problem: Problem, t: np.ndarray) -> Rows:
    """The motion at half the speed of its clock: its end is the middle."""
    t0 = problem.t_span[0]
    return _integrated(problem, t0 + (t - t0) / 2)


def stopped(problem: Problem, t: np.ndarray) -> Rows:
    """The motion as far as the middle, and the state there until the end."""
    return _integrated(problem, t, until=sum(problem.t_span) / 2)


MOTIONS: dict[str, Callable[[Problem, np.ndarray], Rows]] = {
    "straight line": straight_line,
    "frozen": frozen,
    "without reaction": without_reaction,
    "other force": other_force,
    "slow clock": slow,
    "stopped half-way": stopped,
}


def _accelerations(problem: Problem, force: float = 1.0, reaction: bool = True) -> Callable[[float, np.ndarray], np.ndarray]:
    """y' of y = [q, v] with forces ``force`` times as large, with or without the reactions of the constraints."""
    t, n = problem.t_span[0], problem.q0.size
    dynamics: Any = derive(problem.system, t, problem.q0, problem.v0)
    if dynamics.structure.constrained:
        rank = ConstraintLevels(dynamics, full=True).at(t, problem.q0, problem.v0).rank
        dynamics = reduce_redundant(dynamics, rank.redundant) if rank.redundant else dynamics
    level, s = AccelerationLevel(dynamics, full=True), dynamics.structure
    size = n + s.m + s.p
    guess, nothing = np.zeros((2, size))
    if not s.linear_reaction and problem.lam_guess is not None:
        guess[n : n + s.m] = problem.lam_guess

    def rates(t: float, y: np.ndarray) -> np.ndarray:
        q, v, x = y[:n].copy(), y[n:].copy(), guess.copy()
        kept = slice(0, size if reaction else n)
        applied = (1.0 - force) * level.terms(t, q, v, nothing)[0][:n] if force != 1.0 else 0.0
        for _ in range(1 if s.linear_reaction else 12):
            residual, matrix = level.terms(t, q, v, x)
            residual = residual.copy()
            residual[:n] -= applied
            x[kept] -= np.linalg.lstsq(matrix[kept, kept], residual[kept])[0]
        return np.concatenate([v, x[:n]])

    return rates


def _integrated(problem: Problem, t: np.ndarray, until: float | None = None, **how: Any) -> Rows:
    """The motion at ``t`` [s], with what it was at ``until`` from then on."""
    times = t if until is None else np.minimum(t, until)
    y0, t0 = np.concatenate([problem.q0, problem.v0]), problem.t_span[0]
    far = lambda _, y: FAR * (1.0 + np.max(np.abs(y0))) - np.max(np.abs(y))  # noqa: E731
    far.terminal = True  # type: ignore[attr-defined]
    found = solve_ivp(
        _accelerations(problem, **how),
        (t0, times[-1]),
        y0,
        method="LSODA",
        rtol=1e-8,
        atol=1e-10,
        dense_output=True,
        events=far,
    )
    y = found.sol(np.minimum(times, found.t[-1])).T
    return y[:, : problem.q0.size], y[:, problem.q0.size :]


class Returning:
    """A solver from elsewhere that returns what it was made with, or what ``change`` makes of HHT's solution."""

    name = "returning"

    def __init__(self, returned: Any = None, change: Callable[[Solution], Any] | None = None) -> None:
        self.returned, self.change = returned, change

    def accepts(self, problem: Problem, request: Request) -> str | None:
        return None

    def solve(self, problem: Problem, request: Request) -> Any:
        return self.returned if self.change is None else self.change(hb.load_solver("hht").solve(problem, request))


@dataclass
class Faulty:
    """A solver that gives the rows of one of ``MOTIONS``."""

    motion: str
    name: str = "faulty"

    def accepts(self, problem: Problem, request: Request) -> str | None:
        return None

    def solve(self, problem: Problem, request: Request) -> Solution:
        t = np.linspace(*problem.t_span, STEPS) if request.t_eval is None else request.t_eval
        s = derive(problem.system, problem.t_span[0], problem.q0, problem.v0).structure
        q, v = MOTIONS[self.motion](problem, np.asarray(t))
        lam, mu = np.zeros((t.size, s.m)), np.zeros((t.size, s.p))
        return Solution(t=t, q=q, v=v, lam=lam, mu=mu, status=Status.success, message="there")
