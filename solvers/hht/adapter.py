"""The adapter of :class:`~solvers.hht.solver.HHT` for the bench."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from hhtbench.lowering.caching import ById
from hhtbench.protocol import NumpySystem, Problem, System
from hhtbench.request import Request
from hhtbench.result import Solution
from solvers._start import absolute_tolerances
from solvers.hht.equations.coefficients import NEAR_HALF
from solvers.hht.options import make_options
from solvers.hht.solver import HHT

KEPT = 8  # solvers of the systems that were solved last


@dataclass(frozen=True)
class HHTSolver:
    """The extended HHT-alpha method as the bench sees it: ``load_solver("hht(alpha=-0.1, b=0)")``.

    Takes prescribed steps, or tolerances; absolute ones are ``rtol`` times the problem's scales where a request gives none.
    """

    name: str
    options: Mapping[str, Any]
    integrator: type[HHT] = HHT

    def accepts(self, problem: Problem, request: Request) -> str | None:
        """Declines requests without steps and without tolerances."""
        known = tuple(f.name for f in fields(self.integrator.kind))
        unknown = sorted(set(request.options) - set(known))
        if unknown:
            return f"unknown option {', '.join(unknown)}; known: {', '.join(known)}"
        if declined := self.integrator.declined(problem, request, {**self.options, **request.options}):
            return declined
        if not request.fixed and request.rtol is None and request.atol is None:
            return "hht takes prescribed steps or tolerances: give step, steps, or rtol (and atol)"
        if request.atol is None and request.rtol is not None and np.any(np.asarray(request.rtol) == 0):
            return "rtol = 0 leaves no tolerance; give atol too"
        return None

    def solve(self, problem: Problem, request: Request) -> Solution:
        """Integrate ``problem`` over its interval."""
        options = {**self.options, **request.options}
        asked: dict[str, Any] = {name: value for name, value in vars(request).items() if name != "options"}
        if not request.fixed and request.atol is None:
            asked["atol"] = absolute_tolerances(problem, request)
        guesses = {"lam_guess": problem.lam_guess, "mu_guess": problem.mu_guess}
        with _lent(self.integrator, problem.system, options) as hht:
            return hht.solve(problem.t_span, problem.q0, problem.v0, **guesses, **asked)

    def warm_up(self, problem: Problem, request: Request) -> None:
        """Compile what :meth:`solve` will use, by one step without budgets; nothing is counted."""
        self.solve(problem, replace(request, max_num_steps=1, max_evaluations=None, max_seconds=None))


_kept: dict[Any, HHT] = {}  # of earlier solves: with what they have prepared
_lock = threading.Lock()


@contextmanager
def _lent(integrator: type[HHT], system: System | NumpySystem, options: Mapping[str, Any]) -> Iterator[HHT]:
    """An HHT with ``options`` for one solve: one that nobody uses now, else a new one."""
    key = integrator, ById(system), repr(options)  # True is no 1 here
    with _lock:
        hht = _kept.pop(key, None)
    hht = integrator(system, **options) if hht is None else hht
    yield hht
    if abs(hht.options.coefficients.b - 0.5) < NEAR_HALF:  # one that is warned of when it is made
        return
    with _lock:
        _kept[key] = hht
        while len(_kept) > KEPT:
            del _kept[next(iter(_kept))]


def solver(**options: Any) -> HHTSolver:
    """The extended HHT-alpha method; options as in :class:`~solvers.hht.options.HHTOptions`."""
    make_options(**options)
    return HHTSolver("hht", dict(options))
