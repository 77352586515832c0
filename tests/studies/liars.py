"""Solvers that mislead, for the study of stability: no figure of it may count them as right."""

from __future__ import annotations

import time

import numpy as np

import hhtbench as hb


class Straight:
    """Goes straight on, constraints or not, and says success; ``judges_itself`` keeps the bench from looking."""

    name = "straight"
    judges_itself = True

    def accepts(self, problem, request):
        return None

    def solve(self, problem, request):
        t0, t1 = problem.t_span
        t = np.linspace(t0, t1, 5) if request.t_eval is None else request.t_eval
        q, v = problem.q0 + np.outer(t - t0, problem.v0), np.tile(problem.v0, (t.size, 1))
        rows = np.size(problem.system.constraint(t0, problem.q0))
        lam, mu = np.zeros((t.size, rows)), np.zeros((t.size, 0))
        return hb.Solution(t=t, q=q, v=v, lam=lam, mu=mu, status=hb.Status.success, message="")


class Raising(Straight):
    """Raises where a status is expected."""

    def solve(self, problem, request):
        raise ArithmeticError("lost")


class Sleeping(Straight):
    """Looks at no clock."""

    def solve(self, problem, request):
        time.sleep(3600.0)


class Dying(Straight):
    """Takes its process along."""

    def solve(self, problem, request):
        import os

        os._exit(7)
