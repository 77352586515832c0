"""A pendulum far from the origin of time, by every solver: a right end or a typed refusal, never a wrong success.

``python -m tests.performance.time_origins [SOLVER ...]`` prints for every solver, origin t0 and tolerance the error at the
end, at most 10 times the larger of tolerance and eps t0 / span; it leaves with 1 where a success is beyond that.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import hhtbench as hb
from hhtbench.protocol.problem import Problem
from hhtbench.protocol.system import System

ORIGINS = (0.0, 1e3, 1e6, 1e9, 1e12, 1e15)  # [s]
TOLERANCES = (1e-4, 1e-6, 1e-8)
ANGLE, SPAN = 0.2, 1.0  # [rad], [s]: a motion on which every solver keeps its error within MARGIN tolerances at t0 = 0
MARGIN = 10.0  # of the larger of tolerance and eps t0 / span
EPS = float(np.finfo(float).eps)
SECONDS = 30.0  # of one solve: index 3 crawls
SOLVERS = (
    *("hht", "hht(alpha=-0.3)", "hht(reaction=midpoint)"),
    *(f"ida(form={form})" for form in ("ggl", "index1", "integrated", "index2", "index3")),
    *(f"cvode(method={method})" for method in ("bdf", "adams")),
    *(f"scipy(method={method})" for method in ("Radau", "BDF", "LSODA", "DOP853")),
    *(f"projected(method={method})" for method in ("DOP853", "RK45", "RK23")),
    *(f"diffrax(method={method})" for method in ("Tsit5", "Dopri8", "Kvaerno5")),
    *(f"collocation(form={form})" for form in ("ggl", "index2", "index1")),
)


class Pendulum(System):
    """A pendulum with a period of 6.3 s; its lengths are in units of its own, as is gravity."""

    def force(self, t, q, v):
        return jnp.array([0.0, -1.0])

    def constraint(self, t, q):
        return jnp.stack([(q @ q - 1.0) / 2])


PENDULUM = Pendulum()


@dataclass(frozen=True)
class Row:
    """How one solve ended."""

    solver: str
    t0: float  #: [s]
    rtol: float
    status: str
    steps: int
    error: float  #: of q and v at the end

    @property
    def allowed(self) -> float:
        """The largest error of a success."""
        return MARGIN * max(self.rtol, EPS * abs(self.t0) / SPAN)

    @property
    def broken(self) -> bool:
        """Whether it is called a success and is none."""
        return self.status == "success" and not self.error <= self.allowed


def at_angle(angle: float, rate: float = 0.0) -> np.ndarray:
    """q and v (4,) of the pendulum."""
    along = np.array([np.cos(angle), np.sin(angle)])
    return np.concatenate([[np.sin(angle), -np.cos(angle)], rate * along])


def end_of_motion() -> np.ndarray:
    """q and v (4,) after SPAN, from rest, by the equation of the angle with a tolerance of 1e-13."""
    motion = solve_ivp(lambda _, y: [y[1], -np.sin(y[0])], (0.0, SPAN), [ANGLE, 0.0], "DOP853", rtol=1e-13, atol=1e-13)
    return at_angle(*motion.y[:, -1])


def measure(solver: str, t0: float, rtol: float, end: np.ndarray) -> Row:
    """One solve from ``t0``, compared with the ``end`` (4,) of the same motion."""
    q0, v0 = np.split(at_angle(ANGLE), 2)
    problem = Problem(name="pendulum", system=PENDULUM, t_span=(t0, t0 + SPAN), q0=q0, v0=v0)
    solution = hb.solve(problem, solver, rtol=rtol, max_seconds=SECONDS)
    reached = solution.t.size > 0 and solution.t[-1] == t0 + SPAN
    error = np.max(np.abs(np.concatenate([solution.q[-1], solution.v[-1]]) - end)) if reached else np.nan
    return Row(solver, t0, rtol, solution.status.label, solution.counters.steps_accepted or 0, float(error))


def rows(solvers: tuple[str, ...] = SOLVERS, tolerances: tuple[float, ...] = TOLERANCES) -> Iterator[Row]:
    """Every solver at every origin with every tolerance."""
    end = end_of_motion()
    for solver in solvers:
        for t0 in ORIGINS:
            for rtol in tolerances:
                yield measure(solver, t0, rtol, end)


def main(arguments: list[str]) -> int:
    """Print a line a solve; 1 where a success is wrong."""
    found = []
    for row in rows(tuple(arguments) or SOLVERS):
        found.append(row)
        text = f"{row.solver:33}{row.t0:7g}{row.rtol:8g}  {row.status:16}{row.steps:7}{row.error:10.2e} of {row.allowed:.2e}"
        sys.stdout.write(f"{text}{'  BROKEN' * row.broken}\n")
    right, broken = (sum(map(test, found)) for test in (lambda row: row.status == "success", lambda row: row.broken))
    sys.stdout.write(f"{right - broken} right, {broken} wrong successes, {len(found) - right} refusals\n")
    return int(broken > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
