"""The solver under test: its abilities, its claims, and its solves, each made once."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn
from unittest import SkipTest

import numpy as np

import hhtbench
from hhtbench.api import solve
from hhtbench.catalogue.registry import load_solver
from hhtbench.catalogue.specs import parse_spec
from hhtbench.conformance.scenes import SCENES
from hhtbench.conformance.scenes.rod import Q0, V0, problem
from hhtbench.conformance.scenes.scene import SPAN, Scene
from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.problem import Problem, Solver
from hhtbench.solution.request import make_request
from hhtbench.solution.result import Solution, Status

TOLERANCES = (1e-3, 1e-4, 1e-5)  # loose to tight
STEPS = (100, 200, 400)  # the same for solvers of prescribed steps
ACCURACY = 100.0  # largest error of a whole run over the tolerance if a solver claims nothing better
ITERATIONS = 15.0  # Newton iterations a step: simplified Newton on all stages of a method of high order needs ten
ROUNDOFF = 1e-9  # errors below it tell nothing about a method
COMPONENTS = ("q", "v", "lam", "mu")
ALPHAS = (0.0, -0.3)  # alphas of HHT in the rows of the acceptance matrix
MAX_SECONDS = 20.0  # of one solve of a row
ROW_RTOL = 1e-6  # of other solvers in the rows
COLUMNS = {  # columns of the acceptance matrix: name -> spec
    "hht": "hht(engine=compiled)",
    "hht in Python": "hht(engine=python)",
    "ida": "ida",
    "cvode": "cvode",
    "scipy": "scipy(method=Radau)",
    "diffrax": "diffrax",
}


class Declined(SkipTest):
    """The solver cannot take this; the text is its reason."""


@dataclass(frozen=True)
class Claims:
    """Properties promised of a solver beyond the protocol; None: nothing is promised."""

    order: float | None = None  #: order of its error with prescribed steps
    drift: float | None = None  #: most violation of position and velocity constraints, at every step and every row
    accuracy: float = ACCURACY  #: error of a run over its tolerance
    iterations: float = ITERATIONS  #: most of Newton's a step, on a smooth motion


def expect(condition: Any, text: str) -> None:
    """Raise ``AssertionError`` with ``text`` unless ``condition`` holds."""
    if not condition:
        fail(text)


def fail(text: str) -> NoReturn:
    """Raise ``AssertionError`` with ``text``."""
    raise AssertionError(text)


@dataclass
class Subject:
    """One solver under test."""

    spec: Solver | str  #: as it was given
    claims: Claims = field(default_factory=Claims)
    name: str = ""  #: of its column in a table; "": the spec, or the solver's own name

    def __post_init__(self) -> None:
        self.solver = load_solver(self.spec)
        own = str(getattr(self.solver, "name", type(self.solver).__name__))
        self.name = self.name or (self.spec if isinstance(self.spec, str) else own)
        found = parse_spec(self.spec) if isinstance(self.spec, str) else None
        self.target = found.target if found else own  # the spec without its arguments
        self.is_hht = self.target == "hht"  # which can be asked more than a solver of the bench
        self.engine = str(found.arguments.get("engine", "compiled")) if found and self.is_hht else ""
        self.took: list[float] = []  # by the solves of a row [s]
        self._scenes: dict[str, Scene] = {}
        self._solved: dict[Any, Solution] = {}

    @classmethod
    def column(cls, name: str) -> Subject:
        """Return the column ``name`` of the acceptance matrix; any other name is the spec of a user's solver."""
        return cls(COLUMNS.get(name, name), name=name)

    def fresh(self, **options: Any) -> Solver:
        """Return another instance if the solver was given by a spec, with other ``options`` if wanted."""
        return load_solver(self.spec, **options)

    def lacks(self, need: str) -> str:
        """Return why the solver lacks the ability ``need`` of an entry; "" if it has it."""
        problem = self.scene("position").problem
        if need in ("rtol", "steps"):
            asked = {"rtol": TOLERANCES[0]} if need == "rtol" else {"steps": STEPS[0]}
            return self.takes(problem, **asked) or ""
        if need == "hht":
            return "" if self.is_hht else "it is about HHT's own steps and options"
        return "" if hasattr(self.solver, need) else f"{self.name} has no {need}"

    def having(self, method: str) -> Any:
        """Return a method of the solver that is not part of the protocol; an entry lists it in ``needs``."""
        return getattr(self.solver, method)

    # --- what rows of the acceptance matrix ask -------------------------------------------------------------------------

    def ways(self) -> Mapping[str, dict[str, Any]]:
        """Return the default requests of a row: HHT with both alphas, fixed and adaptive; others with a tolerance."""
        if not self.is_hht:
            return {"": {"rtol": ROW_RTOL}}
        return {
            f"alpha={alpha:g} {name}": {"alpha": alpha, **request}
            for alpha in ALPHAS
            for name, request in (("fixed", {"step": 0.01}), ("adaptive", {"rtol": 1e-5}))
        }

    def alphas(self, hht: Mapping[str, Any], others: Mapping[str, Any]) -> Mapping[str, dict[str, Any]]:
        """Return the request ``hht`` for both alphas, or ``others`` for another solver."""
        return {f"alpha={x:g}": {"alpha": x, **hht} for x in ALPHAS} if self.is_hht else {"": dict(others)}

    def ask(
        self, given: Any, t_span: Any = SPAN, *, q0: Any = Q0, v0: Any = V0, alpha: float | None = None, **request: Any
    ) -> Solution:
        """Solve a problem, or a system from the start of the rod, within ``MAX_SECONDS``.

        Raises
        ------
        Declined
            The solver declines it.
        """
        asked = given if isinstance(given, Problem) else problem(given, t_span, q0=q0, v0=v0)
        solver, began = self.solver if alpha is None else self.fresh(alpha=alpha), time.perf_counter()
        try:
            return self.solve(asked, solver, **{"max_seconds": MAX_SECONDS, **request})
        finally:
            self.took.append(time.perf_counter() - began)

    def hht(self, system: Any, **options: Any) -> Any:
        """Return the integrator object itself, for rows about its own steps."""
        if not self.is_hht:
            raise Declined(self.lacks("hht"))
        return hhtbench.HHT(system, engine=self.engine, **options)

    # --- what claims ask ------------------------------------------------------------------------------------------------

    def scene(self, name: str) -> Scene:
        """Return a scene of ``scenes.SCENES``, made once."""
        if name not in self._scenes:
            self._scenes[name] = SCENES[name]()
        return self._scenes[name]

    def takes(self, problem: Problem, **request: Any) -> str | None:
        """Return the reason why the solver declines the problem or request, or None."""
        return self.solver.accepts(problem, make_request(**request))

    def ladder(self, problem: Problem) -> tuple[dict[str, Any], ...]:
        """Return requests from coarse to fine that the solver takes: tolerances, or numbers of equal steps."""
        reasons = []
        for values in (TOLERANCES, STEPS):
            name = "rtol" if values is TOLERANCES else "steps"
            reason = self.takes(problem, **{name: values[0]})
            if reason is None:
                return tuple({name: value} for value in values)
            reasons.append(reason)
        raise Declined(f"{self.name} declines {problem.name}: {'; '.join(dict.fromkeys(reasons))}")

    def case(self, name: str, fineness: int) -> tuple[Scene, dict[str, Any]]:
        """Return a scene and a request for it: coarse (0), middle (1) or fine (-1)."""
        scene = self.scene(name)
        return scene, self.ladder(scene.problem)[fineness]

    def solve(self, problem: Problem | str, solver: Solver | None = None, **request: Any) -> Solution:
        """Solve a problem, whatever its status; the result is not stored."""
        solution = solve(problem, solver or self.solver, **request)
        if not isinstance(solution, Solution):
            fail(f"solve returned {type(solution).__name__}, not a hhtbench.Solution")
        if solution.status is Status.declined:
            name = problem if isinstance(problem, str) else problem.name
            raise Declined(f"{self.name} declines {name}: {solution.message}")
        return solution

    def solved(self, scene: Scene, **request: Any) -> Solution:
        """Solve a scene successfully; equal requests are solved once."""
        key = scene.name, tuple(sorted((name, np.asarray(value).tobytes()) for name, value in request.items()))
        if key not in self._solved:
            self._solved[key] = self.succeeds(scene.problem, **request)
        return self._solved[key]

    def succeeds(self, problem: Problem, solver: Solver | None = None, **request: Any) -> Solution:
        """Solve a problem; raise if it does not reach the end."""
        solution = self.solve(problem, solver, **request)
        expect(solution.status is Status.success, f"{problem.name} ends with {solution.status.label}: {solution.message}")
        expect_rows(problem, solution)
        return solution

    def bound(self, request: dict[str, Any], problem: Problem) -> float:
        """Return the largest error expected of a solve with ``request``, relative to the size of what is compared.

        With prescribed steps it is ten times the error that the same steps make on the pendulum.
        """
        if "rtol" in request:
            return self.claims.accuracy * float(request["rtol"])
        scene = self.scene("position" if self.takes(self.scene("position").problem, **request) is None else problem.name)
        return 10 * max(errors(scene, self.solved(scene, **request)).values()) + ROUNDOFF


def expect_rows(problem: Problem, solution: Solution) -> None:
    """Assert shapes, order of times, and finite numbers."""
    count, n = np.size(solution.t), problem.q0.size
    expect(count > 0, "a success has no rows")
    for name in COMPONENTS:
        array = getattr(solution, name)
        expect(isinstance(array, np.ndarray) and array.dtype == np.float64, f"{name} must be an array of float64")
        expect(array.ndim == 2 and array.shape[0] == count, f"{name} must have a row per time; got {array.shape}")
        expect(np.isfinite(array).all(), f"{name} holds a value that is not finite, in a run that ends with success")
    expect(solution.q.shape == solution.v.shape == (count, n), f"q and v must be ({count}, {n}); got {solution.q.shape}")
    forward = math.copysign(1.0, problem.t_span[1] - problem.t_span[0])
    expect(np.all(forward * np.diff(solution.t) >= 0), "times are not sorted along the interval")


def rms(difference: Matrix) -> float:
    """Return the root mean square over the rows of the largest component."""
    return float(np.sqrt(np.mean(np.max(np.abs(difference), axis=1, initial=0.0) ** 2))) if difference.size else 0.0


def size_of(values: Matrix) -> float:
    """Return the size that differences are relative to: the largest component, at least 1."""
    return max(1.0, float(np.max(np.abs(values), initial=0.0)))


def errors(scene: Scene, solution: Solution) -> dict[str, float]:
    """Return the relative root mean square error over the rows of each of q, v, lam and mu that exists."""
    motions = [scene.exact(float(t)) for t in solution.t]
    found = {}
    for name in COMPONENTS:
        known = np.array([getattr(motion, name) for motion in motions])
        values = getattr(solution, name)
        expect(values.shape == known.shape, f"{name} must be {known.shape}; got {values.shape}")
        if known.size:
            found[name] = rms(values - known) / size_of(known)
    return found


def same_bits(one: Solution, other: Solution) -> None:
    """Assert that rows and counters are bitwise equal."""
    for name in ("t", *COMPONENTS):
        a, b = getattr(one, name), getattr(other, name)
        expect(a.shape == b.shape, f"{name} has {a.shape[0]} rows in one run and {b.shape[0]} in the other")
        expect(
            np.array_equal(a, b, equal_nan=True),
            f"{name} differs between the runs by {np.max(np.abs(a - b), initial=0.0):.2g}",
        )
    expect(one.status is other.status, f"one run ends with {one.status.label}, the other with {other.status.label}")
    expect(one.counters == other.counters, f"the counters differ: {one.counters} and {other.counters}")


def at(request: dict[str, Any], times: Vector) -> dict[str, Any]:
    """Return ``request`` with output at ``times`` [s]."""
    return {**request, "t_eval": times}
