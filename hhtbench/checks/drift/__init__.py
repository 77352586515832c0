"""Drift of a solution: deviation from both levels of the constraints, energy and invariants."""

from hhtbench.checks.drift.measure import measure_drift, own_at_rows, own_at_steps
from hhtbench.checks.drift.record import Drift

__all__ = ["Drift", "measure_drift", "own_at_rows", "own_at_steps"]
