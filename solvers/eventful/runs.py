"""Runs of the solver itself over parts of the interval, within the budgets of the whole."""

from __future__ import annotations

import math
import warnings
from dataclasses import fields
from functools import partial
from typing import Any

import numpy as np

from hhtbench.protocol.arguments import Vector
from hhtbench.solution.counting import Clock, Work
from hhtbench.solution.request import ADDS_UP, Request
from hhtbench.solution.result import Counters, Solution
from solvers._start import Failure
from solvers.eventful.phase import PhaseFunctions
from solvers.eventful.steps import Point


class SolverRuns:
    """Runs of ``solver`` without events, as ``request`` asks; ``span``: length of the whole interval [s]."""

    def __init__(self, solver: Any, request: Request, span: float, clock: Clock) -> None:
        self.solver, self.request = solver, request
        self.h = None if not request.fixed else request.step or span / request.steps  #: constant step [s]
        self.work, self._spent, self._output = Work(clock=clock), list[Counters](), list[Counters]()

    def between(
        self, phase: PhaseFunctions, start: Point, end: float, *, begun: bool, bound: bool, t_eval: Vector | None = None
    ) -> Solution:
        """The solver from ``start`` to ``end`` [s]; with ``t_eval`` for output, beside the budgets.

        ``begun``: the motion has begun before, so that the start may have drifted off the constraints, unless it is
        ``bound`` to them.
        """
        fixed = {} if self.h is None else {"step": None, "steps": _equal_steps(self.h, abs(end - start.t))}
        asked = self.request.but(t_eval=t_eval, **fixed)
        for budget, counter in (("max_num_steps", "steps_accepted"), ("max_evaluations", "residual_evaluations")):
            if (most := getattr(asked, budget)) is not None:
                left = most - sum(getattr(one, counter) or 0 for one in self._spent)
                asked = asked.but(**{budget: max(left, 1) if t_eval is None else None})
        q, v = start.q, start.v
        if begun and phase.dynamics.structure.constrained:
            moved = start if bound else phase.consistent(start)
            q, v = (q, v) if isinstance(moved, Failure) else (moved.q, moved.v)
            asked = asked.but(calc_initcond=False)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="atol=")  # of the sizes in a part of the motion
            found: Solution = self.solver.solve(phase.problem.starting((start.t, end), q, v), asked)
        (self._spent if t_eval is None else self._output).append(found.counters)
        return found

    def counters(self) -> Counters:
        """Work of all runs; that of rows at asked times as output."""
        parts = partial(_summed, [*self._spent, self.work.counters()])
        found = {one.name: parts(one.name) for one in fields(Counters) if one.name != "provenance"}
        if self._output and found["output_evaluations"] is not None:
            found["output_evaluations"] += _summed(self._output, "residual_evaluations") or 0
        return Counters(**found, provenance=self._spent[0].provenance if self._spent else "counted")


def _equal_steps(h: float, span: float) -> Vector:
    """Lengths [s] of steps ``h`` over ``span`` [s], the last one up to its end."""
    count = max(1, math.ceil(span / h * (1.0 - ADDS_UP)))
    lengths = np.full(count, h)
    lengths[-1] = span - (count - 1) * h
    return lengths


def _summed(parts: list[Counters], name: str) -> int | None:
    values = [getattr(one, name) for one in parts]
    return None if None in values else sum(values)
