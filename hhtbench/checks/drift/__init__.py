"""Drift of a solution: deviation from both levels of the constraints, energy and invariants."""

from hhtbench.checks.drift.measure import Drift, measure_drift, own_at_rows, own_at_steps

__all__ = ["Drift", "measure_drift", "own_at_rows", "own_at_steps"]
