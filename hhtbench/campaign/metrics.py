"""Reduce a solution to the numbers and curves of a row; keys as in :class:`~hhtbench.campaign.store.rows.RunRow`."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from hhtbench.campaign.accuracy import Comparison, compare, compare_multipliers
from hhtbench.checks.drift import Drift, measure_drift, own_at_rows, own_at_steps
from hhtbench.protocol.arguments import Vector
from hhtbench.protocol.evidence import plain
from hhtbench.protocol.problem import Problem
from hhtbench.solution.result import Counters, Solution

MOST_POINTS = 100  # points of a curve: what a plot can show
DIGITS = 6  # significant ones of a curve: a plot shows three
MOST_COMPONENTS = 12  # components of multipliers that have a curve
MOST_STATES, MOST_NUMBERS = 11, 20_000  # rows of states, and numbers in them: for comparing runs two by two


@dataclass(frozen=True, kw_only=True)
class Measured:
    """Metrics and series of one solution as plain JSON, and a note on what could not be measured."""

    metrics: dict[str, Any]
    series: dict[str, Any]
    note: str  #: "" where all went well


def measure(problem: Problem, solution: Solution) -> Measured:
    """Measure errors, drift, states and multipliers of a solution for its row.

    A function of the problem that raises costs its own part only.
    """
    count = int(np.size(solution.t))
    if count == 0:
        return Measured(metrics={"t_end": None, "reached": 0.0, "rows": 0}, series={}, note="")
    t0, t1 = problem.t_span
    last = float(solution.t[-1])
    metrics: dict[str, Any] = {"t_end": last, "reached": (last - t0) / (t1 - t0) if t1 != t0 else 1.0, "rows": count}
    series: dict[str, Any] = {"multipliers": _multipliers(solution)}
    notes = []
    for part in (_add_states, _add_errors, _add_drift):
        try:
            part(problem, solution, metrics, series)
        except Exception as error:  # noqa: BLE001 - a user's function: the solve itself stands
            notes.append(f"{part.__name__.removeprefix('_add_')} not measured: {type(error).__name__}: {error}")
    return Measured(metrics=plain(metrics), series=_for_plots(plain(series)), note="; ".join(notes))


def _for_plots(series: Any) -> Any:
    """Round the curves to ``DIGITS`` digits (a third of the text), except times and the states used to compare runs."""
    if isinstance(series, dict):
        return {name: value if name in ("states", "t") else _for_plots(value) for name, value in series.items()}
    if isinstance(series, list):
        return [_for_plots(value) for value in series]
    return float(f"{series:.{DIGITS}g}") if isinstance(series, float) else series


def counters_of(counters: Counters) -> dict[str, Any]:
    """Return ``counters`` of a row as plain values."""
    return plain({field.name: getattr(counters, field.name) for field in fields(counters)})


def _add_errors(problem: Problem, solution: Solution, metrics: dict[str, Any], series: dict[str, Any]) -> None:
    found: Comparison | None = compare(problem, solution)
    if found is None:
        return
    metrics["errors"], series["errors"] = found.metrics(), found.series()
    own = own_at_rows(solution) or own_at_steps(solution)
    if own is not None:
        metrics["errors"] |= compare_multipliers(problem, own.t, {"lam": own.lam, "mu": own.mu})


def _add_drift(problem: Problem, solution: Solution, metrics: dict[str, Any], series: dict[str, Any]) -> None:
    found: Drift | None = measure_drift(problem, solution)
    if found is None:
        return
    metrics["drift"] = found.metrics()
    curves = {name: getattr(found, name) for name in ("position", "velocity", "energy")}
    series["drift"] = spans(found.t, {name: values for name, values in curves.items() if values is not None})
    series["drift"]["invariants"] = {k: v for k, v in spans(found.t, found.invariants).items() if k != "t"}
    if found.acceleration is not None:
        series["acceleration"] = spans(found.acceleration.t, {"value": found.acceleration.value})
    if found.h is not None and found.h.size:
        series["steps"] = spans(found.t[1:], {"h": found.h}, np.minimum)


def spans(t: Vector, curves: dict[str, Vector], choose: Any = np.maximum) -> dict[str, Any]:
    """Thin curves to at most ``MOST_POINTS`` spans of equally many states, keeping each curve's largest value in a span."""
    count = t.size
    starts = np.arange(min(count, MOST_POINTS)) * count // min(count, MOST_POINTS)
    ends = np.append(starts[1:], count) - 1
    return {"t": t[ends], **{name: choose.reduceat(values, starts) for name, values in curves.items()}}


def _add_states(problem: Problem, solution: Solution, metrics: dict[str, Any], series: dict[str, Any]) -> None:
    """Add the states at up to ``MOST_STATES`` evenly spaced rows, the last one included."""
    count, width = solution.t.size, 2 * solution.q.shape[1]
    most = max(1, min(count, MOST_STATES, MOST_NUMBERS // max(1, width)))
    rows = np.unique(np.linspace(count - 1, 0, most).astype(int))
    series["states"] = {"t": solution.t[rows], "q": solution.q[rows], "v": solution.v[rows]}


def _multipliers(solution: Solution) -> dict[str, Any]:
    count = solution.t.size
    rows = np.unique(np.linspace(0, count - 1, min(count, MOST_POINTS)).astype(int))
    return {
        "t": solution.t[rows],
        **{name: np.asarray(getattr(solution, name))[rows, :MOST_COMPONENTS] for name in ("lam", "mu")},
    }
