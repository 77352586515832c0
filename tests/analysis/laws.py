"""Rows that follow a power law, so that slopes, fronts and factors are known in advance."""

from __future__ import annotations

from dataclasses import replace

from hhtbench.campaign.store.rows import RunRow

EVALUATION = 1e-5  # seconds


def run(solver, setting, error, evaluations, **changes):
    """One row: ``error`` at ``evaluations``, each taking ``EVALUATION`` seconds."""
    entry = {"end": error, "end_scaled": error, "max": error, "max_scaled": error}
    seconds = None if evaluations is None else evaluations * EVALUATION
    values = {
        "key": f"{solver}/{setting}",
        "problem": "pendulum",
        "solver": solver,
        "request": {"rtol": setting, "atol": None, "step": None, "steps": None},
        "status": "success",
        "message": "",
        "metrics": {"reached": 1.0, "errors": {"against": "exact", "digits": None, "q": entry, "v": entry}},
        "counters": {"residual_evaluations": evaluations, "provenance": "counted"},
        "timing": {"compile_s": 1.0, "solve_s": seconds, "best_s": seconds, "median_s": seconds, "repeats": 3},
        "environment": {"python": "3.11"},
    }
    return RunRow(**values | changes)


def law(solver, factor, order, settings=(1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6), drift=None, problem="pendulum"):
    """Error equal to the setting, ``factor * error ** (-1 / order)`` evaluations."""
    rows = []
    for setting in settings:
        row = run(
            solver, setting, setting, factor * setting ** (-1 / order), problem=problem, key=f"{problem}{solver}{setting}"
        )
        row.metrics["drift"] = {"position": drift, "velocity": drift, "sampled": "steps"}
        rows.append(row)
    return rows


def failed(solver, setting, status="newton_failed", message="no convergence", **changes):
    """A row that kept nothing but its outcome."""
    return run(solver, setting, None, None, status=status, message=message, metrics={}, counters={}, timing={}, **changes)


def ladder(rows, **changes):
    """The same rows as a campaign made them."""
    rules = {"accuracies": [1e-1, 1e-2, 1e-3, 1e-4], "max_seconds": 10.0, "pair_seconds": 30.0, "refinements": 16} | changes
    return [replace(row, request={**row.request, "max_seconds": rules["max_seconds"], "rules": rules}) for row in rows]
