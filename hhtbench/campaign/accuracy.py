"""Errors of one solution against the exact solution at its output times, else against the reference's rows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hhtbench.protocol.arguments import Matrix, Vector
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Solution

COMPONENTS = ("q", "v", "lam", "mu")
SAME_TIME = 1e-12  # distance over the interval within which an output time equals a reference time
SPACINGS = 4  # the same in spacings of floating-point times, which may be larger
MOST_EXACT = 200  # rows at which an exact solution is computed, evenly spread: it is Python, up to 0.2 ms a row
FIRST = 10  # leading rows that are always compared: errors of the multipliers at the start show only there


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """Rows of a solution beside the true values at the same times."""

    against: str  #: "exact" or "reference"
    digits: int | None  #: verified digits of the reference
    at_end: bool  #: the last row lies at the end of the interval
    t: Vector  #: (k,) compared times [s]
    got: Mapping[str, Matrix]  #: component or observable -> (k, size)
    true: Mapping[str, Matrix]  #: true values, as ``got``
    scale: Mapping[str, Vector]  #: component or observable -> (size,) scale
    observables: tuple[str, ...]
    unknown: NDArray[np.bool_]  #: (k,) where multipliers are nan: they do not exist there

    def scaled(self, name: str) -> Vector:
        """Largest scaled error of a component or observable at every time, (k,)."""
        return np.max(np.abs(self.got[name] - self.true[name]) / self.scale[name], axis=1)

    def metrics(self) -> dict[str, Any]:
        """Return ``metrics["errors"]`` of a row: largest errors at the end and over time, in their units and scaled."""
        entries = {name: self._entry(name) for name in self.got}
        return {
            "against": self.against,
            "digits": self.digits,
            "points": int(self.t.size),
            **{name: entry for name, entry in entries.items() if name not in self.observables},
            "observables": {name.removeprefix("observable "): entries[name] for name in self.observables},
        }

    def series(self) -> dict[str, Any]:
        """Return ``series["errors"]`` of a row: scaled errors of each component over time."""
        names = [name for name in self.got if name not in self.observables]
        return {"t": self.t, **{name: self.scaled(name) for name in names}}

    def _entry(self, name: str) -> dict[str, Any]:
        error, scaled = np.max(np.abs(self.got[name] - self.true[name]), axis=1), self.scaled(name)
        left_out = self.unknown & np.isnan(error) & (name not in ("q", "v"))
        kept = ~left_out | left_out.all()  # where nothing is known, no error is either: nan
        return {
            "end": error[-1] if self.at_end else None,
            "end_scaled": scaled[-1] if self.at_end else None,
            "max": error[kept].max(),
            "max_scaled": scaled[kept].max(),
            **({"unknown": left_out.sum()} if left_out.any() else {}),
        }


def same_time(problem: Problem) -> float:
    """Return the distance [s] up to which two times count as one computed in two ways."""
    t0, t1 = problem.t_span
    return max(SAME_TIME * (abs(t1 - t0) or 1.0), SPACINGS * math.ulp(max(abs(t0), abs(t1))))


def compare_multipliers(problem: Problem, t: Vector, carried: Mapping[str, Matrix]) -> dict[str, dict[str, Any]]:
    """Return ``lam_carried`` and ``mu_carried`` of ``metrics["errors"]``: errors of the solver's own multipliers at ``t``
    (k,).
    """
    found = _compared(problem, _matched(problem, t), t, carried)
    entries = {} if found is None else found.metrics()
    return {f"{name}_carried": entries[name] for name in carried if name in entries}


def compare(problem: Problem, solution: Solution) -> Comparison | None:
    """Compare a solution with the exact solution or reference; None if neither is known at any of its times."""
    t, values = np.asarray(solution.t), {name: np.asarray(getattr(solution, name)) for name in COMPONENTS}
    known = _matched(problem, t)
    found = _compared(problem, known, t, values)
    if found is None or not {"q", "v"} <= known.truth.keys():
        return found
    got, true, scale = {**found.got}, {**found.true}, {**found.scale}
    lam = known.truth.get("lam", np.zeros((known.rows.size, 0)))
    names = {f"observable {name}": function for name, function in problem.observables.items()}
    for name, function in names.items():
        got[name] = _observed(function, found.t, *(values[part][known.rows] for part in ("q", "v", "lam")))
        true[name] = _observed(function, found.t, known.truth["q"], known.truth["v"], lam)
        size = np.max(np.abs(true[name]), axis=0)
        scale[name] = np.where(size > 0, size, 1.0)
    return replace(found, got=got, true=true, scale=scale, observables=tuple(names))


def _compared(problem: Problem, known: _Known, t: Vector, values: Mapping[str, Matrix]) -> Comparison | None:
    """Compare those of ``values`` (component -> one row for each of ``t``) whose true values are known; None if there are
    none.
    """
    rows, truth = known.rows, known.truth
    if rows.size == 0:
        return None
    some = {name: value[rows] for name, value in values.items()}
    got = {name: value for name, value in some.items() if name in truth and truth[name].shape == value.shape}
    got = {name: value for name, value in got.items() if value.shape[1]}
    return Comparison(
        against=known.against,
        digits=known.digits,
        at_end=bool(abs(t[rows[-1]] - problem.t_span[1]) <= same_time(problem)),
        t=t[rows],
        got=got,
        true={name: truth[name] for name in got},
        scale={name: _scale(problem, name, value) for name, value in got.items()},
        observables=(),
        unknown=np.isnan(np.concatenate([some["lam"], some["mu"]], axis=1)).any(axis=1),
    )


def _scale(problem: Problem, name: str, values: Matrix) -> Vector:
    return np.broadcast_to(np.asarray(getattr(problem.scales, name), dtype=np.float64), values.shape[1:])


class _Known(NamedTuple):
    """True values at some of the requested times."""

    rows: Any  #: indices of these times
    truth: dict[str, Matrix]  #: component -> the values there
    against: str  #: "exact" or "reference"
    digits: int | None = None  #: correct digits of the reference


def _matched(problem: Problem, times: Vector) -> _Known:
    """Return the exact solution or the reference at those of ``times`` where it is known."""
    if problem.exact is not None:
        spread = np.linspace(0, times.size - 1, min(times.size, MOST_EXACT)).astype(int)
        some = np.union1d(spread, np.arange(min(times.size, FIRST)))
        motions = [problem.exact(float(t)) for t in times[some]]
        truth = {
            name: np.array([np.asarray(getattr(motion, name), dtype=np.float64) for motion in motions])
            for name in COMPONENTS
            if motions
        }
        return _Known(some, truth, "exact")
    if problem.reference is None or times.size == 0:
        return _Known(np.arange(0), {}, "")
    rows, known = [], []
    for j, t in enumerate(np.asarray(problem.reference["t"], dtype=np.float64)):
        nearest = int(np.argmin(np.abs(times - t)))
        if abs(times[nearest] - t) <= same_time(problem):
            rows.append(nearest)
            known.append(j)
    found = {k: np.asarray(problem.reference[k], dtype=np.float64)[known] for k in COMPONENTS if k in problem.reference}
    return _Known(np.array(rows, dtype=int), found, "reference", problem.reference.get("digits"))


def _observed(function: Any, t: Vector, q: Matrix, v: Matrix, lam: Matrix) -> Matrix:
    rows = [np.atleast_1d(np.asarray(function(float(t[i]), q[i], v[i], lam[i]), dtype=float)) for i in range(t.size)]
    return np.array([row.ravel() for row in rows])
