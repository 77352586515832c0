"""``minimal(solver=scipy|cvode|hht, ...)``: an ODE solver on a problem's minimal coordinates, as a fair comparison.

A mechanism described by as many coordinates as degrees of freedom needs no method for constraints, and none drifts.
Solutions are given in the problem's own coordinates, with multipliers of the acceleration level.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from hhtbench.lowering import Dynamics
from hhtbench.protocol.arguments import Matrix
from hhtbench.protocol.errors import ProblemError
from hhtbench.protocol.problem import MinimalCoordinates, Problem, Solver
from hhtbench.protocol.scales import Scales
from hhtbench.solution.counting import Work
from hhtbench.solution.request import Request
from hhtbench.solution.result import Ends, Solution, ends_of
from solvers import cvode, hht, scipy_ivp
from solvers._adapter import choose
from solvers._ending import OwnMultipliers, solution_of
from solvers._start import Failure, PhasePoint, dynamics_for

INNER: dict[str, Callable[..., Any]] = {"scipy": scipy_ivp.solver, "cvode": cvode.solver, "hht": hht.solver}
MAX_REMEMBERED = 16  # problems whose coordinates and traced functions are cached


@dataclass(frozen=True)
class MinimalSolver:
    """An ODE solver on minimal coordinates; solutions are in the problem's own coordinates."""

    name: str
    inner: Solver

    def accepts(self, problem: Problem, request: Request) -> str | None:
        """Reason why a request is declined (no minimal coordinates, array atol, ...), or None."""
        if problem.minimal is None:
            return "no minimal coordinates are written down for this problem"
        if request.calc_initcond:
            return "minimal coordinates have no inconsistent start: leave calc_initcond out"
        if np.ndim(request.atol):
            return "atol must be a number: the components of the minimal coordinates are others"
        return self.inner.accepts(_reduced(problem.minimal, problem.t_span, problem.name), request)

    def solve(self, problem: Problem, request: Request) -> Solution:
        """Integrate, convert every row to the problem's coordinates, and recover multipliers."""
        if problem.minimal is None:
            raise ProblemError(f"{problem.name}: {self.accepts(problem, request)}.")
        found = self.inner.solve(_reduced(problem.minimal, problem.t_span, problem.name), request)
        if not found.t.size:
            n, none = problem.q0.size, np.zeros((0, 0))
            return replace(found, q=np.zeros((0, n)), v=np.zeros((0, n)), lam=none, mu=none, interpolant=None, ends=None)
        q, v = _embedded(problem.minimal, found.q, found.v)
        ends = ends_of(found) if request.keep_steps else None
        if ends is not None:
            at_ends = _embedded(problem.minimal, ends.q, ends.v)
            ends = Ends(t=ends.t, q=at_ends[0], v=at_ends[1])
        place = PhasePoint(problem.t_span[0], problem.q0, problem.v0)
        run = _Seen(dynamics_for(problem.system, place), Work())
        s = run.dynamics.structure
        lam, mu = np.full((found.t.size, s.m), np.nan), np.full((found.t.size, s.p), np.nan)
        guesses = (np.zeros(s.m) if problem.lam_guess is None else problem.lam_guess, np.zeros(s.p))
        own = OwnMultipliers(lam, mu, guesses, "unknown", "unknown", "unknown")
        whole = solution_of(run, Failure(found.status, found.message), (found.t, q, v), own, ends=ends)
        return replace(whole, counters=found.counters)

    def warm_up(self, problem: Problem, request: Request) -> None:
        """Compile what :meth:`solve` will use."""
        short = replace(request, max_num_steps=1, max_evaluations=None, max_seconds=None)
        self.solve(problem, short)

    def evaluates(self, problem: Problem) -> tuple[str, Problem]:
        """Kind of one residual evaluation, and the problem it is of, in minimal coordinates."""
        if problem.minimal is None:
            raise ProblemError(f"{problem.name} has no minimal coordinates.")
        inner: Any = self.inner  # all of INNER have ``evaluates``
        found: tuple[str, Problem] = inner.evaluates(_reduced(problem.minimal, problem.t_span, problem.name))
        return found


@dataclass
class _Seen:
    """The constrained system and counters that :func:`~solvers._ending.solution_of` needs."""

    dynamics: Dynamics
    work: Work


@functools.lru_cache(MAX_REMEMBERED)
def _coordinates(make: Callable[[], MinimalCoordinates]) -> MinimalCoordinates:
    return make()


@functools.lru_cache(MAX_REMEMBERED)
def _reduced(make: Callable[[], MinimalCoordinates], t_span: tuple[float, float], name: str) -> Problem:
    """The problem in minimal coordinates."""
    found = _coordinates(make)
    q0, v0 = np.asarray(found.s0, dtype=float), np.asarray(found.u0, dtype=float)
    fastest = float(np.max(np.abs(v0), initial=1.0))
    scales = Scales(q=1.0, v=fastest)
    return Problem(name=f"{name}, minimal coordinates", system=found.system, t_span=t_span, q0=q0, v0=v0, scales=scales)


@functools.lru_cache(MAX_REMEMBERED)
def _embedding(make: Callable[[], MinimalCoordinates]) -> Any:
    """Compiled map (s, u), (k, d) each -> (q, v), (k, n) each."""
    embed = _coordinates(make).embed
    return jax.jit(jax.vmap(lambda s, u: jax.jvp(embed, (s,), (u,))))


def _embedded(make: Callable[[], MinimalCoordinates], s: Matrix, u: Matrix) -> list[Matrix]:
    """q and v, (k, n) each, from s and u, (k, d) each; k is padded to powers of two, so that few shapes are compiled."""
    room = (1 << (len(s) - 1).bit_length()) - len(s)
    padded = (np.pad(rows, ((0, room), (0, 0)), mode="edge") for rows in (s, u))
    return [np.array(rows)[: len(s)] for rows in _embedding(make)(*padded)]


def solver(*, solver: str = "scipy", **options: Any) -> MinimalSolver:
    """Minimal coordinates; options ``solver``: scipy (default), cvode or hht, and the options of that one."""
    choose("minimal", {"solver": solver}, {"solver": tuple(INNER)})
    inner = INNER[solver](**options)
    return MinimalSolver(f"minimal({inner.name})", inner)
