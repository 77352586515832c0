"""Problems in minimal coordinates, solved as plain ODEs and seen in the coordinates of the library's problem."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from hhtbench.protocol import Problem, Scales, System
from hhtbench.request import Request
from hhtbench.result import Solution
from tests.problems import minimal
from tests.problems.minimal import Minimal

AGREE = 1e-13  # how well the embedded start must be the problem's


@dataclass(frozen=True)
class Reduced:
    """A mechanism by minimal coordinates, and its start."""

    mechanism: Any  #: has ``embed`` (s -> q) and ``accelerations`` (s, u -> s'')
    s0: tuple[float, ...]
    u0: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class PaperPendulum:
    """The paper's pendulum by its angle."""

    m: float
    L: float
    k: float
    c: float
    g: float

    def embed(self, s: Any) -> Any:
        return jnp.stack([self.L * jnp.cos(s[0]), self.L * jnp.sin(s[0]), s[0]])

    def accelerations(self, s: Any, u: Any) -> Any:
        moment = self.c * u + self.k * (s - 1.5 * math.pi) + self.m * self.g * self.L * jnp.cos(s)
        return -moment / (4 * self.m * self.L**2 / 3)


def _point_pendulum(problem: Problem) -> Reduced:
    length, angle = float(np.hypot(*problem.q0)), math.atan2(problem.q0[1], problem.q0[0])
    place = lambda s: length * minimal.direction(s)  # noqa: E731
    system: Any = problem.system
    mass = jnp.asarray([float(np.asarray(system.m))])
    return Reduced(Minimal(lambda s: place(s).ravel(), place, mass, float(system.g)), (angle,), (0.0,))


def _paper_pendulum(problem: Problem) -> Reduced:
    system: Any = problem.system
    values = {name: float(getattr(system, name)) for name in ("m", "L", "k", "c", "g")}
    return Reduced(PaperPendulum(**values), (float(problem.q0[2]),), (float(problem.v0[2]),))


def _planar_chain(problem: Problem) -> Reduced:
    n = problem.q0.size // 3
    return Reduced(minimal.planar_chain(n, 1.0, 1.0, 9.81), (0.0,) * n, (0.0,) * n)


def _bead_chain(problem: Problem) -> Reduced:
    n = problem.q0.size // 3
    return Reduced(minimal.bead_chain(n, 1.0, 1.0, 9.81), (0.0,) * (2 * n), (0.0,) * n + (0.5,) * n)


def _stiff(problem: Problem) -> Reduced:
    return Reduced(minimal.stiff_spring_pendulum(1e4, [1.0, 1.0], [1.0, 1.0], 9.81), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))


def _slider_crank(problem: Problem) -> Reduced:
    return Reduced(minimal.slider_crank(1.0, 1.0, 1.0, 9.81), (math.pi / 4,), (4.0,))


def _four_bars(problem: Problem) -> Reduced:
    windows = (problem.q0.size // 3 - 1) // 2
    return Reduced(minimal.four_bars(windows, 1.0, 1.0, 9.81), (0.0,), (1.0,))


KNOWN: dict[str, Callable[[Problem], Reduced]] = {
    "jay_negrut_pendulum": _paper_pendulum,
    "simple_pendulum": _point_pendulum,
    "pendulum_period2": _point_pendulum,
    "redundant_pendulum": _point_pendulum,
    "planar_chain": _planar_chain,
    "bead_chain": _bead_chain,
    "stiff_spring_pendulum": _stiff,
    "slider_crank_equal_lengths": _slider_crank,
    "four_bars": _four_bars,
}


class Free(System):
    """``s'' = accelerations(s, s')``: no constraints, unit mass."""

    mechanism: Any = eqx.field(static=True)

    def force(self, t: Any, q: Any, v: Any) -> Any:
        return self.mechanism.accelerations(q, v)


@dataclass(frozen=True)
class MinimalSolver:
    """A solver of plain ODEs on the minimal coordinates of a problem; solutions in the problem's own coordinates."""

    solver: Any
    reduced: Reduced

    def accepts(self, problem: Problem, request: Request) -> str | None:
        return self.solver.accepts(self._problem(problem), request)

    def solve(self, problem: Problem, request: Request) -> Solution:
        found = self.solver.solve(self._problem(problem), request)
        if not len(found.t):
            return found
        q, v = (np.asarray(x) for x in embedded(self.reduced.mechanism)(found.q, found.v))
        none = np.zeros((len(found.t), 0))
        return replace(found, q=q, v=v, lam=none, mu=none)

    def warm_up(self, problem: Problem, request: Request) -> None:
        self.solver.warm_up(self._problem(problem), request)

    def _problem(self, problem: Problem) -> Problem:
        return minimal_problem(problem.name, problem.t_span, self.reduced)


@functools.cache
def embedded(mechanism: Any) -> Any:
    """(s, u), (k, d) each -> (q, v), (k, n) each."""
    return jax.jit(jax.vmap(lambda s, u: jax.jvp(mechanism.embed, (s,), (u,))))


@functools.cache
def minimal_problem(name: str, t_span: tuple[float, float], reduced: Reduced) -> Problem:
    """The problem that a solver of plain ODEs sees."""
    s0, u0 = np.array(reduced.s0), np.array(reduced.u0)
    return Problem(
        name=f"{name}, minimal coordinates",
        system=Free(mechanism=reduced.mechanism),
        t_span=t_span,
        q0=s0,
        v0=u0,
        scales=Scales(q=1.0, v=1.0, lam=1.0),
        source="tests/problems/minimal.py",
    )


def reduced_of(problem: Problem) -> Reduced | None:
    """The problem by minimal coordinates, where they are known.

    Raises
    ------
    ValueError
        Their start is not the problem's.
    """
    make = KNOWN.get(problem.name)
    if make is None:
        return None
    reduced = make(problem)
    q, v = embedded(reduced.mechanism)(np.array([reduced.s0]), np.array([reduced.u0]))
    apart = max(np.abs(np.asarray(q[0]) - problem.q0).max(), np.abs(np.asarray(v[0]) - problem.v0).max())
    if apart > AGREE * (1.0 + float(np.abs(problem.q0).max() + np.abs(problem.v0).max())):
        raise ValueError(f"{problem.name}: the start in minimal coordinates is off by {apart:.1e}")
    return reduced
